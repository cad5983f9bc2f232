"""Packets against literal bytes, and the decoder against whatever a line can bring."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.wire import packet as wire
from runtime.wire.packet import (
    BROADCAST,
    Decoder,
    InstructionPacket,
    Packet,
    StatusPacket,
    encode,
)

# The examples of emanual.robotis.com/docs/en/dxl/protocol2; last a stuffed one, its
# checksum by dynamixel-sdk.
CASES: list[tuple[Packet, str]] = [
    (wire.ping(1), "FF FF FD 00 01 03 00 01 19 4E"),
    (wire.ping(), "FF FF FD 00 FE 03 00 01 31 42"),
    (StatusPacket(1, 0, b"\x06\x04\x26"), "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D"),
    (StatusPacket(2, 0, b"\x06\x04\x26"), "FF FF FD 00 02 07 00 55 00 06 04 26 6F 6D"),
    (wire.read(1, 132, 4), "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"),
    (StatusPacket(1, 0, b"\xa6\0\0\0"), "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"),
    (wire.write(1, 116, b"\0\2\0\0"), "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"),
    (StatusPacket(1), "FF FF FD 00 01 04 00 55 00 A1 0C"),
    (wire.reg_write(1, 104, b"\xc8\0\0\0"), "FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E"),
    (wire.action(1), "FF FF FD 00 01 03 00 05 02 CE"),
    (wire.factory_reset(1, 1), "FF FF FD 00 01 04 00 06 01 A1 E6"),
    (wire.reboot(1), "FF FF FD 00 01 03 00 08 2F 4E"),
    (wire.clear(1), "FF FF FD 00 01 08 00 10 01 44 58 4C 22 B1 DC"),
    (wire.sync_read(132, 4, [1, 2]), "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"),
    (
        wire.sync_write(116, 4, {1: b"\x96\0\0\0", 2: b"\xaa\0\0\0"}),
        "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
    ),
    (
        wire.bulk_read({1: (144, 2), 2: (146, 1)}),
        "FF FF FD 00 FE 0D 00 92 01 90 00 02 00 02 92 00 01 00 1A 05",
    ),
    (
        wire.write(1, 0x74, b"\xff\xff\xfd\xfd"),
        "FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD FD 2C 65",
    ),
]
IDS = [str(packet)[:60] for packet, _ in CASES]


@pytest.mark.parametrize(("packet", "literal"), CASES, ids=IDS)
def test_encodes_to_these_bytes(packet: Packet, literal: str) -> None:
    assert encode(packet).hex(" ").upper() == literal


@pytest.mark.parametrize(("packet", "literal"), CASES, ids=IDS)
def test_decodes_these_bytes_one_by_one(packet: Packet, literal: str) -> None:
    decoder, seen = Decoder(), []
    for byte in bytes.fromhex(literal):
        seen += decoder.feed(bytes((byte,)))
    assert seen == [packet]
    assert (decoder.crc_errors, decoder.discarded) == (0, 0)


@pytest.mark.parametrize("module_id", [-1, 253, 255])
def test_no_packet_has_such_an_id(module_id: int) -> None:
    with pytest.raises(ValueError):
        encode(InstructionPacket(module_id, wire.Instruction.PING))


def test_no_packet_is_that_long() -> None:
    with pytest.raises(ValueError):
        encode(InstructionPacket(1, wire.Instruction.WRITE, bytes(wire.MAX_LENGTH)))


# ── anything that a line can bring ────────────────────────────────────────────────────────────

ids = st.one_of(st.integers(0, wire.MAX_ID), st.just(BROADCAST))
# many headers, half headers and stuffings among the params
params = st.lists(
    st.one_of(st.binary(max_size=6), st.sampled_from([b"\xff\xff\xfd", b"\xff", b"\xfd", b"\0"])),
    max_size=12,
).map(b"".join)
instructions = st.sampled_from([i for i in wire.Instruction if i is not wire.Instruction.STATUS])
packets = st.one_of(
    st.builds(InstructionPacket, ids, instructions.map(int), params),
    st.builds(StatusPacket, ids, st.integers(0, 255), params),
)
noise = st.lists(
    st.one_of(
        st.binary(max_size=8),
        st.sampled_from([b"\xff", b"\xff\xff", b"\xff\xff\xfd", wire.HEADER]),
        st.sampled_from([wire.HEADER + b"\x01\xff\x0f", wire.HEADER + b"\x01\x20\x00\x55"]),
    ),
    max_size=6,
).map(b"".join)


def feed_in_pieces(decoder: Decoder, data: bytes, cuts: list[int]) -> list[Packet]:
    places = sorted({0, len(data), *(cut % (len(data) + 1) for cut in cuts)})
    return [packet for start, end in pairwise(places) for packet in decoder.feed(data[start:end])]


@given(st.lists(packets, max_size=6), st.lists(st.integers(0, 10_000), max_size=12))
def test_round_trip_however_the_bytes_are_cut(sent: list[Packet], cuts: list[int]) -> None:
    decoder = Decoder()
    assert feed_in_pieces(decoder, b"".join(map(encode, sent)), cuts) == sent
    assert (decoder.crc_errors, decoder.discarded) == (0, 0)


@given(st.lists(st.tuples(noise, packets), max_size=4), noise, st.lists(st.integers(0, 9999)))
def test_noise_never_costs_an_intact_packet(
    sent: list[tuple[bytes, Packet]], last: bytes, cuts: list[int]
) -> None:
    data = b"".join(dirt + encode(packet) for dirt, packet in sent) + last
    seen = feed_in_pieces(Decoder(), data, cuts)
    # noise may by a rare chance hold a packet of its own; those sent are all there, in order
    rest = iter(seen)
    assert all(packet in rest for _, packet in sent)


@given(packets, st.integers(1, 40), packets)
def test_a_packet_that_breaks_off_costs_itself(first: Packet, missing: int, second: Packet) -> None:
    head = encode(first)[:-missing]
    assert Decoder().feed(head + encode(second)) == [second]


@given(st.binary(max_size=300), st.lists(st.integers(0, 9999)))
def test_never_raises(data: bytes, cuts: list[int]) -> None:
    feed_in_pieces(Decoder(), data, cuts)


@given(packets, st.data())
def test_a_flipped_bit_is_noticed(packet: Packet, data: st.DataObject) -> None:
    line = bytearray(encode(packet))
    at = data.draw(st.integers(4, len(line) - 1))
    line[at] ^= 1 << data.draw(st.integers(0, 7))
    assert packet not in Decoder().feed(bytes(line))


def test_counts_what_it_lost() -> None:
    decoder = Decoder()
    good, bad = encode(wire.ping(3)), bytearray(encode(wire.ping(4)))
    bad[-1] ^= 1
    assert decoder.feed(b"\x12" + bytes(bad) + good) == [wire.ping(3)]
    assert (decoder.crc_errors, decoder.discarded) == (1, 1 + len(bad))


def test_reset_forgets_a_packet_that_has_begun() -> None:
    decoder = Decoder()
    decoder.feed(encode(wire.ping(4))[:8])
    decoder.reset()
    assert (decoder.crc_errors, decoder.discarded) == (1, 8)
    assert decoder.feed(encode(wire.ping(3))) == [wire.ping(3)]


@pytest.mark.parametrize("length", [0, 2, wire.MAX_LENGTH + 1, 0xFFFF])
def test_an_absurd_length_holds_nothing_up(length: int) -> None:
    line = wire.HEADER + b"\x01" + length.to_bytes(2, "little") + encode(wire.ping(3))
    assert Decoder().feed(line) == [wire.ping(3)]


# ── params, built and taken apart ─────────────────────────────────────────────────────────────


def test_modules_understand_what_masters_say() -> None:
    assert wire.read_span(wire.read(1, 740, 9).params) == (740, 9)
    assert wire.write_span(wire.write(1, 64, b"\1").params) == (64, b"\1")
    assert wire.sync_read_spans(wire.sync_read(740, 9, [3, 2]).params) == (740, 9, [3, 2])
    values = {3: b"ab", 2: b"cd"}
    assert wire.sync_write_spans(wire.sync_write(720, 2, values).params) == (720, values)
    spans = {3: (740, 9), 2: (64, 1)}
    assert wire.bulk_read_spans(wire.bulk_read(spans).params) == spans
    writes = {3: (720, b"abc"), 2: (64, b"\1")}
    assert wire.bulk_write_spans(wire.bulk_write(writes).params) == writes


@pytest.mark.parametrize(
    ("function", "data"),
    [
        (wire.read_span, b"\1\2\3"),
        (wire.write_span, b"\1\2"),
        (wire.sync_read_spans, b"\1\2\3"),
        (wire.sync_write_spans, b"\1\2\3"),
        (wire.sync_write_spans, b"\1\0\2\0\1\1"),
        (wire.bulk_read_spans, b"\1\2\3"),
        (wire.bulk_write_spans, b"\1\2\3"),
        (wire.bulk_write_spans, b"\1\2\0\2\0\0"),
    ],
)
def test_params_that_break_off_are_refused(function: object, data: bytes) -> None:
    with pytest.raises(ValueError):
        function(data)  # type: ignore[operator]


def test_a_sync_write_has_values_of_one_length() -> None:
    with pytest.raises(ValueError):
        wire.sync_write(720, 2, {3: b"ab", 2: b"c"})


def test_a_combined_status_is_taken_apart_and_may_break_off() -> None:
    parts = [StatusPacket(3, 0, b"abcd"), StatusPacket(7, 0x80, b"efgh"), StatusPacket(4, 0, b"ij")]
    combined = wire.join_fast(parts)
    assert list(wire.split_fast(combined, [4, 4, 2])) == parts
    cut = StatusPacket(BROADCAST, combined.error, combined.params[:9])
    assert list(wire.split_fast(cut, [4, 4, 2])) == parts[:1]
