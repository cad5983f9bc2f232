"""The whole robot in one process on a virtual clock: same logic, same wire bytes, same plant.

The live group and this rig differ only in the bus and the clock. It is deterministic, and as fast
as the processor allows.
"""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from hardware_sim.robot import PlugError, SimulatedRobot
from runtime import messages as m
from runtime.logic import Logic, MemoryStore
from runtime.messages import Message, Reply
from runtime.settings import RobotSettings
from services.logic.arm import Arm
from services.logic.estimator import Estimator
from services.logic.executive import Executive
from services.logic.muscle_driver import MuscleDriver
from services.logic.retrainer import Retrainer
from services.logic.skeleton import Skeleton

TRUTH_EVERY_NS = 5_000_000
LINE_SLACK_NS = 1_000_000  # a reply that is out within the step is heard within the step


@dataclass(slots=True, eq=False)
class _Part:
    """A logic that takes part, and when it acts next."""

    logic: Logic
    due_ns: int
    woken: bool = False


class RigTimeoutError(RuntimeError):
    """What was waited for did not happen in the robot time allowed."""


class Rig:
    """One robot on a virtual clock.

    Attributes:
        robot: the simulated robot, whose truth only scores.
        now_ns: robot time.
        events: all events so far.
        last: newest message of each type.
    """

    def __init__(
        self,
        settings: RobotSettings,
        seed: int = 0,
        services: bool = True,
        arm: type[Arm] = Arm,
        retrainer: bool = True,
        stores: dict[str, MemoryStore] | None = None,
    ) -> None:
        self.settings = settings
        self.robot = SimulatedRobot(settings, seed)
        self.events: list[m.Event] = []
        self.last: dict[type[Message], Message] = {}
        self.watchers: list[Callable[[Message], None]] = []
        self._parts: list[_Part] = []
        self._quiet_until_ns = 0  # until then nobody has anything to do, unless something arrives
        self._readers: dict[type[Message], list[_Part]] = defaultdict(list)
        self._replies: dict[str, deque[tuple[int, m.BusReply]]] = defaultdict(deque)  # by chain
        self.stores = stores or {chain.name: MemoryStore() for chain in settings.chain}
        self.drivers = [
            self.add(MuscleDriver(settings, chain, store)) for chain, store in self.stores.items()
        ]
        if services:
            self.estimator = self.add(Estimator(settings))
            if retrainer:
                shipped = shipped_schema(settings)
                self.retrainer = self.add(
                    Retrainer(settings, MemoryStore(), shipped, _at_once, wall_s=perf_counter)
                )
            skeleton = Skeleton(settings.body_file, settings.joints)
            self.executive = self.add(
                Executive(settings, arm(settings, skeleton), MemoryStore(), seed)
            )

    @property
    def now_ns(self) -> int:
        """Robot time."""
        return self.robot.now_ns

    def add(self, logic: Any) -> Any:
        """Let a logic take part."""
        part = _Part(logic, self.robot.now_ns)
        self._parts.append(part)
        self._quiet_until_ns = 0
        for kind in logic.inputs:
            self._readers[kind].append(part)
        return logic

    def remove(self, logic: Any) -> None:
        """Take a logic out, as if its process had died."""
        self._parts = [part for part in self._parts if part.logic is not logic]
        for kind, parts in self._readers.items():
            self._readers[kind] = [part for part in parts if part.logic is not logic]

    @property
    def logics(self) -> list[Logic]:
        """All that take part."""
        return [part.logic for part in self._parts]

    def ask(self, request: Message) -> Reply:
        """Put a request to the hands or to the logics that answer it."""
        if isinstance(request, m.Plug | m.Unplug | m.Fault):
            try:
                event = self._by_hand(request)
            except PlugError as error:
                return Reply(ok=False, text=str(error))
            self._publish([event])
            return Reply(ok=True, text=event.text, data=event.data)
        reply = Reply(ok=False, text=f"nobody answers {type(request).__name__}")
        for part in self._parts:
            if type(request) in part.logic.requests:
                reply = part.logic.answer(request, self.now_ns)
                part.woken = True
                self._quiet_until_ns = 0
        return reply

    def _by_hand(self, request: m.Plug | m.Unplug | m.Fault) -> m.Event:
        if isinstance(request, m.Plug):
            return self.robot.plug(request)
        if isinstance(request, m.Unplug):
            return self.robot.unplug(request)
        return self.robot.fault(request)

    def run(self, seconds: float) -> None:
        """Let robot time pass."""
        for _ in range(round(seconds * 1000)):
            self.step()

    def run_until(self, condition: Callable[[], bool], limit_s: float, what: str = "") -> None:
        """Let robot time pass until something holds.

        Raises:
            RigTimeoutError: it did not come to hold within `limit_s` of robot time.
        """
        for _ in range(round(limit_s * 1000)):
            if condition():
                return
            self.step()
        raise RigTimeoutError(f"{what or 'the condition'} did not hold within {limit_s} s")

    def step(self) -> None:
        """One millisecond."""
        self.robot.step()
        if self.robot.now_ns >= self._quiet_until_ns:
            self._act(self.robot.now_ns)

    def _act(self, now_ns: int) -> None:
        """Tell the truth when that is due, hand on what the lines answered, let the logics act."""
        truth_ns = now_ns + TRUTH_EVERY_NS - now_ns % TRUTH_EVERY_NS  # the next
        if self.watchers and now_ns % TRUTH_EVERY_NS == 0:
            truth = self.robot.truth()
            for watcher in self.watchers:
                watcher(truth)
        for waiting in self._replies.values():
            while waiting and waiting[0][0] <= now_ns:
                self._publish([waiting.popleft()[1]])
        for _ in range(8):  # answers to answers within the step: ends as logics fall silent
            ready = [part for part in self._parts if part.woken or part.due_ns <= now_ns]
            if not ready:
                break
            for part in ready:
                part.woken = False
                if part.due_ns <= now_ns:
                    part.due_ns = now_ns + part.logic.period_ns
                self._publish(part.logic.tick(now_ns))
        else:
            return
        due = [part.due_ns for part in self._parts]
        out = [waiting[0][0] for waiting in self._replies.values() if waiting]
        self._quiet_until_ns = min([truth_ns, *due, *out])

    def _publish(self, messages: Iterable[Message]) -> None:
        now_ns = self.robot.now_ns
        for message in messages:
            if type(message) is m.BusRequest:
                reply, free_ns = self.robot.exchange(message)
                waiting = self._replies[message.chain]
                if free_ns - now_ns <= LINE_SLACK_NS and not waiting:
                    self._deliver(reply)
                else:
                    waiting.append((free_ns, reply))
                continue
            if type(message) is m.HandCommand:
                self._deliver(self.robot.hand(message))
            self._deliver(message)

    def _deliver(self, message: Message) -> None:
        kind = type(message)
        self.last[kind] = message
        if kind is m.Event:
            self.events.append(message)  # type: ignore[arg-type]
        for watcher in self.watchers:
            watcher(message)
        for part in self._readers.get(kind, ()):
            part.logic.receive(message, self.robot.now_ns)
            part.woken = True
            self._quiet_until_ns = 0


def shipped_schema(settings: RobotSettings) -> bytes | None:
    """Bytes of the schema that ships with the robot, if it is there."""
    path = settings.schema_file
    return path.read_bytes() if path is not None and path.exists() else None


def _at_once(job: Callable[[], Any]) -> Any:
    """Runs a training job where it stands: robot time does not pass meanwhile."""
    from concurrent.futures import Future

    future: Future[Any] = Future()
    try:
        future.set_result(job())
    except Exception as error:  # handed on: whoever asks for the result gets it
        future.set_exception(error)
    return future
