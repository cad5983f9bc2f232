"""Which muscles are part of the body: takes in those that come, goes on without those that went.

Watches the chains' modules against the schema's muscles and runs one `Growth` at a time. Every way
that can fail ends in holding.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

import msgspec
import numpy as np

from runtime import messages as m
from runtime.messages import Message
from services.body_schema.schema import Schema, SchemaError
from services.logic.arm import Arm
from services.logic.drawing import drawn_wires
from services.logic.growth import Growth, GrowthRecord
from services.logic.guests import TORN_N, TORN_S
from services.logic.memory import Notebook
from services.logic.relearning import BY_WIRES
from services.logic.targets import Target, spread_targets
from services.logic.versions import NONE

LOST_S = 0.5  # a muscle gone for longer than this is gone
MAX_RESTARTS = 2  # of one growth, before the arm just holds
MOTIONS_OF_REFIT = 2


class Tell(Protocol):
    """Makes an event of what happened."""

    def __call__(self, level: str, kind: str, text: str, **data: str) -> None:
        """Level, stable kind, sentence, data."""


class Body:
    """The muscles of the schema in use, and the growth under way.

    Attributes:
        growth: the procedure that runs, if one does.
        schema_version: number of the schema that controls the arm.
        watchful: whether muscles that come and go change the body.
    """

    def __init__(self, arm: Arm, notebook: Notebook, seed: int, tell: Tell) -> None:
        self.growth: Growth | None = None
        self.schema_version = 0
        self.watchful = True
        self._arm = arm
        self._notebook = notebook
        self._seed = seed
        self._tell = tell
        for muscle, path in notebook.memory.paths.items():
            arm.guests.told(muscle, path)
        self._lost_s: dict[str, float] = {}
        self._torn_s: dict[str, float] = {}

    def receive(self, message: Message) -> None:
        """Schemas, candidates, and how far training is."""
        if isinstance(message, m.SchemaVersion) and not isinstance(message, m.SchemaCandidate):
            self._take_schema(message)
        if self.growth is not None:
            self.growth.receive(message)

    def plugged(self, data: Mapping[str, str]) -> None:
        """Somebody fixed a module and says how its wire nominally runs."""
        try:
            path = msgspec.json.decode(data["path"], type=m.MusclePath)
        except (KeyError, msgspec.DecodeError):
            return  # a real robot's hands say it in the robot file
        self._notebook.memory.paths[data.get("muscle", "")] = path
        self._arm.guests.told(data.get("muscle", ""), path)
        self._notebook.save()

    def tick(self, now_ns: int, dt_s: float) -> Iterator[Message]:
        """Let the growth that is under way go on."""
        growth = self.growth
        assert growth is not None
        yield from growth.tick(now_ns, dt_s)
        if growth.dirty:
            growth.dirty = False
            self._notebook.save()
        if growth.over:
            self._end(growth)

    def watch(self, dt_s: float) -> None:
        """Start growing when a muscle has come, shrinking when one has gone for good."""
        if not self.watchful or (self._arm.drawn and self.growth is None):
            return
        assert self._arm.schema is not None
        known, memory = self._arm.schema.muscles, self._notebook.memory
        memory.refused = [name for name in memory.refused if not self._is_gone(name)]
        gone = self._missing(dt_s)
        if self.growth is not None:
            self._give_up_on(self.growth, gone)
            return
        self._welcome_back()
        lost = next((name for name in gone if name not in self._arm.excluded), "")
        if lost and len(known) > 1:
            self._begin("shrink", lost, tuple(n for n in known if n != lost), why=gone[lost])
            return
        for module in self._arm.modules():
            new = module.kind == "muscle" and module.name and module.name not in known
            if new and module.state in ("joining", "up") and module.name not in memory.refused:
                returning = memory.known.get(module.name) == module.serial
                kind = "refit" if returning else "grow"
                self._begin(kind, module.name, (*known, module.name))
                return

    def relearn(self, method: str, n_new: int) -> int:
        """Collect motions anew and learn the same body again; or go on where that was paused.

        Returns how many motions it learns from.
        """
        record = self._notebook.memory.growth
        if record is not None:
            record.paused = False
            self.growth = self._procedure(record)
            self._tell("info", "grow_started", "the body goes on learning its first schema")
            self._notebook.save()
            return record.n_new
        assert self._arm.schema is not None
        muscles = self._arm.schema.muscles
        method = BY_WIRES if self._arm.drawn else method
        self._begin("grow", muscles[-1], muscles, method, n_new)
        return n_new

    @property
    def learns_first(self) -> bool:
        """Whether the growth that is under way is to bring the first schema."""
        return self.growth is not None and self.growth.record.base_version == NONE

    def draw(self) -> None:
        """Begin by the wires that the body's file draws; for an arm that lacks nothing else."""
        arm = self._arm
        arm.use(drawn_wires(arm.settings, arm.angle_rad, arm.felt()))
        arm.drawn = True

    def pause(self) -> bool:
        """Leave the first schema for later, if that is what is learned now."""
        if not self.learns_first:
            return False
        assert self.growth is not None
        self.growth.record.paused = True
        self.growth = None
        self._arm.corrected = False
        text = "the first schema is left for later; 'myograft learn' goes on"
        self._tell("info", "learning_paused", text)
        self._notebook.save()
        return True

    def cancel(self, reason: str) -> None:
        """End the growth that is under way, if one is."""
        if self.growth is not None:
            self.growth.over = reason
            self._end(self.growth, cancelled=True)

    def resume(self) -> None:
        """Go on with the growth that a former executive was about."""
        memory = self._notebook.memory
        record = memory.growth
        if record is None or record.paused:
            return
        record.restarts += 1
        if record.restarts > MAX_RESTARTS:
            memory.growth = None
            memory.refused.append(record.muscle)
            again = self._again(record, gone=False)  # nobody has been heard yet
            text = f"growth failed twice: the arm holds; {again}"
            self._tell("error", "growth_given_up", text)
        else:
            self.growth = self._procedure(record)
            if record.kind == "shrink":
                self._arm.excluded.add(record.muscle)
            text = f"growth of '{record.muscle}' goes on at stage {record.stage}"
            self._tell("warning", "growth_resumed", text, stage=record.stage)
        self._notebook.save()

    # ── coming and going ──────────────────────────────────────────────────────────────────────

    def _welcome_back(self) -> None:
        """Rely again on muscles that were lost, could not be shrunk away, and are there again."""
        refused = self._notebook.memory.refused  # the broken ones
        back = {x for x in self._arm.excluded if x not in refused and not self._is_gone(x)}
        if back:
            self._arm.excluded -= back
            self._arm.anchor()

    def _is_gone(self, muscle: str) -> bool:
        module = self._arm.module(muscle)
        return module is None or module.state == "lost"

    def _missing(self, dt_s: float) -> dict[str, str]:
        """Muscles of the schema that have been without service for too long, and why.

        Gone from the chain, at fault, or wound in anew by the driver: then the wire was attached
        anew and its length zero is another. Or torn: slack, though the plan asks for tension.
        """
        assert self._arm.schema is not None
        felt = self._arm.felt()
        missing = {}
        for name in self._arm.schema.muscles:
            module = self._arm.module(name)
            if module is not None and module.state == "up":
                self._notebook.memory.known.setdefault(name, module.serial)
            absent = module is None or module.state != "up"
            torn = self.growth is None and name in felt and felt[name][1] < TORN_N
            lost_s = self._lost_s[name] = self._lost_s.get(name, 0.0) + dt_s if absent else 0.0
            torn_s = self._torn_s[name] = self._torn_s.get(name, 0.0) + dt_s if torn else 0.0
            if lost_s > LOST_S:
                missing[name] = self._why_absent(module)
            elif torn_s > TORN_S:
                missing[name] = "its wire carries nothing, as a torn one"
        return missing

    def _why_absent(self, module: m.ModuleInfo | None) -> str:
        if module is None or module.state == "lost":
            return "its module does not answer"
        if module.state == "joining":
            return "its wire is wound in anew"
        return f"its module reports {module.fault or module.state}"

    def _give_up_on(self, growth: Growth, gone: Mapping[str, str]) -> None:
        """A muscle that leaves while the body grows ends the growth, unless it is why."""
        record = growth.record
        guest_gone = record.kind != "shrink" and self._is_gone(record.muscle)
        if guest_gone or [name for name in gone if name != record.muscle]:
            growth.over = "a muscle left meanwhile"

    # ── growth ────────────────────────────────────────────────────────────────────────────────

    def _begin(
        self,
        kind: str,
        muscle: str,
        muscles: tuple[str, ...],
        method: str = "",
        n_new: int = 0,
        why: str = "",
    ) -> None:
        growth, memory = self._arm.settings.growth, self._notebook.memory
        count = {"grow": n_new or growth.n_new, "refit": MOTIONS_OF_REFIT, "shrink": 0}[kind]
        record = GrowthRecord(
            kind=kind,
            muscle=muscle,
            muscles=muscles,
            base_version=self.schema_version,
            method=method or growth.method,
            seed=self._seed,
            n_new=count,
            n_check=growth.n_check,
            return_rad=memory.goal_rad or tuple(self._arm.reference_rad.tolist()),
            targets=self._targets(count, growth.n_check),
        )
        if kind == "shrink":
            self._arm.excluded.add(muscle)
            module = self._arm.module(muscle)
            if module is not None and module.state not in ("lost", "joining"):
                memory.refused.append(muscle)  # it is broken: not taken back until plugged anew
        memory.growth = record
        self.growth = self._procedure(record)
        words = {"grow": "takes in", "refit": "takes back", "shrink": "goes on without"}[kind]
        text = f"the body {words} '{muscle}'"
        if self.learns_first:
            text = "the body learns its first schema, by its wires as they are drawn"
        if why:
            text += f": {why}"
        self._tell("warning" if why else "info", f"{kind}_started", text, muscle=muscle)

    def _procedure(self, record: GrowthRecord) -> Growth:
        return Growth(record, self._arm, self._arm.settings.growth.residual_limit_mm)

    def _targets(self, learned: int, checked: int) -> tuple[Target, ...]:
        """Two designs, each spread by itself: motions to learn from, motions to check on."""
        assert self._arm.schema is not None
        growth, known = self._arm.settings.growth, self._arm.schema.muscles
        rng = np.random.default_rng([self._seed, len(known), self.schema_version])
        bias_n = (growth.bias_min_n, growth.bias_max_n)
        range_rad = self._arm.skeleton.range_rad
        here = self._arm.reference_rad
        first = spread_targets(learned, range_rad, len(known), bias_n, rng, here)
        last = np.array(first[-1].angle_rad) if first else here
        return first + spread_targets(checked, range_rad, len(known), bias_n, rng, last)

    def _end(self, growth: Growth, *, cancelled: bool = False) -> None:
        record, memory = growth.record, self._notebook.memory
        self.growth, memory.growth = None, None
        self._arm.corrected = False
        name = record.muscle
        if growth.over == "done":
            module = self._arm.module(name)
            if module is not None and record.kind != "shrink":
                memory.known[name] = module.serial
            words = "lost" if record.kind == "shrink" else "taken in"
            text = f"the body schema has {words} '{name}'"
            if record.base_version == NONE:
                text = "the first body schema is learned"
            self._tell("info", f"{record.kind}_done", text, muscle=name)
        elif record.kind == "refit" and not cancelled and not self._is_gone(name):
            memory.known.pop(name, None)  # so that it is learned from the start
            self._tell("warning", "refit_refused", f"'{name}': {growth.over}", muscle=name)
        else:
            if name not in memory.refused:
                memory.refused.append(name)
            text = f"'{name}' is not taken in and the arm holds: {growth.over}"
            if record.kind == "shrink":
                text = f"the schema keeps '{name}' and the arm holds: {growth.over}"
            elif record.base_version == NONE:
                text = f"no schema was learned and the arm holds: {growth.over}"
            elif self._relearns(record):
                text = f"the schema stays as it is and the arm holds: {growth.over}"
            text += f"; {self._again(record, gone=self._is_gone(name))}"
            self._tell("error", f"{record.kind}_failed", text, muscle=name)
        self._notebook.save()

    def _relearns(self, record: GrowthRecord) -> bool:
        schema = self._arm.schema
        return record.kind == "grow" and schema is not None and record.muscle in schema.muscles

    def _again(self, record: GrowthRecord, *, gone: bool) -> str:
        """How a person goes on when a growth was given up."""
        name = record.muscle
        if record.base_version == NONE:
            return "the same 'myograft learn' tries again"
        if self._relearns(record):
            return "to try again: myograft schema relearn"
        if gone:
            return f"it counts again once it is back: myograft plug {name}"
        return f"to try again: myograft unplug {name} && myograft plug {name}"

    def _take_schema(self, message: m.SchemaVersion) -> None:
        if message.version == self.schema_version and self._arm.schema is not None:
            return
        try:
            schema = Schema.from_bytes(message.data)
        except SchemaError as error:
            self._tell("error", "schema_bad", f"schema version {message.version}: {error}")
            return
        growth, former = self.growth, self._arm.schema
        chosen = growth is None or not growth.expects(message)
        self.schema_version = message.version
        self._arm.use(self._arm.served(schema))
        text = f"schema version {message.version} ({message.method}) controls the arm now"
        self._tell("info", "adopted", text, version=str(message.version))
        if chosen and growth is not None:
            growth.over = f"version {message.version} was chosen meanwhile"
            self._end(growth, cancelled=True)
        if chosen and former is not None:
            self._leave_out([name for name in former.muscles if name not in schema.muscles])

    def _leave_out(self, muscles: list[str]) -> None:
        """A person went back to a schema without these: they wait until they are plugged anew."""
        refused = self._notebook.memory.refused
        for name in muscles:
            if name not in refused and not self._is_gone(name):
                refused.append(name)
                text = f"'{name}' stays outside of the chosen schema; to take it in again: "
                text += f"myograft unplug {name} && myograft plug {name}"
                self._tell("info", "left_out", text, muscle=name)
                self._notebook.save()
