"""The table is complete and the messages say what they mean: rows, keys, units, round trips."""

from __future__ import annotations

import re
import types
import typing
from collections.abc import Iterable
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from runtime import messages, topics
from runtime.envelope import decode, encode, encoding_of
from runtime.messages import Message, Presence
from runtime.topics import REQUESTS, TOPICS, Request, Topic

MESSAGES = sorted(
    (
        kind
        for kind in vars(messages).values()
        if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message
    ),
    key=lambda kind: kind.__name__,
)
STRUCTS = sorted(
    (
        kind
        for kind in vars(messages).values()
        if isinstance(kind, type) and issubclass(kind, msgspec.Struct)
    ),
    key=lambda kind: kind.__name__,
)
ROWS: list[Topic | Request] = [*TOPICS, *REQUESTS]

UNITS = ("m", "n", "rad", "hz", "ns", "s", "degc", "mm", "mb", "percent", "n_m", "m_s")

# Numbers that are counted or have no unit, each with its reason.
PURE = {
    "speed": "robot seconds per wall second",
    "real_time_factor": "robot seconds per wall second",
    "incarnation": "count",
    "pid": "number of a process",
    "dropped": "count",
    "restarts": "count",
    "sequence": "count",
    "module_id": "address",
    "serial": "number of a module",
    "link_errors": "count",
    "anomaly": "residual over its usual size",
    "version": "count",
    "parent": "version",
    "base_version": "version",
    "schema_version": "version",
    "seed": "of a random generator",
    "begin": "count",
    "taken": "count",
    "heard_key": "place in a list",
    "epoch": "count",
    "epochs": "count",
    "loss": "of scaled quantities",
    "loss_new": "of scaled quantities",
    "loss_old": "of scaled quantities",
    "step": "count",
    "steps": "count",
    "n_new": "count of motions",
    "amount": "what it measures depends on the kind of fault",
    "direction": "unit vector",
}


def numbers_in(kind: Any) -> bool:
    """Does a value of this type hold numbers of its own (not those of a struct inside)?"""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return False
    return kind in (int, float) or any(numbers_in(part) for part in typing.get_args(kind))


def names(rows: Iterable[Topic | Request]) -> list[str]:
    return [row.message.__name__ for row in rows]


def test_every_message_has_exactly_one_row() -> None:
    wanted = [kind.__name__ for kind in MESSAGES if kind is not Presence]
    assert sorted(names(ROWS)) == wanted
    assert {row.message: row for row in TOPICS} == topics.BY_TYPE
    assert set(topics.BY_NAME) == set(names(TOPICS))


def test_keys_are_unique_and_sound() -> None:
    keys = [row.key for row in ROWS] + [topics.TOKEN_KEY]
    patterns = [re.sub(r"\{\w+\}", "*", key) for key in keys]
    assert len(set(patterns)) == len(patterns)
    for key in keys:
        assert re.fullmatch(r"(?:[a-z]+|\{[a-z]+\})(?:/(?:[a-z]+|\{[a-z]+\}))*", key), key


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.message.__name__)
def test_key_is_filled_from_the_messages_own_fields(row: Any) -> None:
    fields = {field.name: field.type for field in msgspec.structs.fields(row.message)}
    for name in re.findall(r"\{(\w+)\}", row.key):
        assert fields[name] is str


def test_key_of_a_message_matches_its_pattern() -> None:
    state = messages.Health(process="viz", pid=1, tick_hz=1, cpu_percent=1, memory_mb=1, dropped=0)
    assert topics.key_of("elbow", state) == "elbow/health/viz"
    assert topics.key_pattern("elbow", messages.Health) == "elbow/health/*"
    assert topics.key_pattern("elbow", messages.Plug) == "elbow/request/plug"


def test_a_pattern_can_be_one_chains_own() -> None:
    assert topics.key_pattern("elbow", messages.ChainCommand, "arm") == "elbow/chain/arm/command"
    assert topics.key_pattern("elbow", messages.Event, "arm") == "elbow/event"


def test_numbers_of_the_table_make_sense() -> None:
    assert all(row.rate_hz >= 0 for row in TOPICS)
    assert all(row.timeout_s > 0 for row in REQUESTS)
    timed = [row.message.__name__ for row in TOPICS if row.keep is topics.Keep.HISTORY]
    assert timed == ["Event", "Steps"]  # fifty of anything much faster would be no history


FIELDS = [
    pytest.param(field.name, id=f"{kind.__name__}.{field.name}")
    for kind in STRUCTS
    for field in msgspec.structs.fields(kind)
    if numbers_in(field.type)
]


@pytest.mark.parametrize("name", FIELDS)
def test_quantity_names_its_unit(name: str) -> None:
    assert name in PURE or name.endswith(tuple(f"_{unit}" for unit in UNITS)), (
        f"{name} is a quantity: put its unit into its name, or say in PURE why it has none"
    )


def test_no_reason_without_a_field() -> None:
    assert set(PURE) <= {field.values[0] for field in FIELDS}


def values(kind: Any) -> st.SearchStrategy[Any]:
    """Values of one field's type, as they may travel: no NaN (it equals nothing)."""
    plain: dict[Any, st.SearchStrategy[Any]] = {
        int: st.integers(-(2**63), 2**63 - 1),
        float: st.floats(allow_nan=False),
        str: st.text(st.characters(codec="utf-8"), max_size=8),
        bytes: st.binary(max_size=16),
        bool: st.booleans(),
        type(None): st.none(),
    }
    if kind in plain:
        return plain[kind]
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        return structs(kind)
    outer, parts = typing.get_origin(kind), typing.get_args(kind)
    if outer in (typing.Union, types.UnionType):
        return st.one_of(*map(values, parts))
    if outer is dict:
        return st.dictionaries(values(parts[0]), values(parts[1]), max_size=2)
    if outer is tuple and parts[-1] is ...:
        return st.lists(values(parts[0]), max_size=3).map(tuple)
    if outer is tuple:
        return st.tuples(*map(values, parts))
    raise AssertionError(f"a message may not hold {kind}")


def structs(kind: type[msgspec.Struct]) -> st.SearchStrategy[Any]:
    return st.builds(
        kind, **{field.name: values(field.type) for field in msgspec.structs.fields(kind)}
    )


@pytest.mark.parametrize("kind", MESSAGES, ids=lambda kind: kind.__name__)
def test_round_trip_through_msgpack(kind: type[Message]) -> None:
    @settings(max_examples=40)
    @given(structs(kind))
    def check(message: Message) -> None:
        assert decode(kind, encode(message), encoding_of(kind)) == message

    check()


def test_a_newer_senders_extra_field_is_no_obstacle() -> None:
    fields = {**msgspec.to_builtins(messages.Unplug(muscle="biceps_3")), "from_the_future": 1}
    assert msgspec.convert(fields, messages.Unplug) == messages.Unplug(muscle="biceps_3")
