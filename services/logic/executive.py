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
from services.body_schema.schema import Schema, SchemaError
from services.logic.arm import AUTHOR, Arm
from services.logic.growth import Growth, GrowthRecord, Target, spread_targets
from services.logic.skeleton import Skeleton

MEASURE_S = 0.2  # the arm is called settled for this long at each target
LOST_S = 0.5  # a muscle gone for longer than this is gone
TORN_S = 1.5  # and one that carries nothing for longer than this, though it should, is torn
TORN_N = 2.0
MAX_RESTARTS = 2  # of one growth, before the arm just holds
STATE_EVERY = 2  # ticks
MAX_STEP_S = 0.02  # of movement in one tick, however long it was


class Memory(msgspec.Struct):
    """What outlives the process."""

    task: str = ""
    step: int = 0
    goal_rad: tuple[float, ...] = ()  # posture that is held or aimed at
    growth: GrowthRecord | None = None
    known: dict[str, int] = {}  # muscle -> serial number of modules that a schema has learned
    refused: list[str] = []  # muscles whose growth failed; tried again when plugged anew


class Executive:
    """Messages in, `ChainCommand` and `ExecutiveState` out, 100 times a robot second."""

    inputs: tuple[type[Message], ...] = (
        m.ChainBody,
        m.ChainState,
        m.JointState,
        m.SchemaVersion,
        m.SchemaCandidate,
        m.TrainingProgress,
    )
    requests: tuple[type[Message], ...] = (m.Task, m.Reach, m.Relearn)
    period_ns = 10_000_000

    def __init__(
        self, settings: RobotSettings, skeleton: Skeleton, store: Store, seed: int = 0
    ) -> None:
        self.settings = settings
        self.arm = Arm(settings, skeleton)
        self._store = store
        self._seed = seed
        self._tasks = {
            task.name: np.radians(np.array(task.targets_deg)) for task in settings.task
        } | {"park": np.radians(np.array([[joint.rest_deg for joint in settings.joint]]))}
        self._memory = self._recall()
        self._growth: Growth | None = None
        self._events: list[m.Event] = []
        self._schema_version = 0
        self._next_ns = 0
        self._last_ns = 0
        self._ticks = 0
        self._was_silent = True
        self._under_way = False  # towards the present step's target
        self._lost_s: dict[str, float] = {}
        self._torn_s: dict[str, float] = {}

    # ── in ────────────────────────────────────────────────────────────────────────────────────

    def receive(self, message: Message, now_ns: int) -> None:
        """Take in what drivers and retrainer say."""
        if isinstance(message, m.SchemaCandidate):
            if self._growth:
                self._growth.receive(message)
        elif isinstance(message, m.SchemaVersion):
            self._take_schema(message)
        elif isinstance(message, m.TrainingProgress):
            if self._growth:
                self._growth.receive(message)
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
            return self._start_relearn(request)
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
        stage, text = "waiting", silent
        if not silent and self.arm.stopped:
            stage, text = "stopped", "stopped; clear with 'myograft reset'"
            self._abandon()
        elif not silent:
            if self._was_silent:
                self.arm.anchor()
                self._under_way = False
            self._watch_body(dt_s)
            self.arm.step(dt_s)
            stage = yield from self._act(now_ns, dt_s)
            yield from self.arm.commands(now_ns)
        self._was_silent = bool(silent)
        yield from (msgspec.structs.replace(event, stamp_ns=now_ns) for event in self._events)
        self._events.clear()
        if self._ticks % STATE_EVERY == 0:
            yield self._state(now_ns, stage, text)

    def _act(self, now_ns: int, dt_s: float) -> Generator[Message, None, str]:
        """Do what is due and return the stage that this is."""
        if self._growth is not None:
            growth = self._growth
            yield from growth.tick(now_ns, dt_s)
            if growth.dirty:
                growth.dirty = False
                self._save()
            if growth.over:
                self._end_growth(growth)
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
        if memory.task and rest >= MEASURE_S:
            targets = self._tasks[memory.task]
            memory.step += 1
            if memory.step < len(targets):
                memory.goal_rad = tuple(targets[memory.step].tolist())
                self.arm.go(np.array(memory.goal_rad))
            else:
                self._event("info", "task_done", f"task '{memory.task}' is done", task=memory.task)
                memory.task, memory.step = "", 0
            self._save()

    # ── the body changes ──────────────────────────────────────────────────────────────────────

    def _watch_body(self, dt_s: float) -> None:
        """Start growing when a muscle has come, shrinking when one has gone for good."""
        assert self.arm.schema is not None
        known = self.arm.schema.muscles
        for name in list(self._memory.refused):
            if self._is_gone(name):
                self._memory.refused.remove(name)
        gone = self._missing(dt_s)
        if self._growth is not None:
            self._give_up_on(gone)
            return
        gone = [name for name in gone if name not in self.arm.excluded]
        if gone and len(known) > 1:
            self._begin("shrink", gone[0], tuple(n for n in known if n != gone[0]))
            return
        for module in self.arm.modules():
            new = module.kind == "muscle" and module.name and module.name not in known
            if not new or module.state not in ("joining", "up"):
                continue
            if module.name not in self._memory.refused:
                returning = self._memory.known.get(module.name) == module.serial
                kind = "refit" if returning else "grow"
                self._begin(kind, module.name, (*known, module.name))
                return

    def _is_gone(self, muscle: str) -> bool:
        module = self.arm.module(muscle)
        return module is None or module.state == "lost"

    def _missing(self, dt_s: float) -> list[str]:
        """Muscles of the schema that have been without service for too long.

        Gone from the chain, at fault, or wound in anew by the driver: then the wire was attached
        anew and its length zero is another. Or torn: slack, though the plan asks for tension.
        """
        assert self.arm.schema is not None
        felt = self.arm.felt()
        missing = []
        for name in self.arm.schema.muscles:
            module = self.arm.module(name)
            if module is not None and module.state == "up":
                self._memory.known.setdefault(name, module.serial)
            absent = module is None or module.state != "up"
            torn = self._growth is None and name in felt and felt[name][1] < TORN_N
            for times, counts in ((self._lost_s, absent), (self._torn_s, torn)):
                times[name] = times.get(name, 0.0) + dt_s if counts else 0.0
            if self._lost_s[name] > LOST_S or self._torn_s[name] > TORN_S:
                missing.append(name)
        return missing

    def _begin(
        self, kind: str, muscle: str, muscles: tuple[str, ...], method: str = "", n_new: int = 0
    ) -> None:
        growth = self.settings.growth
        assert self.arm.schema is not None
        known = self.arm.schema.muscles
        count = {"grow": n_new or growth.n_new, "refit": 2, "shrink": 0}[kind]
        rng = np.random.default_rng([self._seed, len(muscles), self._schema_version])

        def targets(number: int) -> tuple[Target, ...]:
            return spread_targets(
                number,
                self.arm.skeleton.range_rad,
                len(known),
                (growth.bias_min_n, growth.bias_max_n),
                rng,
            )

        record = GrowthRecord(
            kind=kind,
            muscle=muscle,
            muscles=muscles,
            base_version=self._schema_version,
            method=method or growth.method,
            seed=self._seed,
            n_new=count,
            n_check=growth.n_check,
            return_rad=self._memory.goal_rad or tuple(self.arm.reference_rad.tolist()),
            targets=targets(count) + targets(growth.n_check),
        )
        if kind == "shrink":
            self.arm.excluded.add(muscle)
            if not self._is_gone(muscle):  # it is broken: not taken back until it is plugged anew
                self._memory.refused.append(muscle)
        self._memory.growth = record
        self._growth = Growth(record, self.arm, growth.residual_limit_mm)
        words = {"grow": "takes in", "refit": "takes back", "shrink": "goes on without"}[kind]
        self._event("info", f"{kind}_started", f"the body {words} '{muscle}'", muscle=muscle)

    def _give_up_on(self, gone: list[str]) -> None:
        """A muscle that leaves while the body grows ends the growth, unless it is why."""
        assert self._growth is not None
        record = self._growth.record
        module = self.arm.module(record.muscle)
        guest_gone = record.kind != "shrink" and (module is None or module.state == "lost")
        if guest_gone or [name for name in gone if name != record.muscle]:
            self._growth.over = "a muscle left meanwhile"

    def _end_growth(self, growth: Growth) -> None:
        record, memory = growth.record, self._memory
        self._growth, memory.growth = None, None
        self._under_way = False
        if growth.over == "done":
            module = self.arm.module(record.muscle)
            if module is not None and record.kind != "shrink":
                memory.known[record.muscle] = module.serial
            kind, words = f"{record.kind}_done", "the body schema has"
            words += " lost" if record.kind == "shrink" else " taken in"
            self._event("info", kind, f"{words} '{record.muscle}'", muscle=record.muscle)
        elif record.kind == "refit":
            memory.known.pop(record.muscle, None)  # so that it is learned from the start
            self._event("warning", "refit_refused", f"'{record.muscle}': {growth.over}")
        else:
            if record.muscle not in memory.refused:
                memory.refused.append(record.muscle)
            text = f"'{record.muscle}' is not taken in and the arm holds: {growth.over}"
            if record.kind == "shrink":
                text = f"the schema keeps '{record.muscle}' and the arm holds: {growth.over}"
            self._event("error", f"{record.kind}_failed", text, muscle=record.muscle)
        self._save()

    def _take_schema(self, message: m.SchemaVersion) -> None:
        if message.version == self._schema_version and self.arm.schema is not None:
            if self._growth:
                self._growth.receive(message)
            return
        try:
            schema = Schema.from_bytes(message.data)
        except SchemaError as error:
            self._event("error", "schema_bad", f"schema version {message.version}: {error}")
            return
        self._schema_version = message.version
        self.arm.use(schema)
        self._event(
            "info",
            "adopted",
            f"schema version {message.version} ({message.method}) controls the arm now",
            version=str(message.version),
        )
        if self._growth:
            self._growth.receive(message)

    # ── requests ──────────────────────────────────────────────────────────────────────────────

    def _start_task(self, name: str) -> Reply:
        if name not in self._tasks:
            known = ", ".join([*self._tasks, "hold", "cancel"])
            return Reply(ok=False, text=f"no task '{name}' in the robot file; there are: {known}")
        if self._growth is not None and name != "park":
            return Reply(ok=False, text="the body is growing; wait, or 'myograft task cancel'")
        if name == "park":
            self._cancel("park")
        self._memory.task, self._memory.step = name, 0
        self._memory.goal_rad = tuple(self._tasks[name][0].tolist())
        self._under_way = False
        self._save()
        return Reply(ok=True, text=f"task '{name}' started: {len(self._tasks[name])} targets")

    def _start_reach(self, request: m.Reach) -> Reply:
        if self._growth is not None:
            return Reply(ok=False, text="the body is growing; wait, or 'myograft task cancel'")
        if not self._memory.goal_rad and self._was_silent:
            return Reply(ok=False, text="the arm cannot move now: it is not heard yet")
        goal = list(self._memory.goal_rad or self.arm.reference_rad.tolist())
        for name, angle in request.angle_rad.items():
            if name not in self.settings.joints:
                known = ", ".join(self.settings.joints)
                return Reply(ok=False, text=f"no joint '{name}'; there are: {known}")
            index = self.settings.joints.index(name)
            low, high = self.arm.skeleton.range_rad[index]
            if not low <= angle <= high:
                limits = f"{np.degrees(low):.0f} .. {np.degrees(high):.0f} deg"
                return Reply(ok=False, text=f"joint '{name}' reaches {limits}")
            goal[index] = float(angle)
        self._memory.task, self._memory.step = "", 0
        self._memory.goal_rad = tuple(goal)
        self._under_way = False
        self._save()
        return Reply(ok=True, text="on the way")

    def _start_relearn(self, request: m.Relearn) -> Reply:
        if self._growth is not None:
            return Reply(ok=False, text="the body is growing already")
        if self.arm.schema is None or self._was_silent:
            return Reply(ok=False, text="the arm cannot move now")
        if request.method not in ("i", "ii", "iii") or not 1 <= request.n_new <= 100:
            return Reply(ok=False, text="method is i, ii or iii, and n_new from 1 to 100")
        muscles = self.arm.schema.muscles
        self._begin("grow", muscles[-1], muscles, request.method, request.n_new)
        return Reply(ok=True, text=f"relearning from {request.n_new} motions")

    def _cancel(self, name: str) -> Reply:
        memory = self._memory
        if self._growth is not None:
            self._growth.over = f"cancelled by '{name}'"
            self._end_growth(self._growth)
        memory.task, memory.step = "", 0
        if self.arm.path is not None:
            memory.goal_rad = tuple(self.arm.reference_rad.tolist())
        self._under_way = False
        self._save()
        return Reply(ok=True, text="holding")

    def _abandon(self) -> None:
        """A stop ends all that was under way: nothing moves by itself when it is cleared."""
        memory = self._memory
        if self._growth is not None:
            self._growth.over = "the robot was stopped"
            self._end_growth(self._growth)
        if memory.task or memory.goal_rad:
            memory.task, memory.step, memory.goal_rad = "", 0, ()
            self._save()
        self._under_way = False
        self.arm.drop()

    # ── memory ────────────────────────────────────────────────────────────────────────────────

    def _recall(self) -> Memory:
        data = self._store.load("memory")
        if data is None:
            return Memory()
        try:
            memory = msgspec.msgpack.decode(data, type=Memory)
        except msgspec.DecodeError:
            return Memory()  # a torn file is no reason not to hold the arm
        task_fits = not memory.task or memory.step < len(self._tasks.get(memory.task, ()))
        if task_fits and len(memory.goal_rad) in (0, len(self.settings.joints)):
            return memory
        return Memory(known=memory.known)  # the robot file was changed

    def resume(self) -> None:
        """Go on with what a former executive was about; called once by the process."""
        record = self._memory.growth
        if record is None:
            return
        record.restarts += 1
        if record.restarts > MAX_RESTARTS:
            self._memory.growth = None
            self._memory.refused.append(record.muscle)
            self._event("error", "growth_given_up", "growth failed twice: the arm holds")
        else:
            self._growth = Growth(record, self.arm, self.settings.growth.residual_limit_mm)
            if record.kind == "shrink":
                self.arm.excluded.add(record.muscle)
            text = f"growth of '{record.muscle}' goes on at stage {record.stage}"
            self._event("warning", "growth_resumed", text, stage=record.stage)
        self._save()

    def _save(self) -> None:
        self._store.save("memory", msgspec.msgpack.encode(self._memory))

    def _event(self, level: str, kind: str, text: str, **data: str) -> None:
        self._events.append(
            m.Event(process=AUTHOR, level=level, kind=kind, text=text, data=dict(data))
        )

    def _state(self, now_ns: int, stage: str, text: str) -> m.ExecutiveState:
        memory, growth, plan = self._memory, self._growth, self.arm.plan
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
            schema_version=self._schema_version,
            text=text,
        )
