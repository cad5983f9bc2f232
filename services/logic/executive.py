"""The only author of muscle commands: tasks, postures, growth of the body, and holding.

What the executive is about (task and step, growth record) is in its store, so that one that was
killed goes on where it was. Time passes for a movement only while the arm can be moved: when a
chain falls silent everything waits and then goes on from what the arm does.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator

import msgspec
import numpy as np

from runtime import messages as m
from runtime.logic import Store
from runtime.messages import Message, Reply
from runtime.settings import RobotSettings
from runtime.suggestion import suggestion
from services.body_schema.network import Array
from services.logic.arm import AUTHOR, NO_SCHEMA, Arm
from services.logic.body import Body
from services.logic.hands import Hands
from services.logic.memory import Notebook

MEASURE_S = 0.2  # the arm is called settled for this long at each target
STATE_EVERY = 2  # ticks
UNHELD_S = 1.0  # for so long no tensions hold the arm, then it is told
MAX_STEP_S = 0.02  # of movement in one tick, however long it was
RELEARN = f"method is one of {', '.join(m.METHODS)}, and n_new from 1 to 100"
GROWING = Reply(ok=False, text="the body is growing; wait, or 'myograft task cancel'")


class Executive:
    """Messages in, `ChainCommand` and `ExecutiveState` out, 100 times a robot second."""

    inputs: tuple[type[Message], ...] = (
        m.ChainBody,
        m.ChainState,
        m.JointState,
        m.SchemaVersion,
        m.SchemaCandidate,
        m.TrainingProgress,
        m.HandState,
        m.Event,
    )
    requests: tuple[type[Message], ...] = (m.Task, m.Reach, m.Relearn)
    period_ns = 10_000_000

    def __init__(self, settings: RobotSettings, arm: Arm, store: Store, seed: int = 0) -> None:
        self.settings = settings
        self.arm = arm
        self._tasks = {
            task.name: np.radians(np.array(task.targets_deg)) for task in settings.task
        } | {"park": np.radians(np.array([[joint.rest_deg for joint in settings.joint]]))}
        self._carrying = {task.name: task for task in settings.task if task.payload}
        steps = {name: len(targets) for name, targets in self._tasks.items()}
        self._notebook = Notebook(store, steps, len(settings.joint))
        self._memory = self._notebook.memory
        self.hands = Hands(settings.payload, arm.skeleton, self._memory.holding)
        self._events: list[m.Event] = []
        self.body = Body(self.arm, self._notebook, seed, self._event)
        self._next_ns = 0
        self._last_ns = 0
        self._ticks = 0
        self._was_silent = True
        self._under_way = False  # towards the present step's target
        self._unheld_s = 0.0

    # ── in ────────────────────────────────────────────────────────────────────────────────────

    def receive(self, message: Message, now_ns: int) -> None:
        """Take in what drivers and retrainer say."""
        if isinstance(message, (m.SchemaVersion, m.TrainingProgress)):
            self.body.receive(message)
        elif isinstance(message, m.HandState):
            self.hands.receive(message)
        elif isinstance(message, m.Event):
            if message.kind == "plugged":
                self.body.plugged(message.data)
        else:
            self.arm.receive(message)

    def answer(self, request: Message, now_ns: int) -> Reply:
        """Tasks, postures and relearning; refused in words when they cannot be done now."""
        if isinstance(request, m.Task) and request.name in ("hold", "cancel"):
            return self._cancel(request.name)
        if self.arm.stopped:
            return Reply(ok=False, text="the robot is stopped; clear that with 'myograft reset'")
        if isinstance(request, m.Task):
            return self._start_task(request.name)
        if isinstance(request, m.Reach):
            return self._start_reach(request)
        if isinstance(request, m.Relearn):
            return self._start_relearn(request, now_ns)
        return Reply(ok=False, text=f"the executive does not know {type(request).__name__}")

    # ── out ───────────────────────────────────────────────────────────────────────────────────

    def tick(self, now_ns: int) -> Iterator[Message]:
        """Move on by one tick, when one is due."""
        if now_ns < self._next_ns:
            return
        late = now_ns - self._next_ns > self.period_ns
        self._next_ns = now_ns + self.period_ns if late else self._next_ns + self.period_ns
        dt_s = min((now_ns - self._last_ns) * 1e-9, MAX_STEP_S) if self._last_ns else 0.01
        self._last_ns = now_ns
        self._ticks += 1
        silent = self.arm.silent(now_ns)
        if silent == NO_SCHEMA and self.body.learns_first:
            self.body.draw()
            silent = ""
        stage, text = "waiting", silent
        if not silent and self.arm.stopped:
            stage, text = "stopped", "stopped; clear with 'myograft reset'"
            self._abandon()
        elif not silent:
            if self._was_silent:
                self.arm.anchor()
                self._under_way = False
            yield from self.hands.tick(now_ns, dt_s)
            self.body.watch(dt_s)
            self.arm.step(dt_s)
            self._watch_hold(dt_s)
            stage = yield from self._act(now_ns, dt_s)
            yield from self.arm.commands(now_ns)
        self._was_silent = bool(silent)
        yield from (msgspec.structs.replace(event, stamp_ns=now_ns) for event in self._events)
        self._events.clear()
        if self._ticks % STATE_EVERY == 0:
            yield self._state(now_ns, stage, text)

    def _act(self, now_ns: int, dt_s: float) -> Generator[Message, None, str]:
        """Do what is due and return the stage that this is."""
        growth = self.body.growth
        if growth is not None:
            yield from self.body.tick(now_ns, dt_s)
            if self.body.growth is None:
                self._under_way = False
            return growth.record.stage
        if self._memory.task or not self._under_way:
            self._follow()
        if self._memory.task == "park":
            return "park"
        path = self.arm.path
        moving = self._memory.task or (path is not None and path.arrived_s < 0)
        return "move" if moving else "hold"

    def _follow(self) -> None:
        """Go to the task's present target; when the arm has rested there, to the next."""
        memory = self._memory
        if not self._under_way:
            if memory.goal_rad:
                self.arm.go(np.array(memory.goal_rad))
            self._under_way = True
        rest = self.arm.resting_s() - self.settings.control.settle_s
        if memory.task and rest >= MEASURE_S and self._hands_done():
            targets = self._tasks[memory.task]
            memory.step += 1
            if memory.step < len(targets):
                memory.goal_rad = tuple(targets[memory.step].tolist())
                self.arm.go(np.array(memory.goal_rad))
            else:
                self._event("info", "task_done", f"task '{memory.task}' is done", task=memory.task)
                memory.task, memory.step = "", 0
            self._notebook.save()

    def _hands_done(self) -> bool:
        """Grasp or release what the task does at this target; whether that has been done."""
        memory, task = self._memory, self._carrying.get(self._memory.task)
        if task is None or self.hands.busy:
            return task is None
        if self.hands.missed:
            self.hands.missed = False
            text = f"the hand closed on nothing where '{task.payload}' should be"
            self._event("warning", "grasp_failed", text, payload=task.payload)
            self._cancel("grasp_failed")
            return False
        if memory.step + 1 == task.grasp_at and self.hands.holding != task.payload:
            self.hands.grasp(task.payload)
            self._event("info", "grasp", f"taking '{task.payload}'", payload=task.payload)
        elif memory.step + 1 == task.release_at and self.hands.holding:
            self.hands.release()
            self._event("info", "release", f"putting down '{task.payload}'", payload=task.payload)
        else:
            return True
        memory.holding = task.payload if memory.step + 1 == task.grasp_at else ""
        self._notebook.save()
        return False

    def _watch_hold(self, dt_s: float) -> None:
        """Tell when the muscles that are there cannot hold the arm."""
        assert self.arm.plan is not None
        before_s, missing_nm = self._unheld_s, self.arm.plan.missing_nm
        self._unheld_s = before_s + dt_s if missing_nm.any() else 0.0
        if before_s < UNHELD_S <= self._unheld_s:
            self._event("error", "not_held", f"the arm sinks: {self._unheld(missing_nm)}")

    def _unheld(self, missing_nm: Array) -> str:
        """Words for torque (N,) that is missing, or "" if none is."""
        if not missing_nm.any():
            return ""
        joint = int(np.argmax(missing_nm))
        most_n = self.settings.control.tension_ceiling_n
        return (
            f"no tensions up to {most_n:g} N hold that posture, "
            f"{missing_nm[joint]:.2g} Nm are missing at joint '{self.settings.joints[joint]}'"
        )

    # ── requests ──────────────────────────────────────────────────────────────────────────────

    def _start_task(self, name: str) -> Reply:
        if name not in self._tasks:
            hint = suggestion(name, {*self._tasks, "hold", "cancel"})
            return Reply(ok=False, text=f"no task '{name}' in the robot file{hint}")
        if self.body.growth is not None and name != "park":
            return GROWING
        if name == "park":
            self._cancel("park")
        else:
            for target in self._tasks[name]:
                if unheld := self._unheld(self.arm.missing_nm(target)):
                    degrees = ", ".join(f"{x:.0f}" for x in np.degrees(target))
                    return Reply(ok=False, text=f"{unheld} (the target at {degrees} deg)")
        self._memory.task, self._memory.step = name, 0
        self._memory.goal_rad = tuple(self._tasks[name][0].tolist())
        self._under_way = False
        self._notebook.save()
        return Reply(ok=True, text=f"task '{name}' started: {len(self._tasks[name])} targets")

    def _start_reach(self, request: m.Reach) -> Reply:
        if self.body.growth is not None:
            return GROWING
        if not self._memory.goal_rad and self._was_silent and self.arm.path is None:
            return Reply(ok=False, text="the arm cannot move now: it is not heard yet")
        goal = list(self._memory.goal_rad or self.arm.reference_rad.tolist())
        for name, angle in request.angle_rad.items():
            if name not in self.settings.joints:
                hint = suggestion(name, self.settings.joints)
                return Reply(ok=False, text=f"no joint '{name}'{hint}")
            index = self.settings.joints.index(name)
            low, high = self.arm.skeleton.range_rad[index]
            if not low <= angle <= high:
                limits = f"{np.degrees(low):.0f} .. {np.degrees(high):.0f} deg"
                return Reply(ok=False, text=f"joint '{name}' reaches {limits}")
            goal[index] = float(angle)
        if unheld := self._unheld(self.arm.missing_nm(np.array(goal))):
            return Reply(ok=False, text=unheld)
        self._memory.task, self._memory.step = "", 0
        self._memory.goal_rad = tuple(goal)
        self._under_way = False
        self._notebook.save()
        return Reply(ok=True, text="on the way")

    def _start_relearn(self, request: m.Relearn, now_ns: int) -> Reply:
        if self.body.growth is not None:
            return GROWING
        if request.method not in m.METHODS or not 1 <= request.n_new <= 100:
            return Reply(ok=False, text=RELEARN)
        silent = self.arm.silent(now_ns)
        if silent == NO_SCHEMA:
            self.body.draw()
        elif silent:
            return Reply(ok=False, text=f"the arm cannot move now: {silent}")
        n_new = self.body.relearn(request.method, request.n_new)
        return Reply(ok=True, text=f"relearning from {n_new} motions")

    def _cancel(self, name: str) -> Reply:
        memory = self._memory
        if name != "park" or not self.body.pause():
            self.body.cancel(f"cancelled by '{name}'")
        memory.task, memory.step = "", 0
        if self.arm.path is not None:
            memory.goal_rad = tuple(self.arm.reference_rad.tolist())
        self._under_way = False
        self._notebook.save()
        return Reply(ok=True, text="holding")

    def _abandon(self) -> None:
        """A stop ends all that was under way: nothing moves by itself when it is cleared."""
        memory = self._memory
        self.body.cancel("the robot was stopped")
        if memory.task or memory.goal_rad:
            memory.task, memory.step, memory.goal_rad = "", 0, ()
            self._notebook.save()
        self._under_way = False
        self.arm.drop()

    # ── inside ────────────────────────────────────────────────────────────────────────────────

    def resume(self) -> None:
        """Go on with what a former executive was about; called once by the process."""
        self.body.resume()

    def _event(self, level: str, kind: str, text: str, **data: str) -> None:
        self._events.append(
            m.Event(process=AUTHOR, level=level, kind=kind, text=text, data=dict(data))
        )

    def _state(self, now_ns: int, stage: str, text: str) -> m.ExecutiveState:
        memory, growth, plan = self._memory, self.body.growth, self.arm.plan
        rest = self.arm.resting_s() - self.settings.control.settle_s
        steps = len(self._tasks[memory.task]) if memory.task else 0
        moving = stage not in ("waiting", "stopped")
        return m.ExecutiveState(
            stamp_ns=now_ns,
            stage=stage,
            task=memory.task,
            step=len(growth.record.motions) if growth else memory.step + 1 if memory.task else 0,
            steps=growth.steps if growth else steps,
            settled=moving and rest >= 0.0,
            joints=self.settings.joints,
            reference_rad=tuple(self.arm.reference_rad.tolist()) if moving else (),
            muscles=self.arm.schema.muscles if self.arm.schema and plan else (),
            planned_tension_n=tuple(plan.tension_n.tolist()) if plan else (),
            growing=growth.record.muscle if growth else "",
            schema_version=self.body.schema_version,
            text=text,
        )
