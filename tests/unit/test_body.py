"""Which muscles belong to the body: what begins a growth, and what does not begin it again."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from runtime.logic import MemoryStore
from runtime.messages import ChainBody, ModuleInfo, SchemaVersion, TrainingProgress
from services.logic.body import LOST_S, TORN_S, Body
from services.logic.memory import Notebook
from tests.unit.arm_bench import DT_S, SETTINGS, Bench
from tests.unit.schemas import untrained

GUEST = "biceps_3"
SERIAL = 50
NOTHING = ("", "", 0)


class Watched:
    """A body over an arm that is told who is plugged in."""

    def __init__(self, known: dict[str, int] | None = None) -> None:
        self.bench = Bench()
        self.notebook = Notebook(MemoryStore(), {}, 1)
        self.notebook.memory.known.update(known or {})
        self.events: list[str] = []
        self.body = Body(self.bench.arm, self.notebook, 0, self._tell)
        self.modules: dict[str, tuple[str, int]] = {}
        for number, name in enumerate(SETTINGS.muscles):
            self.modules[name] = ("up", SERIAL + number)
        self.bench.step()

    def _tell(self, level: str, kind: str, text: str, **data: str) -> None:
        self.events.append(kind)

    def watch(self, seconds: float = DT_S) -> None:
        rows = tuple(
            ModuleInfo(name=name, kind="muscle", module_id=2, serial=serial, state=state)
            for name, (state, serial) in self.modules.items()
        )
        for _ in range(round(seconds / DT_S)):
            self.bench.feel()
            self.bench.arm.receive(ChainBody(chain="arm", modules=rows))
            self.body.watch(DT_S)
            if self.body.growth is not None and self.body.growth.over:
                list(self.body.tick(self.bench.now_ns, DT_S))

    def growing(self) -> tuple[str, str, int]:
        growth = self.body.growth
        if growth is None:
            return "", "", 0
        return growth.record.kind, growth.record.muscle, growth.steps


def version_of(muscles: tuple[str, ...], number: int) -> SchemaVersion:
    schema = untrained(muscles, SETTINGS.joints)
    return SchemaVersion(
        version=number,
        joints=schema.joints,
        muscles=schema.muscles,
        method="shipped",
        data=schema.to_bytes(),
    )


def test_a_muscle_that_comes_is_taken_in() -> None:
    robot = Watched()
    robot.watch(1.0)
    assert robot.growing() == NOTHING
    robot.modules[GUEST] = ("joining", 77)
    robot.watch()
    assert robot.growing() == ("grow", GUEST, SETTINGS.growth.n_new + SETTINGS.growth.n_check)
    assert robot.events == ["grow_started"]


@pytest.mark.parametrize(("name", "state"), [("", "up"), (GUEST, "lost"), (GUEST, "fault")])
def test_a_module_without_name_or_service_is_not(name: str, state: str) -> None:
    robot = Watched()
    robot.modules[name] = (state, 77)
    robot.watch(1.0)
    assert robot.growing() == NOTHING


def test_a_module_that_returns_is_refitted_and_another_of_its_name_is_not() -> None:
    for serial, kind in ((77, "refit"), (78, "grow")):
        robot = Watched(known={GUEST: 77})
        robot.modules[GUEST] = ("up", serial)
        robot.watch()
        assert robot.growing()[0] == kind


@pytest.mark.parametrize("state", ["lost", "fault", "joining", "gone"])
def test_a_muscle_without_service_for_long_shrinks_the_body(state: str) -> None:
    robot = Watched()
    if state == "gone":
        del robot.modules["biceps_1"]
    else:
        robot.modules["biceps_1"] = (state, 51)
    robot.watch(LOST_S - 0.05)
    assert robot.growing() == NOTHING
    robot.watch(0.1)
    assert robot.growing() == ("shrink", "biceps_1", SETTINGS.growth.n_check)
    growth = robot.body.growth
    assert growth is not None and growth.record.muscles == ("triceps", "biceps_2")
    assert robot.bench.arm.excluded == {"biceps_1"}


def test_a_muscle_that_was_plugged_in_again_at_once_is_not_taken_for_broken() -> None:
    """Its wire is wound in anew, so that its zero is another: shrunk away, then taken back."""
    robot = Watched()
    robot.modules["biceps_1"] = ("joining", 51)
    robot.watch(LOST_S + 0.05)
    assert robot.growing()[:2] == ("shrink", "biceps_1")
    assert robot.notebook.memory.refused == []


def test_a_version_that_is_chosen_meanwhile_ends_the_growth() -> None:
    robot = Watched()
    robot.modules[GUEST] = ("up", 77)
    robot.watch()
    chosen = version_of(SETTINGS.muscles, 7)
    growth = robot.body.growth
    assert growth is not None
    growth.record.base_version, growth.record.job = 7, "mine"
    robot.body.receive(chosen)
    assert robot.growing()[0] == "grow", "it began with that one"
    robot.body.receive(msgspec.structs.replace(chosen, version=8, job="mine"))
    assert robot.growing()[0] == "grow", "it brought that one"
    robot.body.receive(msgspec.structs.replace(chosen, version=6))
    assert robot.growing() == NOTHING
    assert robot.events[-1] == "grow_failed"


def test_a_muscle_that_a_chosen_version_lacks_waits_until_it_is_plugged_anew() -> None:
    robot = Watched()
    chosen = version_of(SETTINGS.muscles[:2], 9)
    robot.watch(0.1)
    robot.body.receive(chosen)
    robot.watch(2.0)
    last = SETTINGS.muscles[2]
    assert robot.growing() == NOTHING
    assert robot.notebook.memory.refused == [last]
    assert robot.events[-1] == "left_out"
    module = robot.modules.pop(last)
    robot.watch()
    robot.modules[last] = module
    robot.watch()
    assert robot.growing()[:2] == ("refit", last)


def test_a_short_absence_is_no_loss() -> None:
    robot = Watched()
    for _ in range(5):
        robot.modules["biceps_1"] = ("lost", 51)
        robot.watch(LOST_S - 0.05)
        robot.modules["biceps_1"] = ("up", 51)
        robot.watch(0.05)
    assert robot.growing() == NOTHING


def test_a_wire_that_carries_nothing_is_torn_and_is_not_taken_back_by_itself() -> None:
    robot = Watched()
    robot.bench.tension_n["biceps_2"] = 0.3
    robot.watch(TORN_S - 0.05)
    assert robot.growing() == NOTHING
    robot.watch(0.1)
    assert robot.growing()[:2] == ("shrink", "biceps_2")
    assert robot.notebook.memory.refused == ["biceps_2"]


def test_muscles_that_are_lost_together_are_tried_once_and_relied_on_when_they_return() -> None:
    robot = Watched()
    modules = dict(robot.modules)
    robot.modules.clear()
    robot.watch(5.0)
    assert robot.growing() == NOTHING
    assert robot.events.count("shrink_started") == robot.events.count("shrink_failed") == 3
    assert robot.bench.arm.excluded == set(SETTINGS.muscles)
    robot.modules = modules
    robot.watch(1.0)
    assert robot.bench.arm.excluded == set()
    assert robot.growing() == NOTHING


def fail(robot: Watched) -> None:
    growth = robot.body.growth
    assert growth is not None
    growth.record.job = "job"
    growth.receive(TrainingProgress(job="job", stage="failed", text="no data"))
    robot.watch()


def cancel(robot: Watched) -> None:
    robot.body.cancel("cancelled by 'cancel'")


@pytest.mark.parametrize("end", [fail, cancel])
def test_growth_that_failed_is_not_begun_again_until_plugged_anew(
    end: Callable[[Watched], None],
) -> None:
    robot = Watched()
    robot.modules[GUEST] = ("up", 77)
    robot.watch()
    end(robot)
    robot.watch(2.0)
    assert robot.growing() == NOTHING
    assert robot.events == ["grow_started", "grow_failed"]
    del robot.modules[GUEST]
    robot.watch()
    robot.modules[GUEST] = ("up", 77)
    robot.watch()
    assert robot.growing()[0] == "grow"


def test_a_shrinking_that_failed_is_not_begun_again() -> None:
    robot = Watched()
    del robot.modules["biceps_1"]
    robot.watch(1.0)
    fail(robot)
    robot.watch(3.0)
    assert robot.growing() == NOTHING
    assert robot.events == ["shrink_started", "shrink_failed"]
    assert robot.bench.arm.excluded == {"biceps_1"}


def test_a_refit_that_does_not_fit_is_learned_from_the_start() -> None:
    robot = Watched(known={GUEST: 77})
    robot.modules[GUEST] = ("up", 77)
    robot.watch()
    fail(robot)
    robot.watch()
    assert robot.events == ["refit_started", "refit_refused", "grow_started"]


def test_a_refit_that_is_cancelled_holds() -> None:
    robot = Watched(known={GUEST: 77})
    robot.modules[GUEST] = ("up", 77)
    robot.watch()
    cancel(robot)
    robot.watch(2.0)
    assert robot.growing() == NOTHING
    assert robot.events == ["refit_started", "refit_failed"]


def test_a_muscle_that_leaves_while_it_is_refitted_may_be_refitted_again() -> None:
    robot = Watched(known={GUEST: 77})
    robot.modules[GUEST] = ("up", 77)
    robot.watch()
    del robot.modules[GUEST]
    robot.watch(0.1)
    assert robot.growing() == NOTHING
    robot.modules[GUEST] = ("up", 77)
    robot.watch()
    assert robot.growing()[0] == "refit"


def test_another_muscle_that_is_lost_ends_the_growth() -> None:
    robot = Watched()
    robot.modules[GUEST] = ("up", 77)
    robot.watch()
    robot.modules["triceps"] = ("lost", 50)
    robot.watch(LOST_S + 0.05)
    assert robot.events[:2] == ["grow_started", "grow_failed"]
    assert robot.growing()[0] in ("", "shrink")
