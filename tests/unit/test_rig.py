"""The demo's whole sequence in the rig, once; then the grown robot loses its muscle and regains it.

Training takes seconds: the tests of the grown robot share one and run on from each other, in order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import msgspec
import numpy as np
import pytest

from experiments.rig import Rig, RigTimeoutError
from experiments.sequence import Result, Trace, run_sequence
from experiments.session import RigSession, SessionError
from runtime import messages as m
from runtime.messages import Message
from runtime.settings import load_robot
from services.body_schema.schema import Schema
from tests.unit.schemas import untrained

SETTINGS = load_robot("elbow")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]


@dataclass
class Demo:
    """What the sequence left behind."""

    rig: Rig
    result: Result
    trace: Trace
    told: list[tuple[str, int, int]]


@pytest.fixture(scope="module")
def demo() -> Demo:
    rig, trace = Rig(SETTINGS), Trace(SETTINGS)
    told: list[tuple[str, int, int]] = []
    result = run_sequence(RigSession(rig), trace, lambda *row: told.append(row))
    return Demo(rig, result, trace, told)


def truth(rig: Rig) -> m.WorldTruth:
    return rig.robot.truth()


def angle_deg(rig: Rig) -> float:
    return float(np.degrees(truth(rig).angle_rad[0]))


def heard(rig: Rig, kind: str) -> bool:
    return any(event.kind == kind for event in rig.events)


def reach(rig: Rig, degrees: float) -> None:
    assert rig.ask(m.Reach(angle_rad={"elbow": float(np.radians(degrees))})).ok
    rig.run(0.1)

    def settled() -> bool:
        state = rig.last[m.ExecutiveState]
        assert isinstance(state, m.ExecutiveState)
        return state.settled and state.stage == "hold"

    rig.run_until(settled, 15.0, "the arm at rest")


# ── the demo ──────────────────────────────────────────────────────────────────────────────────


def test_the_demo_keeps_the_bounds_that_were_set(demo: Demo) -> None:
    before, after = demo.result.before, demo.result.after
    assert before.e_theta_rad <= 0.025
    assert after.e_theta_rad <= 1.25 * before.e_theta_rad
    assert after.sigma_f_n <= 0.6 * before.sigma_f_n
    assert demo.result.peak_tension_n <= 150.0
    assert demo.result.peak_target_speed_m_s <= 0.25
    assert demo.result.plug_to_resumed_s <= 30.0
    assert demo.result.n_new == 7


def test_the_demo_ends_parked_with_a_schema_of_four_muscles(demo: Demo) -> None:
    version = demo.rig.last[m.SchemaVersion]
    assert isinstance(version, m.SchemaVersion)
    assert version.version == 2 and version.muscles == (*SETTINGS.muscles, "biceps_3")
    assert Schema.from_bytes(version.data).muscles == version.muscles
    assert all(0.0 < mm < SETTINGS.growth.residual_limit_mm for mm in version.residual_mm.values())


def test_every_step_is_an_event_in_order(demo: Demo) -> None:
    kinds = [event.kind for event in demo.rig.events]
    story = ["adopted", "task_done", "plugged", "grow_started", "joined", "checked", "adopted",
             "grow_done", "task_done", "task_done"]  # fmt: skip
    left = iter(kinds)
    assert all(kind in left for kind in story), kinds
    assert not [event for event in demo.rig.events if event.level == "error"]


def test_the_story_is_told_step_by_step(demo: Demo) -> None:
    titles = list(dict.fromkeys(title for title, _, _ in demo.told))
    assert titles[0] == "sweep before"
    assert titles[-2:] == ["sweep after", "park"]
    assert {"collect", "relearn", "resume"} <= set(titles)
    assert [step for title, step, _ in demo.told if title == "sweep before"][:16] == [*range(16)]


def test_the_trace_shows_what_was_asked_measured_and_true(demo: Demo) -> None:
    trace = demo.trace
    assert np.diff(trace.time_s) == pytest.approx(0.05, abs=1e-6)
    true, measured = np.array(trace.angle_deg["true"]), np.array(trace.angle_deg["measured"])
    assert np.nanmax(np.abs(true - measured)) < 3.0
    assert [label for _, label in trace.marks] == ["plug", "collect", "relearn", "adopt", "resume"]
    plug_s = trace.marks[0][0]
    third = np.array(trace.tensions()["biceps_3"])
    late = np.array(trace.time_s) > plug_s + 5.0  # wound in by then
    assert np.isnan(third[~late]).sum() > 100
    assert np.isfinite(third[late]).all()


def test_services_never_see_the_truth(demo: Demo) -> None:
    assert len(demo.rig.logics) == 4
    for logic in demo.rig.logics:
        assert m.WorldTruth not in logic.inputs, type(logic).__name__
    assert m.WorldTruth not in demo.rig._readers


# ── a muscle leaves and returns ───────────────────────────────────────────────────────────────


@pytest.mark.parametrize("degrees", [40.0, 100.0])
def test_without_its_muscle_the_grown_robot_goes_on(demo: Demo, degrees: float) -> None:
    rig = demo.rig
    if not heard(rig, "shrink_done"):
        reach(rig, 60.0)
        assert rig.ask(m.Unplug(muscle="biceps_3")).ok
        rig.run_until(lambda: heard(rig, "shrink_done"), 60.0, "the body shrunk")
    version = rig.last[m.SchemaVersion]
    assert isinstance(version, m.SchemaVersion)
    assert (version.muscles, version.method) == (SETTINGS.muscles, "shrink")
    reach(rig, degrees)
    assert angle_deg(rig) == pytest.approx(degrees, abs=2.0)
    assert max(truth(rig).peak_tension_n) <= 150.0


def test_a_muscle_that_returns_is_known_by_its_serial_number_and_refitted(demo: Demo) -> None:
    rig = demo.rig
    assert heard(rig, "shrink_done"), "runs on from the test above"
    assert rig.ask(m.Plug(muscle="biceps_3")).ok
    rig.run_until(lambda: heard(rig, "refit_done"), 120.0, "the muscle taken back")
    version = rig.last[m.SchemaVersion]
    assert isinstance(version, m.SchemaVersion)
    assert (version.muscles, version.method) == ((*SETTINGS.muscles, "biceps_3"), "refit")
    serials = [e.data["serial"] for e in rig.events if e.kind == "plugged"]
    assert len(serials) == 2 and len(set(serials)) == 1
    reach(rig, 80.0)
    assert angle_deg(rig) == pytest.approx(80.0, abs=2.0)
    assert min(truth(rig).tension_n) > 2.0  # all four pull
    assert max(truth(rig).peak_tension_n) <= 150.0


# ── the same again ────────────────────────────────────────────────────────────────────────────


class Never:
    """A training job that does not end."""

    def done(self) -> bool:
        return False

    def result(self) -> Schema:
        return untrained()


def shortened(seed: int) -> list[Message]:
    """Every message of a reach, a plug and the motions up to the training job."""
    growth = msgspec.structs.replace(SETTINGS.growth, n_new=1, n_check=1)
    rig = Rig(msgspec.structs.replace(SETTINGS, growth=growth), seed)
    rig.retrainer._start_job = lambda work: Never()
    said: list[Message] = []
    rig.watchers.append(said.append)
    rig.run(0.5)
    reach(rig, 35.0)
    rig.ask(m.Plug(muscle="biceps_3"))
    rig.run_until(lambda: m.TrainingJob in rig.last, 60.0, "the training job")
    return said


def test_two_runs_with_one_seed_are_identical_and_another_seed_differs() -> None:
    first, second, other = shortened(1), shortened(1), shortened(2)
    assert len(first) > 4000
    assert first == second
    assert first != other


# ── the rig itself ────────────────────────────────────────────────────────────────────────────


@pytest.fixture
def rig() -> Rig:
    return Rig(SETTINGS)


def test_what_does_not_come_ends_in_words(rig: Rig) -> None:
    with pytest.raises(RigTimeoutError, match="the moon did not hold within"):
        rig.run_until(lambda: False, 0.01, "the moon")
    with pytest.raises(SessionError, match="a letter did not hold within"):
        RigSession(rig).wait(lambda message: False, 0.01, "a letter")


def test_a_session_hears_the_first_message_that_fits(rig: Rig) -> None:
    session = RigSession(rig)
    seen: list[Message] = []
    session.watchers.append(seen.append)
    state = session.wait(lambda x: isinstance(x, m.ChainState), 2.0, "a chain state")
    assert isinstance(state, m.ChainState) and state.muscles == SETTINGS.muscles
    assert next(x for x in seen if isinstance(x, m.ChainState)) is state


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (m.Plug(muscle="wing"), "no spare 'wing'"),
        (m.Unplug(muscle="wing"), "no muscle 'wing' is plugged in"),
        (m.Fault(kind="rupture", target="wing"), "nothing called 'wing'"),
        (m.Task(name="dance"), "no task 'dance'"),
        (m.SchemaRequest(action="paint"), "'paint' is neither list nor rollback"),
    ],
)
def test_what_is_refused_is_an_error_of_the_session(
    rig: Rig, request_: Message, words: str
) -> None:
    with pytest.raises(SessionError, match=words):
        RigSession(rig).ask(request_)


def test_without_services_the_drivers_hold_the_arm_alone() -> None:
    rig = Rig(SETTINGS, services=False)
    rig.run(1.0)
    before = angle_deg(rig)
    rig.run(1.0)
    assert angle_deg(rig) == pytest.approx(before, abs=0.2)
    assert m.ExecutiveState not in rig.last
    assert rig.ask(m.Task(name="park")).text == "nobody answers Task"


class Counter:
    """A logic that counts its ticks."""

    inputs: tuple[type[Message], ...] = (m.JointState,)
    requests: tuple[type[Message], ...] = ()
    period_ns = 20_000_000

    def __init__(self) -> None:
        self.ticks: list[int] = []
        self.heard = 0

    def receive(self, message: Message, now_ns: int) -> None:
        self.heard += 1

    def tick(self, now_ns: int) -> list[Message]:
        self.ticks.append(now_ns)
        return []


def test_logics_tick_at_their_period_and_after_what_they_hear(rig: Rig) -> None:
    deaf, hearing = Counter(), Counter()
    deaf.inputs = ()
    rig.run(0.5)
    rig.add(deaf)
    rig.add(hearing)
    rig.run(0.2)
    assert np.diff(deaf.ticks) == pytest.approx(20_000_000)
    assert hearing.heard == pytest.approx(40, abs=2)  # at 200 Hz
    assert len(hearing.ticks) >= hearing.heard


def test_figures_are_finite(demo: Demo) -> None:
    for score in (demo.result.before, demo.result.after):
        assert all(math.isfinite(x) for x in (score.e_theta_rad, score.sigma_f_n))
    assert demo.result.relearn_s > 0.0
