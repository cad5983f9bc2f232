"""The demo's sequence: a task, a muscle plugged in while the arm holds, growth, the task again.

Written against `Session`, so that the live group and the rig run the very same script.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from dashboard.plots import MANY
from experiments.progress import Narrate
from experiments.score import Score, SweepScorer
from experiments.session import Session, SessionError
from runtime import messages as m
from runtime.messages import Message
from runtime.settings import RobotSettings

HOLD_AT = 0.2  # of the task's targets: where the arm holds while the muscle is plugged in
GROWTH_LIMIT_S = 900.0
TASK_LIMIT_S = 300.0
TRACE_NS = 50_000_000
STAGES = ("collect", "relearn", "adopt", "resume")


@dataclass
class Trace:
    """Angles and tensions over time, for the picture; one row each 50 ms of robot time."""

    settings: RobotSettings
    time_s: list[float] = field(default_factory=list)
    angle_deg: dict[str, list[float]] = field(
        default_factory=lambda: {"reference": [], "measured": [], "true": []}
    )
    tension_n: list[dict[str, float]] = field(default_factory=list)
    marks: list[tuple[float, str]] = field(default_factory=list)
    _reference: float = float("nan")
    _measured: float = float("nan")
    _chains: dict[str, m.ChainState] = field(default_factory=dict)
    _next_ns: int = 0

    def __post_init__(self) -> None:
        """The joint that is shown is the one that the task moves farthest."""
        targets = np.array(self.settings.task[0].targets_deg)
        self.joint = int(np.argmax(np.ptp(targets, axis=0)))

    def see(self, message: Message) -> None:
        """Take in what comes by."""
        if isinstance(message, m.ExecutiveState):
            if message.reference_rad:
                self._reference = float(np.degrees(message.reference_rad[self.joint]))
            if message.growing and message.stage in STAGES:
                self._mark(message.stage, message.stamp_ns)
        elif isinstance(message, m.JointState):
            name = self.settings.joints[self.joint]
            if name in message.joints:
                angle = message.angle_rad[message.joints.index(name)]
                self._measured = float(np.degrees(angle))
        elif isinstance(message, m.ChainState):
            self._chains[message.chain] = message
        elif isinstance(message, m.Event) and message.kind == "plugged":
            self._mark("plug", message.stamp_ns)
        elif isinstance(message, m.WorldTruth) and message.stamp_ns >= self._next_ns:
            self._next_ns = message.stamp_ns + TRACE_NS
            self.time_s.append(message.stamp_ns * 1e-9)
            self.angle_deg["reference"].append(self._reference)
            self.angle_deg["measured"].append(self._measured)
            self.angle_deg["true"].append(float(np.degrees(message.angle_rad[self.joint])))
            self.tension_n.append(
                {
                    name: tension
                    for state in self._chains.values()
                    for name, tension in zip(state.muscles, state.tension_n, strict=True)
                }
            )

    def _mark(self, label: str, stamp_ns: int) -> None:
        """The first moment of a stage: one that was interrupted comes again."""
        if label not in [name for _, name in self.marks]:
            self.marks.append((stamp_ns * 1e-9, label))

    def tensions(self) -> dict[str, list[float]]:
        """Muscle -> tension over time; NaN while it is not there."""
        names = dict.fromkeys(name for row in self.tension_n for name in row)
        if len(names) > MANY:
            names = dict.fromkeys(name for name in self.settings.alike if name in names)
        return {n: [row.get(n, float("nan")) for row in self.tension_n] for n in names}


@dataclass(frozen=True)
class Result:
    """What the demo shows."""

    before: Score
    after: Score
    n_new: int
    plug_to_resumed_s: float  # robot time
    relearn_s: float  # wall time
    peak_tension_n: float  # of any muscle, at any 1 ms step, everything included
    peak_target_speed_m_s: float  # of any module's target length, likewise


def run_sequence(session: Session, trace: Trace, narrate: Narrate, spare: str = "") -> Result:
    """Run the whole sequence; the arm ends parked.

    Raises:
        SessionError: the robot refused something, or did not finish it.
    """
    settings = session.settings
    spare = spare or settings.spare[0].name
    session.watchers.append(trace.see)
    session.wait(_in_stage("hold"), 60.0, "the arm holding")
    task = settings.task[0]
    before = score_task(session, task.name, narrate, f"{task.name} before")
    if task.back:
        narrate(task.back, 0, 1)
        _run_task(session, task.back)
        narrate(task.back, 1, 1)

    held_deg = task.targets_deg[int(HOLD_AT * len(task.targets_deg))]
    middle = {
        joint.name: float(np.radians(deg))
        for joint, deg in zip(settings.joint, held_deg, strict=True)
    }
    session.ask(m.Reach(angle_rad=middle))
    session.wait(_resting_at(tuple(middle.values())), 20.0, "the arm holding a posture")
    candidates: list[m.SchemaCandidate] = []
    session.watchers.append(
        lambda message: (
            candidates.append(message) if isinstance(message, m.SchemaCandidate) else None
        )
    )
    progress = GrowthProgress(narrate)
    session.watchers.append(progress.see)
    session.ask(m.Plug(muscle=spare))
    done = session.wait(_growth_over, GROWTH_LIMIT_S, "the body taking the muscle in")
    session.watchers.remove(progress.see)
    assert isinstance(done, m.Event)
    if done.kind != "grow_done":
        raise SessionError(done.text)
    plugged_s = next(t for t, label in trace.marks if label == "plug")

    after = score_task(session, task.name, narrate, f"{task.name} after")
    narrate("park", 0, 1)
    session.ask(m.Task(name="park"))
    session.wait(_event("task_done"), 30.0, "the arm parking")
    narrate("park", 1, 1)
    truth = session.wait(lambda x: isinstance(x, m.WorldTruth), 5.0, "the world's truth")
    assert isinstance(truth, m.WorldTruth)
    return Result(
        before=before,
        after=after,
        n_new=settings.growth.n_new,
        plug_to_resumed_s=done.stamp_ns * 1e-9 - plugged_s,
        relearn_s=candidates[-1].train_s if candidates else float("nan"),
        peak_tension_n=max(truth.peak_tension_n),
        peak_target_speed_m_s=max(truth.peak_target_speed_m_s),
    )


def score_task(session: Session, task: str, narrate: Narrate, title: str) -> Score:
    """Run a task and score it.

    Raises:
        SessionError: it was refused, or did not end.
    """
    scorer = SweepScorer(session.settings, task)
    told = (0, 1)

    def watch(message: Message) -> None:
        nonlocal told
        if not isinstance(message, m.ExecutiveState) or message.task != task:
            return
        if message.step != told[0]:
            told = (message.step, message.steps)
            narrate(title, message.step - 1, message.steps)

    session.watchers.append(watch)
    run_scored(session, scorer, task)
    session.watchers.remove(watch)
    narrate(title, told[1], told[1])
    return scorer.score


def run_scored(session: Session, scorer: SweepScorer, task: str) -> None:
    """Run a task under the scorer's eyes.

    Raises:
        SessionError: it was refused, did not end, or the arm never came to rest at a target.
    """
    session.watchers.append(scorer.see)
    done = _run_task(session, task)
    session.wait(_truth_after(done.stamp_ns), 5.0, "the world's truth of the task's end")
    session.watchers.remove(scorer.see)
    try:
        scorer.targets()
    except ValueError as error:
        raise SessionError(str(error)) from error


def _run_task(session: Session, task: str) -> Message:
    session.ask(m.Task(name=task))
    done = session.wait(_task_over, TASK_LIMIT_S, f"the task '{task}'")
    assert isinstance(done, m.Event)
    if done.kind != "task_done":
        raise SessionError(f"the task '{task}' broke off: {done.text}")
    return done


class GrowthProgress:
    """Tells how far joining, collecting and relearning are; a stage that is over is told as full.

    The last motions are collected while relearning goes on already.
    """

    def __init__(self, narrate: Narrate) -> None:
        self._narrate = narrate
        self._stage = ""
        self._open: dict[str, tuple[int, int]] = {}  # title -> step and steps, as told

    def see(self, message: Message) -> None:
        """Take in what comes by."""
        if isinstance(message, m.ExecutiveState) and message.growing:
            if message.stage not in ("join", *STAGES):
                return  # it waits for readings: no stage is over
            stage = self._stage = message.stage
            self._close({"relearn": ("collect", "relearn")}.get(stage, (stage,)))
            if stage not in ("collect", "relearn"):
                self._tell(stage, 0, 1)
            elif stage == "collect" or "collect" in self._open:
                self._tell("collect", message.step, message.steps)
        elif isinstance(message, m.TrainingProgress):
            if self._stage == "relearn" and message.epochs:
                self._tell("relearn", message.epoch, message.epochs)
        elif isinstance(message, m.Event) and message.kind == "grow_done":
            self._close()

    def _tell(self, title: str, step: int, steps: int) -> None:
        if self._open.get(title) != (step, steps):
            self._open[title] = (step, steps)
            self._narrate(title, step, steps)

    def _close(self, but: tuple[str, ...] = ()) -> None:
        for title in [title for title in self._open if title not in but]:
            step, steps = self._open.pop(title)
            if step < steps:
                self._narrate(title, steps, steps)


def _in_stage(stage: str) -> Callable[[Message], bool]:
    return lambda message: isinstance(message, m.ExecutiveState) and message.stage == stage


def _truth_after(stamp_ns: int) -> Callable[[Message], bool]:
    return lambda message: isinstance(message, m.WorldTruth) and message.stamp_ns >= stamp_ns


def _event(kind: str) -> Callable[[Message], bool]:
    return lambda message: isinstance(message, m.Event) and message.kind == kind


def _resting_at(goal_rad: tuple[float, ...]) -> Callable[[Message], bool]:
    return lambda message: (
        isinstance(message, m.ExecutiveState)
        and message.settled
        and message.stage == "hold"
        and np.allclose(message.reference_rad, goal_rad, atol=1e-3)
    )


def _task_over(message: Message) -> bool:
    return isinstance(message, m.Event) and message.kind in ("task_done", "grasp_failed")


def _growth_over(message: Message) -> bool:
    return isinstance(message, m.Event) and message.kind in ("grow_done", "grow_failed")
