from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware_sim.chain import Chain
from hardware_sim.faults import ActiveFault, Faults
from hardware_sim.firmware import MuscleModule
from hardware_sim.module import JointModule, Module
from hardware_sim.muscle_bank import MuscleBank
from runtime.wire import packet as wire
from runtime.wire.packet import Packet, StatusError, StatusPacket

MS = 1_000_000


def chain_of(*ids: int, faults: Faults | None = None) -> Chain:
    """Muscles m2, m3, ... on these ids; an id of 100 or more is a joint."""
    chain, bank = Chain("arm", faults=faults), MuscleBank()
    for number, module_id in enumerate(ids):
        module: Module
        if module_id >= 100:
            module = JointModule(1000 + number, lambda: 0.25, module_id, f"j{module_id}")
        else:
            module = MuscleModule(bank, bank.add(), 1000 + number, module_id, f"m{module_id}")
        chain.plug(module)
    return chain


def say(chain: Chain, packet: wire.InstructionPacket, now_ns: int = 0) -> list[Packet]:
    return wire.Decoder().feed(chain.receive(wire.encode(packet), now_ns))


def status(module_id: int, params: bytes = b"", error: int = 0) -> StatusPacket:
    return StatusPacket(module_id, error, params)


# ── every instruction ─────────────────────────────────────────────────────────────────────────


def test_ping_literally() -> None:
    """The request is the one that protocol 2.0's documentation shows."""
    reply = chain_of(1).receive(bytes.fromhex("fffffd00 01 0300 01 194e"), 0)
    assert reply == bytes.fromhex("fffffd00 01 0700 55 00 314d01 1e68")


def test_ping() -> None:
    chain = chain_of(2, 100)
    assert say(chain, wire.ping(2)) == [status(2, b"1M\x01")]
    assert say(chain, wire.ping(100)) == [status(100, b"1J\x01")]
    assert say(chain, wire.ping(3)) == []


def test_broadcast_ping_is_answered_in_order_of_ids() -> None:
    chain = chain_of(7, 100, 2)
    assert say(chain, wire.ping()) == [
        status(2, b"1M\x01"),
        status(7, b"1M\x01"),
        status(100, b"1J\x01"),
    ]


def test_read() -> None:
    chain = chain_of(2)
    assert say(chain, wire.read(2, 700, 8)) == [status(2, (1000).to_bytes(8, "little"))]
    assert say(chain, wire.read(2, 300, 4)) == [status(2, b"", StatusError.ACCESS)]
    assert say(chain, wire.read(wire.BROADCAST, 700, 8)) == []


def test_write() -> None:
    chain = chain_of(2)
    assert say(chain, wire.write(2, 65, b"\1")) == [status(2)]
    assert say(chain, wire.read(2, 65, 1)) == [status(2, b"\1")]
    assert say(chain, wire.write(2, 65, b"\2")) == [status(2, b"", StatusError.DATA_LIMIT)]
    assert say(chain, wire.write(2, 70, b"\0")) == [status(2, b"", StatusError.ACCESS)]
    assert say(chain, wire.write(2, 720, b"\0")) == [status(2, b"", StatusError.DATA_LENGTH)]


def test_broadcast_write_is_done_and_not_answered() -> None:
    chain = chain_of(2, 3)
    assert say(chain, wire.write(wire.BROADCAST, 65, b"\1")) == []
    assert [module.read(65, 1) for module in chain.modules] == [b"\1", b"\1"]


def test_new_id_is_answered_from_the_old_one() -> None:
    chain = chain_of(1)
    assert say(chain, wire.write(1, 7, b"\x05")) == [status(1)]
    assert say(chain, wire.ping(1)) == []
    assert say(chain, wire.ping(5)) == [status(5, b"1M\x01")]


def test_registered_write() -> None:
    chain = chain_of(2, 3)
    assert say(chain, wire.reg_write(2, 65, b"\1")) == [status(2)]
    assert say(chain, wire.reg_write(3, 65, b"\2")) == [status(3, b"", StatusError.DATA_LIMIT)]
    assert say(chain, wire.read(2, 65, 1)) == [status(2, b"\0")]
    assert say(chain, wire.action()) == []
    assert say(chain, wire.read(2, 65, 1)) == [status(2, b"\1")]
    assert say(chain, wire.action(2)) == [status(2, b"", StatusError.RESULT_FAIL)]


def test_sync_read_in_the_order_asked() -> None:
    chain = chain_of(2, 3, 100)
    assert say(chain, wire.sync_read(740, 9, [100, 3, 9, 2])) == [
        status(100, (250_000).to_bytes(4, "little") + bytes(5)),
        status(3, bytes.fromhex("00000000 0000 fa00 00")),  # 25.0 degC
        status(2, bytes.fromhex("00000000 0000 fa00 00")),
    ]


def test_fast_sync_read_literally() -> None:
    chain = chain_of(2, 3)
    line = chain.receive(wire.encode(wire.sync_read(7, 1, [2, 3], fast=True)), 0)
    assert line == bytes.fromhex(
        "fffffd00 fe 0b00 55"
        "00 02 02 367f"  # error, id, data, checksum of all so far
        "00 03 03 aca3"
    )


def test_fast_sync_read_breaks_off_at_a_missing_module() -> None:
    chain = chain_of(2, 4)
    whole = chain_of(2, 3, 4).receive(wire.encode(wire.sync_read(7, 1, [2, 3, 4], fast=True)), 0)
    assert chain.receive(wire.encode(wire.sync_read(7, 1, [2, 3, 4], fast=True)), 0) == whole[:13]
    assert chain.receive(wire.encode(wire.sync_read(7, 1, [9, 2], fast=True)), 0) == b""


def test_bulk() -> None:
    chain = chain_of(2, 100)
    assert say(chain, wire.bulk_write({2: (65, b"\1"), 100: (9, b"\x32")})) == []
    assert say(chain, wire.bulk_read({100: (7, 3), 2: (65, 1)})) == [
        status(100, b"\x64\x05\x32"),
        status(2, b"\1"),
    ]
    (combined,) = say(chain, wire.bulk_read({100: (7, 3), 2: (65, 1)}, fast=True))
    assert isinstance(combined, StatusPacket)
    assert list(wire.split_fast(combined, [3, 1])) == [
        status(100, b"\x64\x05\x32"),
        status(2, b"\1"),
    ]


def test_sync_write() -> None:
    chain = chain_of(2, 3)
    goals = bytes.fromhex("e803 204e 50c30000")  # 10 N, 20 kN/m, 0.05 m
    assert say(chain, wire.sync_write(720, 8, {2: goals, 3: bytes(8), 9: goals})) == []
    assert chain.modules[0].read(720, 8) == goals
    assert chain.modules[1].read(720, 8) == bytes(8)


def test_reboot_and_factory_reset() -> None:
    chain = chain_of(2)
    say(chain, wire.write(2, 65, b"\1"))
    assert say(chain, wire.reboot(2)) == [status(2)]
    assert say(chain, wire.read(2, 65, 1)) == [status(2, b"\0")]
    assert say(chain, wire.factory_reset(2, 0x01)) == [status(2)]
    assert say(chain, wire.factory_reset(2, 0x07)) == [status(2, b"", StatusError.DATA_RANGE)]
    assert say(chain, wire.factory_reset(2, 0xFF)) == [status(2)]
    assert say(chain, wire.ping(1)) == [status(1, b"1M\x01")]


@pytest.mark.parametrize(
    ("instruction", "params", "error"),
    [
        (0x02, b"\0", StatusError.DATA_LENGTH),
        (0x03, b"\0", StatusError.DATA_LENGTH),
        (0x04, b"", StatusError.DATA_LENGTH),
        (0x06, b"", StatusError.DATA_LENGTH),
        (0x10, b"", StatusError.INSTRUCTION),
        (0x77, b"", StatusError.INSTRUCTION),
    ],
)
def test_instructions_that_make_no_sense(instruction: int, params: bytes, error: int) -> None:
    packet = wire.InstructionPacket(2, instruction, params)
    assert say(chain_of(2), packet) == [status(2, b"", error)]


@pytest.mark.parametrize("instruction", [0x82, 0x83, 0x8A, 0x92, 0x93, 0x9A])
def test_broadcasts_that_make_no_sense(instruction: int) -> None:
    packet = wire.InstructionPacket(wire.BROADCAST, instruction, b"\1\2\3")
    assert say(chain_of(2), packet) == []


@pytest.mark.parametrize(("level", "ping", "read", "write"), [(0, 1, 0, 0), (1, 1, 1, 0)])
def test_status_return_level(level: int, ping: int, read: int, write: int) -> None:
    chain = chain_of(2)
    say(chain, wire.write(2, 68, bytes((level,))))
    assert len(say(chain, wire.ping(2))) == ping
    assert len(say(chain, wire.read(2, 7, 1))) == read
    assert len(say(chain, wire.sync_read(7, 1, [2]))) == read
    assert len(say(chain, wire.write(2, 65, b"\1"))) == write
    assert chain.modules[0].read(65, 1) == b"\1"


def test_alert_shows_in_every_status() -> None:
    chain = chain_of(2)
    module = chain.modules[0]
    assert isinstance(module, MuscleModule)
    module.bank.hardware_error[0] = 4
    assert say(chain, wire.read(2, 70, 1)) == [status(2, b"\4", 0x80)]
    assert say(chain, wire.write(2, 70, b"\0")) == [status(2, b"", 0x87)]


def test_any_packet_feeds_every_watchdog() -> None:
    chain = chain_of(2, 3)
    for module in chain.modules:
        module.write(64, b"\1")
        module.write(98, b"\1")  # 20 ms
    bank = chain.modules[0].bank  # type: ignore[attr-defined]
    zeros = np.zeros(2)
    for now_ns in range(0, 60 * MS, 15 * MS):
        say(chain, wire.ping(2), now_ns)
        bank.step(0.001, zeros, zeros, zeros, now_ns)
    assert bank.tripped.tolist() == [0, 0]
    bank.step(0.001, zeros, zeros, zeros, 70 * MS)
    assert bank.tripped.tolist() == [1, 1]


# ── the line ──────────────────────────────────────────────────────────────────────────────────


def test_bytes_may_come_in_any_pieces() -> None:
    chain = chain_of(2)
    replies = [chain.receive(bytes((byte,)), 0) for byte in wire.encode(wire.ping(2))]
    assert wire.Decoder().feed(b"".join(replies)) == [status(2, b"1M\x01")]
    two = wire.encode(wire.ping(2)) + b"\0\xff" + wire.encode(wire.read(2, 7, 1))
    assert len(wire.Decoder().feed(chain.receive(two, 0))) == 2


def test_wrong_checksum_is_ignored_and_counted() -> None:
    chain = chain_of(2, 100)
    spoilt = bytearray(wire.encode(wire.ping(2)))
    spoilt[-1] ^= 1
    assert chain.receive(bytes(spoilt), 0) == b""
    assert say(chain, wire.read(2, 750, 2)) == [status(2, b"\1\0")]
    assert say(chain, wire.read(100, 750, 2)) == [status(100, b"\1\0")]


def test_two_fresh_modules_spoil_each_others_answers() -> None:
    chain = chain_of(2, 1, 1)
    for packet in (wire.ping(1), wire.read(1, 700, 8), wire.sync_read(700, 8, [1])):
        line = chain.receive(wire.encode(packet), 0)
        assert line
        assert wire.Decoder().feed(line) == []
    assert say(chain, wire.ping()) == [status(2, b"1M\x01")]
    chain.unplug(1002)
    assert say(chain, wire.ping()) == [status(1, b"1M\x01"), status(2, b"1M\x01")]


def test_unplug_unknown() -> None:
    with pytest.raises(KeyError, match="no module 5 on chain arm"):
        chain_of(2).unplug(5)


def test_other_baud_rate_hears_nothing() -> None:
    chain = chain_of(2, 3)
    assert say(chain, wire.write(2, 8, b"\x03")) == [status(2)]
    assert say(chain, wire.ping()) == [status(3, b"1M\x01")]


def test_reply_time() -> None:
    chain = chain_of(2)
    request = wire.encode(wire.ping(2))  # 10 bytes, answered by 14
    reply = chain.receive(request, 0)
    assert chain.reply_time_ns(request, b"") == 33_333
    assert chain.reply_time_ns(request, reply) == 80_000 + 2_000
    say(chain, wire.write(2, 9, b"\xfa"))  # 250 * 2 us of return delay
    assert chain.reply_time_ns(request, reply) == 80_000 + 2_000 + 500_000
    chain.faults.set("delay", "arm", 0.01)
    assert chain.reply_time_ns(request, reply) == 80_000 + 2_000 + 500_000 + 10_000_000


# ── faults ────────────────────────────────────────────────────────────────────────────────────


def test_cable() -> None:
    chain = chain_of(2, 3, 100, 4)
    chain.faults.set("cable", "arm", 2)
    assert [p.id for p in say(chain, wire.ping())] == [2, 3]
    chain.faults.set("cable", "m3")
    assert [p.id for p in say(chain, wire.ping())] == [2]
    chain.faults.set("cable", "arm", 0)
    assert say(chain, wire.ping()) == []
    chain.faults.clear("cable")
    assert [p.id for p in say(chain, wire.ping())] == [2, 3, 4, 100]


def count_answers(chain: Chain, times: int = 400) -> int:
    return sum(len(say(chain, wire.read(2, 7, 1))) for _ in range(times))


def test_drop() -> None:
    chain = chain_of(2, 3)
    chain.faults.set("drop", "m2", 0.25)
    assert 250 < count_answers(chain) < 350
    assert all(say(chain, wire.ping(3)) for _ in range(50))
    chain.faults.set("drop", "arm", 1.0)
    assert count_answers(chain) == 0
    chain.faults.clear(target="arm")
    chain.faults.set("drop", "m2", 0.0)
    assert count_answers(chain) == 400


def test_noise_spoils_packets_and_nothing_else() -> None:
    """0.5 % of 26 bytes: about one exchange in eight is lost, and none is wrong."""
    chain = chain_of(2)
    chain.faults.set("corrupt", "arm", 0.005)
    decoder, good = wire.Decoder(), 0
    for _ in range(400):
        for packet in decoder.feed(chain.receive(wire.encode(wire.read(2, 7, 1)), 0)):
            assert packet == status(2, b"\2")
            good += 1
    assert 300 < good < 390
    assert 0 < chain.modules[0].link_errors < 100


def test_faults_repeat_with_their_seed() -> None:
    def lost(seed: int) -> list[bool]:
        chain = chain_of(2, faults=Faults(seed))
        chain.faults.set("drop", "arm", 0.5)
        return [not say(chain, wire.ping(2)) for _ in range(40)]

    assert lost(1) == lost(1) != lost(2)


def test_switch_board() -> None:
    faults = Faults()
    faults.set("rupture", "biceps_1")
    faults.set("overheat", "biceps_2", 60.0)
    assert faults.active == [
        ActiveFault("rupture", "biceps_1", 1.0),
        ActiveFault("overheat", "biceps_2", 60.0),
    ]
    assert faults.amount("rupture", "biceps_1") == 1.0
    assert faults.amount("rupture", "biceps_2") is None
    faults.clear()
    assert faults.active == []
    with pytest.raises(ValueError, match="no fault 'fire'"):
        faults.set("fire", "arm")
    with pytest.raises(ValueError, match="cannot have the amount 2"):
        faults.set("drop", "arm", 2.0)
    for odd in (math.nan, math.inf, -1.0):
        with pytest.raises(ValueError, match="cannot have the amount"):
            faults.set("overheat", "arm", odd)


# ── whatever comes ────────────────────────────────────────────────────────────────────────────


@given(st.lists(st.binary(max_size=40) | st.just(wire.HEADER), max_size=6))
def test_noise_never_breaks_the_chain(pieces: list[bytes]) -> None:
    chain = chain_of(2, 100)
    for piece in pieces:
        chain.receive(piece, 0)
    assert status(2, b"1M\x01") in say(chain, wire.ping(2))


@given(st.sampled_from((2, 100, 254)), st.integers(1, 255), st.binary(max_size=24))
def test_any_packet_gets_a_whole_answer_or_none(
    module_id: int, instruction: int, params: bytes
) -> None:
    chain = chain_of(2, 100)
    packet = wire.InstructionPacket(module_id, instruction, params)
    reply, decoder = chain.receive(wire.encode(packet), 0), wire.Decoder()
    decoder.feed(reply)
    fast = instruction in (0x8A, 0x9A)  # may break off at a module that is not there
    assert fast or (decoder.discarded, decoder.crc_errors) == (0, 0)
