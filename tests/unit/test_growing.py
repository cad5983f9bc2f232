"""In words, how the body changes."""

from __future__ import annotations

import pytest

from runtime import messages as m
from runtime.growing import LEFT_OUT, OUTSIDE, TAKEN_IN, Growing

MUSCLES = ("triceps", "biceps_1")


def schema(*muscles: str) -> m.SchemaVersion:
    return m.SchemaVersion(version=2, joints=(), muscles=muscles, method="iv", data=b"")


def begun(kind: str, muscle: str, stamp_ns: int = 1) -> m.Event:
    return m.Event(
        stamp_ns=stamp_ns,
        process="executive",
        level="info",
        kind=f"{kind}_started",
        text="",
        data={"muscle": muscle},
    )


def doing(muscle: str, version: int = 1) -> m.ExecutiveState:
    return m.ExecutiveState(stage="relearn", growing=muscle, schema_version=version)


def told(*messages: m.Message) -> Growing:
    growing = Growing()
    for message in messages:
        growing.take(message)
    return growing


@pytest.mark.parametrize(
    ("kind", "muscle", "words"),
    [
        ("grow", "biceps_3", "taking in biceps_3"),
        ("refit", "biceps_3", "taking back biceps_3"),
        ("shrink", "biceps_1", "going on without biceps_1"),
        ("grow", "biceps_1", "learning the body anew"),
    ],
)
def test_the_event_that_began_it_tells_what_it_is(kind: str, muscle: str, words: str) -> None:
    event = begun(kind, muscle)
    for messages in ((event, doing(muscle)), (doing(muscle), event)):
        growing = told(schema(*MUSCLES), *messages)
        assert growing.words == words
    growing.take(doing(""))
    assert growing.words == growing.leaving == ""


def test_without_its_event_the_schema_tells() -> None:
    muscle = "biceps_1"
    assert told(schema(*MUSCLES), doing(muscle)).words == "going on without biceps_1"
    assert told(doing(muscle), schema(*MUSCLES)).words == "going on without biceps_1"
    assert told(schema(*MUSCLES), doing("biceps_3")).words == "taking in biceps_3"
    assert told(doing("triceps", version=0)).words == "learning the first schema"


def test_an_older_event_tells_nothing() -> None:
    old, new = begun("grow", "biceps_1", 1), begun("shrink", "biceps_1", 2)
    assert told(schema(*MUSCLES), new, old, doing("biceps_1")).leaving == "biceps_1"


def test_adoption_does_not_change_the_words() -> None:
    growing = told(schema(*MUSCLES), begun("shrink", "biceps_1"), doing("biceps_1"))
    growing.take(schema("triceps"))
    assert growing.words == "going on without biceps_1"
    growing = told(schema("triceps"), begun("grow", "biceps_1"), doing("biceps_1"))
    growing.take(schema(*MUSCLES))
    assert growing.words == "taking in biceps_1"


def test_only_muscles_that_are_up_have_a_standing() -> None:
    def standing(name: str, kind: str = "muscle", state: str = "up") -> str:
        module = m.ModuleInfo(name=name, kind=kind, module_id=2, serial=1, state=state)
        return growing.standing(module)

    growing = told(schema(*MUSCLES), begun("shrink", "biceps_1"), doing("biceps_1"))
    assert standing("triceps") == ""
    assert standing("biceps_1") == LEFT_OUT
    assert standing("biceps_3") == OUTSIDE
    growing.take(schema("triceps"))
    assert standing("biceps_1") == LEFT_OUT, "until the arm goes on"
    growing.take(doing("biceps_3"))
    assert standing("biceps_1") == OUTSIDE
    assert standing("biceps_3") == TAKEN_IN
    assert standing("biceps_3", state="lost") == standing("elbow", "joint") == ""
