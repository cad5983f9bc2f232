"""The loop that drives a logic: arrivals in, ticks on a grid of robot time, messages out."""

from __future__ import annotations

import logging
import time

from runtime.bus import Question
from runtime.logic import Logic
from runtime.member import EXECUTIVE, Member
from runtime.messages import ExecutiveState, Message, Reply, Steps, Task
from runtime.parking import Parking
from runtime.steps import StepLog

UNKNOWN_TIME_S = 0.02  # how often to look whether the world has told the time
LONGEST_WAIT_S = 0.2  # so that signals and the supervisor's death are noticed
NO_TIME = Reply(ok=False, text="robot time is not known yet: the world has not started")

log = logging.getLogger(__name__)


def drive(logic: Logic, member: Member, steps: StepLog | None = None) -> None:
    """Drive `logic` until `member.stopping`.

    Ticks fall on multiples of `period_ns`, and besides right after each batch of arrivals. What is
    taken in at each is told by `steps`.

    Raises:
        SystemExit: with code 1, after an exception in `tick`.
    """
    early: list[Message] = []  # arrived before robot time was known
    while not member.stopping and (now_ns := member.now_ns()) is None:
        for item in member.wait(UNKNOWN_TIME_S):
            if isinstance(item, Question):
                item.reply(NO_TIME)
            else:
                early.append(item)
    if member.stopping or now_ns is None:
        return
    runner = _Runner(logic, member, steps)
    runner.step(list(early), now_ns)
    while not (member.stopping or runner.parked):
        wait_s = member.clock.wall_s_until(runner.due_ns, time.monotonic_ns())
        items = member.wait(min(wait_s, LONGEST_WAIT_S))
        now_ns = member.now_ns()
        assert now_ns is not None
        runner.step(items, now_ns)
    runner.close()


class _Runner:
    def __init__(self, logic: Logic, member: Member, steps: StepLog | None) -> None:
        self.due_ns = 0
        self._logic = logic
        self._member = member
        self._steps = steps
        self._complaints: set[tuple[str, str]] = set()
        self._parking: Parking | None = None

    @property
    def parked(self) -> bool:
        """The supervisor is gone and the arm is where it may be left."""
        return self._parking is not None and self._parking.over(time.monotonic())

    def step(self, items: list[Message | Question] | list[Message], now_ns: int) -> None:
        for item in items:
            self._take(item, now_ns)
        self._park_if_orphaned(now_ns)
        if not items and now_ns < self.due_ns:
            return
        for message in self._tick(now_ns):
            self._member.publish(message)
            if self._parking is not None and isinstance(message, ExecutiveState):
                self._parking.see(message, time.monotonic())
        if self._steps is not None:
            self._tell(self._steps.act(now_ns))
        period_ns = self._logic.period_ns
        if now_ns >= self.due_ns:
            self.due_ns = (now_ns // period_ns + 1) * period_ns
        self._member.beat(now_ns)

    def close(self) -> None:
        """Tell what is left to tell."""
        if self._steps is not None:
            self._tell(self._steps.rest())

    def _tell(self, steps: Steps | None) -> None:
        if steps is not None:
            self._member.publish(steps)

    def _take(self, item: Message | Question, now_ns: int) -> None:
        # One bad message costs itself: it must not end the process.
        try:
            if isinstance(item, Question):
                item.reply(self._answer(item.request, now_ns))
            else:
                if self._steps is not None:
                    self._steps.take(item)
                self._logic.receive(item, now_ns)
        except Exception as error:
            asked = item.request if isinstance(item, Question) else item
            self._complain(type(asked).__name__, error)

    def _answer(self, request: Message, now_ns: int) -> Reply:
        try:
            return self._logic.answer(request, now_ns)
        except Exception as error:
            kind = type(request).__name__
            self._complain(kind, error)
            return Reply(ok=False, text=f"{kind} failed in {self._member.process}: {error!r}")

    def _complain(self, kind: str, error: Exception) -> None:
        log.error("could not take %s", kind, exc_info=error)
        complaint = (kind, type(error).__name__)
        if complaint not in self._complaints:
            self._complaints.add(complaint)
            text = f"{self._member.process} could not take {kind}: {error!r}"
            self._member.report("receive_failed", text)

    def _tick(self, now_ns: int) -> list[Message]:
        try:
            return list(self._logic.tick(now_ns))
        except Exception as error:
            log.exception("tick failed")
            text = f"{self._member.process} failed and ends: {error!r}"
            self._member.report("tick_failed", text)
            raise SystemExit(1) from error

    def _park_if_orphaned(self, now_ns: int) -> None:
        orphaned_at = self._member.orphaned_at
        if orphaned_at is None or self._parking is not None:
            return
        if self._member.process == EXECUTIVE and Task in self._logic.requests:
            self._parking = Parking(orphaned_at, patience_s=15.0)
            reply = self._answer(Task(stamp_ns=now_ns, name="park"), now_ns)
            log.warning("parking: %s", reply.text)
            if not reply.ok:
                self._parking.give_up()
