"""The executive in the rig: tasks, postures, stops, silence, and what outlives it."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec
import numpy as np
import pytest

from experiments.rig import Rig
from runtime import messages as m
from runtime.logic import MemoryStore
from runtime.messages import Message, Reply
from runtime.settings import RobotSettings, TaskPath, load_robot
from services.logic.arm import Arm
from services.logic.body import MAX_RESTARTS
from services.logic.executive import Executive
from services.logic.growth import GrowthRecord
from services.logic.memory import Memory
from services.logic.skeleton import Skeleton

NOD = TaskPath(name="nod", targets_deg=((20.0,), (35.0,), (10.0,)))


def elbow() -> RobotSettings:
    return msgspec.structs.replace(load_robot("elbow"), task=(NOD,))


SETTINGS = elbow()
SKELETON = Skeleton(SETTINGS.body_file, SETTINGS.joints)


def new_executive(store: MemoryStore) -> Executive:
    return Executive(SETTINGS, Arm(SETTINGS, SKELETON), store)


class Robot:
    """A rig and short words for what tests ask of it."""

    def __init__(self) -> None:
        self.rig = Rig(SETTINGS)
        self.states: list[m.ExecutiveState] = []
        self.rig.watchers.append(self._hear)
        self.until(lambda: self.stage == "hold", 5.0)

    def _hear(self, message: Message) -> None:
        if isinstance(message, m.ExecutiveState):
            self.states.append(message)

    @property
    def state(self) -> m.ExecutiveState | None:
        return self.states[-1] if self.states else None

    @property
    def stage(self) -> str:
        return self.states[-1].stage if self.states else ""

    @property
    def angle_deg(self) -> float:
        """What it truly is."""
        return float(np.degrees(self.rig.robot.truth().angle_rad[0]))

    @property
    def reference_deg(self) -> float:
        return float(np.degrees(self.states[-1].reference_rad[0]))

    def until(self, condition: Callable[[], bool], limit_s: float) -> None:
        self.rig.run_until(condition, limit_s)

    def settle(self, limit_s: float = 10.0) -> None:
        self.rig.run(0.1)
        self.until(lambda: self.states[-1].settled and self.stage == "hold", limit_s)

    def kinds(self) -> list[str]:
        return [event.kind for event in self.rig.events]

    def ask(self, request: Message) -> Reply:
        return self.rig.ask(request)


@pytest.fixture
def robot() -> Iterator[Robot]:
    yield Robot()


# ── tasks and postures ────────────────────────────────────────────────────────────────────────


def test_it_holds_where_it_is_until_asked(robot: Robot) -> None:
    before = robot.angle_deg
    robot.rig.run(1.0)
    assert robot.stage == "hold"
    assert robot.angle_deg == pytest.approx(before, abs=1.5)


def test_a_task_goes_through_its_targets_and_rests_at_each(robot: Robot) -> None:
    reply = robot.ask(m.Task(name="nod"))
    assert reply.ok and reply.text == "task 'nod' started: 3 targets"
    robot.until(lambda: "task_done" in robot.kinds(), 20.0)
    at_rest = {
        state.step: np.degrees(state.reference_rad[0])
        for state in robot.states
        if state.settled
        if state.task == "nod"
    }
    assert at_rest == pytest.approx({1: 20.0, 2: 35.0, 3: 10.0})
    assert {state.stage for state in robot.states if state.task} == {"move"}
    assert {state.steps for state in robot.states if state.task} == {3}
    robot.rig.run(0.1)
    assert robot.stage == "hold"
    assert robot.angle_deg == pytest.approx(10.0, abs=1.5)


def test_reach_goes_there_and_holds(robot: Robot) -> None:
    assert robot.ask(m.Reach(angle_rad={"elbow": float(np.radians(50.0))})).ok
    robot.rig.run(0.1)
    assert robot.stage == "move"
    robot.settle()
    assert robot.angle_deg == pytest.approx(50.0, abs=1.5)
    truth = robot.rig.robot.truth()
    assert max(truth.peak_tension_n) < SETTINGS.module.tension_limit_n
    assert max(truth.peak_target_speed_m_s) <= SETTINGS.module.winding_speed_m_s


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (m.Task(name="swim"), "no task 'swim' in the robot file; there is cancel, hold, nod, p"),
        (m.Reach(angle_rad={"knee": 0.1}), "no joint 'knee'; there is elbow"),
        (m.Reach(angle_rad={"elbow": 2.5}), "joint 'elbow' reaches -5 .. 130 deg"),
        (m.Reach(angle_rad={"elbow": float("nan")}), "joint 'elbow' reaches -5 .. 130 deg"),
        (m.Relearn(method="v"), "method is one of i, ii, iii, iv, and n_new"),
        (m.Relearn(n_new=0), "method is one of i, ii, iii, iv, and n_new"),
        (m.Plug(muscle="biceps_1"), "the executive does not know Plug"),
    ],
)
def test_what_cannot_be_is_refused_in_words(request_: Message, words: str) -> None:
    robot = shared()
    reply = robot.rig.executive.answer(request_, robot.rig.now_ns)
    assert not reply.ok
    assert reply.text.startswith(words)


_shared: list[Robot] = []


def shared() -> Robot:
    """One robot for tests that change nothing."""
    if not _shared:
        _shared.append(Robot())
    return _shared[0]


def test_what_no_tensions_hold_is_refused_and_told_once_when_it_is_so(robot: Robot) -> None:
    assert robot.ask(m.Reach(angle_rad={"elbow": float(np.radians(60.0))})).ok
    robot.settle()
    assert "not_held" not in robot.kinds()
    control = msgspec.structs.replace(SETTINGS.control, tension_ceiling_n=10.0)
    weak = msgspec.structs.replace(SETTINGS, control=control)
    robot.rig.executive.settings = robot.rig.executive.arm.settings = weak
    for request in (m.Reach(angle_rad={"elbow": float(np.radians(90.0))}), m.Task(name="nod")):
        reply = robot.ask(request)
        assert not reply.ok
        assert "no tensions up to 10 N hold that posture" in reply.text
        assert "Nm are missing at joint 'elbow'" in reply.text
    assert robot.ask(m.Task(name="park")).ok  # whatever is left, that is the best it can do
    robot.ask(m.Task(name="hold"))
    robot.rig.run(2.0)
    assert robot.kinds().count("not_held") == 1


def test_nothing_can_be_reached_before_the_arm_is_heard() -> None:
    executive = new_executive(MemoryStore())
    reply = executive.answer(m.Reach(angle_rad={"elbow": 0.5}), 0)
    assert not reply.ok and reply.text.startswith("the arm cannot move now")
    assert not executive.answer(m.Relearn(), 0).ok
    assert executive.answer(m.Task(name="hold"), 0).ok
    (state,) = [x for t in (10, 20) for x in executive.tick(t * 1_000_000)]
    assert isinstance(state, m.ExecutiveState)
    assert (state.stage, state.text) == ("waiting", "chain 'arm' is silent")


def test_park_ends_a_task_and_goes_to_rest(robot: Robot) -> None:
    robot.ask(m.Task(name="nod"))
    robot.rig.run(1.2)
    assert robot.ask(m.Task(name="park")).ok
    robot.rig.run(0.1)
    assert robot.stage == "park"
    robot.until(lambda: "task_done" in robot.kinds(), 10.0)
    robot.rig.run(0.1)
    assert robot.stage == "hold"
    assert robot.angle_deg == pytest.approx(SETTINGS.joint[0].rest_deg, abs=1.5)


@pytest.mark.parametrize("word", ["cancel", "hold"])
def test_cancel_stops_on_the_way_without_a_jerk(robot: Robot, word: str) -> None:
    robot.ask(m.Reach(angle_rad={"elbow": float(np.radians(90.0))}))
    robot.rig.run(0.9)
    reference = robot.reference_deg
    assert 5.0 < reference < 80.0
    assert robot.ask(m.Task(name=word)).text == "holding"
    robot.settle()
    assert robot.reference_deg == pytest.approx(reference, abs=2.0)
    steps = np.abs(np.diff([s.reference_rad[0] for s in robot.states if s.reference_rad]))
    assert np.degrees(steps.max()) <= SETTINGS.control.joint_speed_deg_s * 0.025


# ── stops and silence ─────────────────────────────────────────────────────────────────────────


def test_estop_latches_and_reset_holds_where_the_arm_is(robot: Robot) -> None:
    robot.ask(m.Reach(angle_rad={"elbow": float(np.radians(60.0))}))
    robot.settle()
    assert robot.ask(m.Estop(reason="test")).ok
    robot.rig.run(0.2)
    assert robot.stage == "stopped"
    assert robot.states[-1].text == "stopped; clear with 'myograft reset'"
    for request in (m.Task(name="nod"), m.Reach(angle_rad={"elbow": 0.3}), m.Relearn()):
        reply = robot.ask(request)
        assert not reply.ok and "myograft reset" in reply.text
    robot.until(lambda: max(robot.rig.robot.truth().tension_n) < 5.0, 10.0)
    robot.rig.run(1.0)
    assert robot.stage == "stopped"
    sunk = robot.angle_deg
    assert sunk < 30.0
    assert robot.ask(m.Reset()).ok
    robot.until(lambda: robot.stage == "hold", 5.0)
    robot.rig.run(2.0)
    assert robot.stage == "hold"
    assert robot.angle_deg == pytest.approx(sunk, abs=6.0)
    robot.ask(m.Reach(angle_rad={"elbow": float(np.radians(40.0))}))
    robot.settle()
    assert robot.angle_deg == pytest.approx(40.0, abs=1.5)


def test_when_a_chain_falls_silent_everything_waits_and_goes_on(robot: Robot) -> None:
    robot.ask(m.Task(name="nod"))
    robot.until(lambda: bool(robot.state and robot.state.step == 2), 10.0)
    robot.rig.run(0.15)
    robot.ask(m.Fault(kind="drop", target="arm", amount=1.0))
    robot.rig.run(0.3)
    assert robot.stage == "waiting"
    assert robot.states[-1].text in ("chain 'arm' is silent", "joint 'elbow' is silent")
    robot.rig.run(0.3)
    robot.ask(m.Fault(kind="drop", target="arm", amount=0.0))
    robot.until(lambda: robot.stage == "move", 5.0)
    assert robot.state is not None and robot.state.step == 2  # no step was counted meanwhile
    robot.until(lambda: "task_done" in robot.kinds(), 20.0)
    assert robot.angle_deg == pytest.approx(10.0, abs=1.5)
    assert max(robot.rig.robot.truth().peak_tension_n) < 100.0
    assert not [kind for kind in robot.kinds() if kind.startswith("shrink")]


def test_a_posture_asked_for_in_a_short_silence_is_reached_after_it(robot: Robot) -> None:
    robot.ask(m.Fault(kind="drop", target="arm", amount=1.0))
    robot.rig.run(0.3)
    assert robot.stage == "waiting"
    assert robot.ask(m.Reach(angle_rad={"elbow": float(np.radians(30.0))})).ok
    robot.ask(m.Fault(kind="drop", target="arm", amount=0.0))
    robot.settle()
    assert robot.angle_deg == pytest.approx(30.0, abs=1.5)


# ── growing, cancelled ────────────────────────────────────────────────────────────────────────


@pytest.fixture(scope="module")
def collecting() -> Robot:
    """A robot in the middle of taking a muscle in. The tests below run on in its order."""
    robot = Robot()
    assert robot.ask(m.Plug(muscle="biceps_3")).ok
    robot.until(lambda: robot.stage == "collect", 30.0)
    robot.rig.run(0.5)
    return robot


def test_while_the_body_grows_nothing_else_is_begun(collecting: Robot) -> None:
    state = collecting.states[-1]
    assert (state.growing, state.steps) == ("biceps_3", 9)
    for request in (m.Task(name="nod"), m.Reach(angle_rad={"elbow": 0.3}), m.Relearn()):
        reply = collecting.ask(request)
        assert not reply.ok and "growing" in reply.text


def test_growth_can_be_cancelled_and_the_guest_is_left_in_peace(collecting: Robot) -> None:
    assert collecting.ask(m.Task(name="cancel")).ok
    collecting.rig.run(1.5)
    assert collecting.stage == "hold"
    assert collecting.states[-1].growing == ""
    event = next(e for e in collecting.rig.events if e.kind == "grow_failed")
    assert event.text == (
        "'biceps_3' is not taken in and the arm holds: cancelled by 'cancel'; "
        "to try again: myograft unplug biceps_3 && myograft plug biceps_3"
    )
    assert collecting.kinds().count("grow_started") == 1
    collecting.ask(m.Reach(angle_rad={"elbow": float(np.radians(45.0))}))
    collecting.settle()
    assert collecting.angle_deg == pytest.approx(45.0, abs=2.0)


def test_plugged_anew_it_is_tried_again_and_a_guest_that_leaves_ends_it(collecting: Robot) -> None:
    collecting.ask(m.Unplug(muscle="biceps_3"))
    collecting.rig.run(0.5)
    collecting.ask(m.Plug(muscle="biceps_3"))
    collecting.until(lambda: collecting.kinds().count("grow_started") == 2, 10.0)
    collecting.until(lambda: collecting.stage == "collect", 30.0)
    collecting.rig.run(0.3)
    collecting.ask(m.Unplug(muscle="biceps_3"))
    collecting.rig.run(1.0)
    last = [e for e in collecting.rig.events if e.kind == "grow_failed"][-1]
    assert "a muscle left meanwhile" in last.text
    assert last.text.endswith("once it is back: myograft plug biceps_3")
    collecting.settle()
    assert collecting.states[-1].muscles == SETTINGS.muscles
    assert not [kind for kind in collecting.kinds() if kind.startswith("shrink")]


# ── memory ────────────────────────────────────────────────────────────────────────────────────


def successor(robot: Robot, store: MemoryStore) -> Executive:
    """Another executive in the rig in place of the one that was killed."""
    rig = robot.rig
    executive = new_executive(store)
    rig.remove(rig.executive)
    rig.executive = rig.add(executive)
    executive.resume()
    for kind in (m.ChainBody, m.SchemaVersion):  # what the bus retains
        executive.receive(rig.last[kind], rig.now_ns)
    return executive


def test_a_killed_executive_goes_on_with_its_task(robot: Robot) -> None:
    store = robot.rig.executive._notebook._store
    robot.ask(m.Task(name="nod"))
    robot.until(lambda: bool(robot.state and robot.state.step == 3), 10.0)
    robot.rig.run(0.1)
    before = robot.angle_deg
    successor(robot, store)
    robot.rig.run(0.15)
    assert robot.state is not None
    assert (robot.state.task, robot.state.step) == ("nod", 3)
    assert robot.angle_deg == pytest.approx(before, abs=4.0)
    robot.until(lambda: "task_done" in robot.kinds(), 20.0)
    assert robot.angle_deg == pytest.approx(10.0, abs=1.5)
    assert max(robot.rig.robot.truth().peak_tension_n) < 100.0


def test_a_killed_executive_holds_the_posture_that_was_asked_for(robot: Robot) -> None:
    store = robot.rig.executive._notebook._store
    robot.ask(m.Reach(angle_rad={"elbow": float(np.radians(30.0))}))
    robot.rig.run(0.3)
    successor(robot, store)
    robot.settle()
    assert robot.angle_deg == pytest.approx(30.0, abs=1.5)


def remembered(memory: Memory) -> MemoryStore:
    return MemoryStore(memory=msgspec.msgpack.encode(memory))


def recalled(store: MemoryStore) -> Memory:
    executive = new_executive(store)
    executive._notebook.save()
    return msgspec.msgpack.decode(store["memory"], type=Memory)


def test_memory_comes_back_whole() -> None:
    memory = Memory(
        task="nod", step=2, goal_rad=(0.5,), growth=a_record(), known={"x": 2**60}, refused=["y"]
    )
    assert recalled(remembered(memory)) == memory


@pytest.mark.parametrize(
    "memory",
    [
        Memory(task="sweep", step=1, goal_rad=(0.1,)),  # of a task that is gone from the file
        Memory(task="nod", step=3, goal_rad=(0.1,)),  # of a task that was longer
        Memory(goal_rad=(0.1, 0.2)),  # of an arm with more joints
    ],
)
def test_memory_of_another_robot_file_is_forgotten_but_for_modules(memory: Memory) -> None:
    memory.known = {"biceps_3": 7}
    assert recalled(remembered(memory)) == Memory(known={"biceps_3": 7})


@pytest.mark.parametrize("data", [b"", b"\x00\x01", b"\x81\xa4task\x05"])
def test_a_torn_memory_is_no_reason_not_to_hold(data: bytes) -> None:
    assert recalled(MemoryStore(memory=data)) == Memory()


def a_record() -> GrowthRecord:
    return GrowthRecord(
        kind="grow",
        muscle="biceps_3",
        muscles=(*SETTINGS.muscles, "biceps_3"),
        base_version=1,
        method="iii",
        seed=0,
        n_new=1,
        n_check=1,
        return_rad=(0.5,),
        targets=(),
        motions=[],
    )


def test_growth_that_failed_twice_is_given_up() -> None:
    store = remembered(Memory(growth=a_record()))
    for _ in range(MAX_RESTARTS):
        executive = new_executive(store)
        executive.resume()
        memory = msgspec.msgpack.decode(store["memory"], type=Memory)
        assert memory.growth is not None
    executive = new_executive(store)
    executive.resume()
    memory = msgspec.msgpack.decode(store["memory"], type=Memory)
    assert memory.growth is None
    assert memory.refused == ["biceps_3"]
    (event,) = [x for x in executive.tick(10_000_000) if isinstance(x, m.Event)]
    assert event.kind == "growth_given_up"
    assert event.text.endswith("try again: myograft unplug biceps_3 && myograft plug biceps_3")


def test_a_schema_that_is_torn_is_told_and_the_present_one_stays() -> None:
    robot = shared()
    executive, before = robot.rig.executive, robot.rig.executive.arm.schema
    good = robot.rig.last[m.SchemaVersion]
    assert isinstance(good, m.SchemaVersion)
    bad = msgspec.structs.replace(good, version=9, data=good.data[:100])
    executive.receive(bad, robot.rig.now_ns)
    assert executive.arm.schema is before
    robot.rig.run(0.05)
    assert "schema_bad" in robot.kinds()
