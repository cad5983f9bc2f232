"""Leads a recording through a process's logic again and compares what it says with what it said.

The logic gets what the process took in, in that order, and acts when it acted (`Steps`), on the
recorded robot time. What it then says must be, to the last bit, what was recorded: a difference is
a change of the code, or of the robot file.

Where the recording lacks what the process took in or when it acted, there is a gap, and what the
logic says there says nothing about the code. A gap ends once nothing has been lacking for a tenth
of a second and the logic speaks again at the robot time at which the process spoke, or when the
process was started anew. What was recorded meanwhile is left out.

A process can be retraced if its logic is built from the robot's settings alone, hears topics only
and answers no requests; the table `myograft.logics` of pyproject.toml names these.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from typing import Any, NamedTuple, Protocol

import msgspec

from runtime.journal import Entry
from runtime.logic import Logic
from runtime.messages import Message, Steps
from runtime.settings import RobotSettings

ENTRY_POINTS = "myograft.logics"
LATE_NS = 100_000_000  # an output's stamp may be so much older than the step that gave it
ONE_GAP_NS = 1_000_000_000  # what is lacking within this is one gap
LATE_STEPS = 40  # behind which a message may be written that they took in: ten seconds
KEPT = 4096  # messages of one key that may still be taken in: seconds more than a mailbox holds

log = logging.getLogger(__name__)

Output = tuple[str, int]  # type and stamp


class Retraceable(Logic, Protocol):
    """A logic that says what it publishes."""

    outputs: tuple[type[Message], ...]


class Difference(NamedTuple):
    """How far a field is from what was recorded, at worst."""

    greatest: float  # in the field's unit; inf: of another kind, length or text
    stamp_ns: int
    messages: int  # in which it differs at all


@dataclass
class Gap:
    """Robot time from the first to the last thing in it that the recording lacks."""

    begin_ns: int
    end_ns: int
    until_ns: float = math.inf  # from here on outputs are compared again


@dataclass
class Report:
    """What came of it."""

    process: str
    begin_ns: int = 0
    end_ns: int = 0
    steps: int = 0
    compared: int = 0
    equal: int = 0
    differences: dict[str, Difference] = field(default_factory=dict)  # `JointEstimate.angle_rad`
    silent: int = 0  # recorded, but not said again, outside of gaps
    invented: int = 0  # said, but not recorded, outside of gaps
    gaps: list[Gap] = field(default_factory=list)
    unheard: int = 0  # taken in by the process, but not recorded
    lost_steps: int = 0  # steps that were not recorded
    left_out: int = 0  # recorded outputs in gaps
    untold: int = 0  # recorded outputs after the last steps of which the process told
    started_ns: list[int] = field(default_factory=list)  # when the process was started anew

    @property
    def exact(self) -> bool:
        """Outside of gaps everything recorded was said again, bit for bit, and nothing else."""
        return self.compared > 0 and self.equal == self.compared and not self.odd

    @property
    def enough(self) -> bool:
        """More was compared than was left out."""
        return self.compared > self.left_out

    @property
    def odd(self) -> int:
        """Outputs that only one side has, though the recording lacks nothing there."""
        return self.silent + self.invented

    def within(self, tolerance: float) -> bool:
        """Nothing differs by more than this, and both sides have the same outputs."""
        worst = max((row.greatest for row in self.differences.values()), default=0.0)
        return self.compared > 0 and not self.odd and worst <= tolerance


def logics() -> dict[str, Callable[[RobotSettings], Retraceable]]:
    """Processes that can be retraced, by name."""
    return {entry.name: entry.load() for entry in entry_points(group=ENTRY_POINTS)}


def retrace(process: str, make: Callable[[], Retraceable], entries: Iterable[Entry]) -> Report:
    """Lead a recording through a logic.

    Args:
        process: whose logic it is, as in its `Steps`.
        make: a new logic, for each start of the process.
        entries: the whole recording, in the order written.
    """
    tracer = _Tracer(process, make)
    for entry in entries:
        tracer.take(entry)
    return tracer.finish()


class _Tracer:
    def __init__(self, process: str, make: Callable[[], Retraceable]) -> None:
        self._make = make
        self._logic = make()
        self._report = Report(process)
        self._due: deque[Steps] = deque()
        self._told = (-1, -1)  # when the last step was of which the process told, and its number
        self._next = 0  # how many steps of this start of the process are known
        self._spans: list[tuple[int, int]] = []  # robot time of which all steps are known
        self._astray = False  # in a gap, or not yet found back from one
        self._inputs: dict[str, dict[int, list[Message]]] = {}
        self._outputs = _Waiting()  # recorded, not said yet
        self._said = _Waiting()  # said, not recorded yet: it may be written late

    def take(self, entry: Entry) -> None:
        _, key, message = entry
        if isinstance(message, Steps):
            ours = message.process == self._report.process and _whole(message)
            if ours and (told := (message.tick_ns[-1], message.begin)) > self._told:
                self._told = told  # a recorder's second life is told again
                self._due.append(message)
                self._walk_what_is_known()
        elif type(message) in self._logic.outputs:
            self._take_output((type(message).__name__, message.stamp_ns), message)
        elif type(message) in self._logic.inputs:
            kept = self._inputs.setdefault(key.partition("/")[2], {})
            kept.setdefault(message.stamp_ns, []).append(message)
            if len(kept) > KEPT:
                del kept[next(iter(kept))]

    def finish(self) -> Report:
        while self._due:
            self._walk(self._due.popleft())
        report = self._report
        report.invented = sum(not self._in_gap(stamp_ns) for _, stamp_ns in self._said)
        for _, stamp_ns in self._outputs:
            if self._in_gap(stamp_ns):
                report.left_out += 1
            elif any(begin <= stamp_ns < end - LATE_NS for begin, end in self._spans):
                report.silent += 1
            else:
                report.untold += 1
        return report

    def _take_output(self, output: Output, recorded: Message) -> None:
        said = self._said.pop(output)
        if said is None:
            self._outputs.put(output, recorded)
        elif self._in_gap(recorded.stamp_ns):
            self._report.left_out += 1
        else:
            self._compare(said, recorded)

    def _in_gap(self, stamp_ns: int) -> bool:
        return any(x.begin_ns - LATE_NS <= stamp_ns < x.until_ns for x in self._report.gaps)

    def _walk_what_is_known(self) -> None:
        """One behind, or more: what steps took in may be written after them.

        A recorder that came up late has the schema, say, from who keeps it, and later than those
        who had been listening.
        """
        due = self._due
        while len(due) > LATE_STEPS or (len(due) > 1 and self._knows(due[0])):
            self._walk(due.popleft())

    def _knows(self, steps: Steps) -> bool:
        heard = zip(steps.heard_key, steps.heard_ns, strict=True)
        return all(ns in self._inputs.get(steps.keys[place], ()) for place, ns in heard)

    def _walk(self, steps: Steps) -> None:
        report = self._report
        begin_ns, end_ns = steps.tick_ns[0], steps.tick_ns[-1]
        if steps.begin < self._next:  # the process was started anew
            self._logic = self._make()
            self._next = 0
            self._found_back(begin_ns)
            report.started_ns.append(begin_ns)
        if steps.begin > self._next:
            self._lack(report.end_ns or begin_ns, begin_ns)
        if self._spans and steps.begin and steps.begin == self._next:
            begin_ns = self._spans.pop()[0]
        self._spans.append((begin_ns, end_ns))
        report.lost_steps += steps.begin - self._next
        self._next = steps.begin + len(steps.tick_ns)
        report.begin_ns = report.begin_ns or begin_ns
        report.end_ns = end_ns
        report.steps += len(steps.tick_ns)
        heard = zip(steps.heard_key, steps.heard_ns, strict=True)
        for now_ns, taken in zip(steps.tick_ns, steps.taken, strict=True):
            for _ in range(taken):
                place, stamp_ns = next(heard)
                self._receive(steps.keys[place], stamp_ns, now_ns)
            for said in self._logic.tick(now_ns):
                if type(said) in self._logic.outputs:
                    self._hear(said, now_ns)

    def _receive(self, key: str, stamp_ns: int, now_ns: int) -> None:
        told = self._inputs.get(key, {}).get(stamp_ns)
        if told is None:
            self._report.unheard += 1
            self._lack(now_ns, now_ns)
            return
        try:  # two may have one stamp, where robot time stood still
            self._logic.receive(told.pop(0) if len(told) > 1 else told[0], now_ns)
        except Exception as error:  # as in the live loop, it costs this message
            log.warning("%s could not take %s: %r", self._report.process, key, error)

    def _lack(self, begin_ns: int, end_ns: int) -> None:
        gaps, self._astray = self._report.gaps, True
        if gaps and begin_ns - gaps[-1].end_ns <= ONE_GAP_NS:
            gaps[-1].end_ns, gaps[-1].until_ns = end_ns, math.inf
        else:
            gaps.append(Gap(begin_ns, end_ns))

    def _found_back(self, now_ns: int) -> None:
        if self._astray:
            self._astray = False
            self._report.gaps[-1].until_ns = now_ns

    def _hear(self, said: Message, now_ns: int) -> None:
        output = (type(said).__name__, said.stamp_ns)
        recorded = self._outputs.pop(output)
        if recorded is None:
            self._said.put(output, said)
        elif self._astray:
            self._report.left_out += 1
            if now_ns - self._report.gaps[-1].end_ns > LATE_NS:
                self._found_back(said.stamp_ns + 1)  # this one may still lack something
        else:
            self._compare(said, recorded)

    def _compare(self, said: Message, recorded: Message) -> None:
        kind, report = type(said).__name__, self._report
        report.compared += 1
        off = {
            name: distance
            for name, was in msgspec.structs.asdict(recorded).items()
            if (distance := _distance(was, getattr(said, name)))
        }
        report.equal += not off
        for name, distance in off.items():
            former = report.differences.get(f"{kind}.{name}", Difference(0.0, 0, 0))
            worst = max(former, Difference(distance, said.stamp_ns, 0))
            report.differences[f"{kind}.{name}"] = worst._replace(messages=former.messages + 1)


class _Waiting:
    """Messages by name and stamp; of those of one stamp the first comes out first."""

    def __init__(self) -> None:
        self._messages: dict[Output, list[Message]] = {}

    def put(self, output: Output, message: Message) -> None:
        self._messages.setdefault(output, []).append(message)

    def pop(self, output: Output) -> Message | None:
        waiting = self._messages.get(output)
        if waiting is None:
            return None
        first = waiting.pop(0)
        if not waiting:
            del self._messages[output]
        return first

    def __iter__(self) -> Iterator[Output]:
        for output, waiting in self._messages.items():
            yield from [output] * len(waiting)


def _whole(steps: Steps) -> bool:
    """Its lists fit each other; what a stranger published may not."""
    heard = len(steps.heard_ns)
    return (
        len(steps.tick_ns) == len(steps.taken) > 0
        and min(steps.taken) >= 0
        and sum(steps.taken) == len(steps.heard_key) == heard
        and all(0 <= place < len(steps.keys) for place in steps.heard_key)
    )


def _distance(was: Any, now: Any) -> float:
    """0 when the same to the last bit; inf when they cannot be subtracted."""
    if isinstance(was, tuple) and isinstance(now, tuple) and len(was) == len(now):
        return max(map(_distance, was, now), default=0.0)
    if was == now or (was != was and now != now):  # not a number, both
        return 0.0
    if isinstance(was, int | float) and isinstance(now, int | float):
        distance = abs(was - now)
        return math.inf if math.isnan(distance) else float(distance)
    return math.inf
