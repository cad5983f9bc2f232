"""Envelopes: every message survives the wire, and nothing on the wire hurts."""

from __future__ import annotations

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.envelope import EnvelopeError, decode, encode, encoding_of
from runtime.messages import BusReply, ChainState, Event, Message, Place, Plug

RIGHT = encoding_of(Event)
EVENT = Event(stamp_ns=5, process="p", level="info", kind="k", text="t", data={"a": "b"})


def test_is_a_messagepack_map_by_field_names() -> None:
    assert msgpack.unpackb(encode(EVENT)) == {
        "stamp_ns": 5,
        "process": "p",
        "level": "info",
        "kind": "k",
        "text": "t",
        "data": {"a": "b"},
    }
    assert RIGHT == "application/msgpack;type=Event;v=1"


@pytest.mark.parametrize(
    "message",
    [
        EVENT,
        BusReply(chain="arm", sequence=2**40, data=bytes(range(256))),
        ChainState(
            chain="arm",
            muscles=("a", "b"),
            length_m=(0.1, 0.2),
            tension_n=(1.0, float("inf")),
            temperature_degc=(20.0, 21.0),
            target_length_m=(0.1, 0.2),
            mode="hold",
        ),
        Plug(muscle="m", path=None),
    ],
)
def test_round_trip(message: Message) -> None:
    assert decode(type(message), encode(message), encoding_of(type(message))) == message


def test_a_newer_writer_may_add_fields() -> None:
    fields = msgpack.unpackb(encode(EVENT)) | {"mood": "good"}
    assert decode(Event, msgpack.packb(fields), RIGHT) == EVENT


@pytest.mark.parametrize(
    ("payload", "encoding", "complaint"),
    [
        (encode(EVENT), "application/json", "foreign"),
        (encode(EVENT), "", "foreign"),
        (encode(EVENT), "application/msgpack;type=Event;v=one", "foreign"),
        (encode(EVENT), "application/msgpack;type=Clock;v=1", "Clock where Event belongs"),
        (encode(EVENT), "application/msgpack;type=Event;v=2", "newer than 1"),
        (encode(EVENT), "application/msgpack;type=Event;v=0", "no longer spoken"),
        (b"", RIGHT, "malformed"),
        (b"\xc1", RIGHT, "malformed"),
        (encode(EVENT)[:-1], RIGHT, "malformed"),
        (encode(EVENT) + b"\x00", RIGHT, "malformed"),
        (msgpack.packb({"process": "p"}), RIGHT, "missing required field"),
        (msgpack.packb([1, 2]), RIGHT, "malformed"),
        (msgpack.packb({"process": 3}), RIGHT, "malformed"),
        (b"\x91" * 2000, RIGHT, "malformed"),
        (b"\x81\xa1\xff\x00", RIGHT, "malformed"),
    ],
)
def test_what_cannot_be_read_is_refused_in_words(
    payload: bytes, encoding: str, complaint: str
) -> None:
    with pytest.raises(EnvelopeError, match=complaint):
        decode(Event, payload, encoding)


@given(st.binary(max_size=200), st.sampled_from([Event, ChainState, Plug]))
def test_noise_is_refused_and_nothing_worse(noise: bytes, kind: type[Message]) -> None:
    with pytest.raises(EnvelopeError):
        decode(kind, noise, encoding_of(kind))


_plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text()
    | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=10,
)  # fmt: skip
_fields = st.sampled_from(["stamp_ns", "process", "level", "kind", "text", "data", "other"])


@given(st.dictionaries(_fields, _plain))
def test_wrong_fields_are_refused_and_nothing_worse(fields: dict[str, object]) -> None:
    payload = msgpack.packb(fields)
    try:
        event = decode(Event, payload, RIGHT)
    except EnvelopeError:
        return
    assert isinstance(event.text, str)


def test_nested_structs_are_checked_too() -> None:
    point = {"link": "arm", "position_m": [0.0, 0.0], "elsewhere": 1}
    with pytest.raises(EnvelopeError):
        decode(Place, msgpack.packb(point), encoding_of(Place))
