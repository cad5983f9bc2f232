"""Process: the simulated robot, its daisy chains, and robot time.

Bytes on a chain are answered with bytes; plug, unplug and faults are what hands do. The world paces
itself to wall time x speed. It never steps more than `LEAD_NS` past the last packet of a chain
whose master lives, so that on a machine that is too slow robot time slows for all alike. Its state
is saved every second and whenever a module was told something that must last: killed, it comes
back from there.
"""

from __future__ import annotations

import logging
import time
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor

import msgspec

from hardware_sim.robot import STEP_NS, PlugError, SimulatedRobot
from runtime import messages as m
from runtime.bus import Question
from runtime.messages import Message, Reply
from runtime.process import Launch
from runtime.wire.packet import Instruction

LEAD_NS = 10_000_000  # robot time past the last packet of each chain
PATIENCE_S = 0.1  # wall time to wait for a master that lives
BATCH = 5  # steps between two looks at the bus
CLOCK_NS = 10_000_000
TRUTH_NS = 5_000_000
SAVE_NS = 1_000_000_000
COMEBACK_NS = 2 * SAVE_NS  # the saved time is older than the last one told, by a save at most
LAG_LIMIT_S = 0.1  # behind by more than this, the pace starts anew
INSTRUCTION_AT = 7  # index of a packet's instruction byte
SNAPSHOT = "world"

log = logging.getLogger(__name__)


def main(launch: Launch) -> None:
    """Run the world until told to stop."""
    world = World(launch)
    with launch.open_bus() as member:
        member.subscribe(m.BusRequest, m.Presence, m.HandCommand, every=True)
        member.serve(m.Plug, m.Unplug, m.Fault)
        member.ready()
        world.start(time.monotonic())
        while not member.stopping:
            for item in member.wait(world.idle_s(time.monotonic())):
                if isinstance(item, Question):
                    item.reply(world.answer(item.request))
                else:
                    world.receive(item)
            for message in world.advance(time.monotonic()):
                member.publish(message)
            member.beat(world.robot.now_ns)
    world.close()


def _complain(saved: Future[None]) -> None:
    if error := saved.exception():
        log.error("the world's state was not saved: %s", error)


class World:
    """A `SimulatedRobot` under wall time."""

    def __init__(self, launch: Launch) -> None:
        self.speed = launch.speed
        self._store = launch.store
        self._incarnation = 1
        self.robot = self._restored(launch)
        now_ns = self.robot.now_ns
        self._master = {f"driver-{name}": name for name in self.robot.chains}
        self._alive: set[str] = set()  # chains whose master's token stands
        self._heard_ns = dict.fromkeys(self.robot.chains, now_ns)
        self._replies: dict[str, deque[tuple[int, m.BusReply]]] = {
            name: deque() for name in self.robot.chains
        }
        self._out: list[Message] = []
        self._clock_ns = self._truth_ns = now_ns
        self._save_ns = now_ns + SAVE_NS
        self._gated_since: float | None = None
        self._pace_wall = self._pace_ns = 0.0
        self._factor = launch.speed
        self._factor_wall, self._factor_ns = 0.0, now_ns
        self._clock_wall = 0.0
        self._saver = ThreadPoolExecutor(1)

    # ── wall time ─────────────────────────────────────────────────────────────────────────────

    def start(self, wall_s: float) -> None:
        """Robot time runs from here."""
        self._set_pace(wall_s)
        self._factor_wall = wall_s

    def idle_s(self, wall_s: float) -> float:
        """Wall seconds until the next step is due."""
        due = self._pace_wall + (self.robot.now_ns + STEP_NS - self._pace_ns) * 1e-9 / self.speed
        if self._gated_since is not None:
            return 0.002
        return max(due - wall_s, 0.0)

    def advance(self, wall_s: float) -> list[Message]:
        """Step as far as wall time and the chains' masters allow; gives what to publish."""
        robot = self.robot
        goal_ns = self._pace_ns + (wall_s - self._pace_wall) * 1e9 * self.speed
        for _ in range(BATCH):
            if robot.now_ns + STEP_NS > goal_ns or self._gated(wall_s):
                break
            robot.step()
            self._tell()
        if goal_ns - robot.now_ns > LAG_LIMIT_S * 1e9 * self.speed:
            self._set_pace(wall_s)
        if wall_s - self._factor_wall >= 1.0:
            self._factor = (robot.now_ns - self._factor_ns) * 1e-9 / (wall_s - self._factor_wall)
            self._factor_wall, self._factor_ns = wall_s, robot.now_ns
        if robot.now_ns - self._clock_ns >= CLOCK_NS and wall_s - self._clock_wall >= 0.004:
            self._clock_ns, self._clock_wall = robot.now_ns, wall_s
            self._out.append(
                m.Clock(
                    stamp_ns=robot.now_ns,
                    speed=self.speed,
                    real_time_factor=self._factor,
                    incarnation=self._incarnation,
                )
            )
        if robot.now_ns >= self._save_ns:
            self._save()
        out, self._out = self._out, []
        return out

    def _tell(self) -> None:
        now_ns = self.robot.now_ns
        for waiting in self._replies.values():
            while waiting and waiting[0][0] <= now_ns:
                self._out.append(waiting.popleft()[1])
        if now_ns - self._truth_ns >= TRUTH_NS:
            self._truth_ns = now_ns
            self._out.append(self.robot.truth())

    def _gated(self, wall_s: float) -> bool:
        """Whether some living master is owed time to speak."""
        late = [c for c in self._alive if self.robot.now_ns - self._heard_ns[c] >= LEAD_NS]
        if not late:
            self._gated_since = None
            return False
        if self._gated_since is None:
            self._gated_since = wall_s
        if wall_s - self._gated_since <= PATIENCE_S:
            return True
        for chain in late:
            self._heard_ns[chain] = self.robot.now_ns
        self._gated_since = None
        return False

    def _set_pace(self, wall_s: float) -> None:
        self._pace_wall, self._pace_ns = wall_s, self.robot.now_ns

    # ── bus ───────────────────────────────────────────────────────────────────────────────────

    def receive(self, message: Message) -> None:
        """Bytes from a master, its coming and going, and what the hands are told."""
        if isinstance(message, m.Presence):
            chain = self._master.get(message.process)
            if chain is not None:
                (self._alive.add if message.alive else self._alive.discard)(chain)
                self._heard_ns[chain] = self.robot.now_ns
        elif isinstance(message, m.HandCommand):
            self._close_hand(message)
        elif isinstance(message, m.BusRequest) and message.chain in self.robot.chains:
            # When it was sent counts, not when it came: else a master that hears everything late,
            # on a machine that is too slow, would be kept waiting for replies for good.
            heard_ns = max(self._heard_ns[message.chain], message.stamp_ns)
            self._heard_ns[message.chain] = min(heard_ns, self.robot.now_ns)
            reply, free_ns = self.robot.exchange(message)
            waiting = self._replies[message.chain]
            if free_ns - self.robot.now_ns <= STEP_NS and not waiting:
                self._out.append(reply)
            else:
                waiting.append((free_ns, reply))
            if message.data[INSTRUCTION_AT : INSTRUCTION_AT + 1] == bytes([Instruction.WRITE]):
                self._save_ns = min(self._save_ns, self.robot.now_ns + CLOCK_NS)

    def _close_hand(self, command: m.HandCommand) -> None:
        try:
            self._out.append(self.robot.hand(command))
        except PlugError as error:
            log.warning("hand '%s': %s", command.hand, error)
        self._save()

    def answer(self, request: Message) -> Reply:
        """What hands do; refused in words when they cannot."""
        if isinstance(request, m.Fault) and request.action == "list":
            return self._faults()
        try:
            if isinstance(request, m.Plug):
                event = self.robot.plug(request)
            elif isinstance(request, m.Unplug):
                event = self.robot.unplug(request)
            elif isinstance(request, m.Fault):
                event = self.robot.fault(request)
            else:
                return Reply(ok=False, text=f"the world does not know {type(request).__name__}")
        except PlugError as error:
            return Reply(ok=False, text=str(error))
        self._out.append(event)
        self._save()
        return Reply(ok=True, text=event.text, data=event.data)

    def _faults(self) -> Reply:
        broken = {
            f"{fault.kind} {fault.target}": self.robot.degree(fault)
            for fault in self.robot.faults.active
        }
        return Reply(ok=True, text="" if broken else "nothing is broken", data=broken)

    # ── state that outlives the process ───────────────────────────────────────────────────────

    def close(self) -> None:
        """Save for the last time."""
        self._save()
        self._saver.shutdown()

    def _save(self) -> None:
        self._save_ns = self.robot.now_ns + SAVE_NS
        state = {"incarnation": self._incarnation, "robot": self.robot.snapshot()}
        data = msgspec.msgpack.encode(state)
        # the disk may take longer than a step: not in this thread
        self._saver.submit(self._store.save, SNAPSHOT, data).add_done_callback(_complain)

    def _restored(self, launch: Launch) -> SimulatedRobot:
        robot = SimulatedRobot(launch.settings, launch.seed)
        data = self._store.load(SNAPSHOT)
        if data is None:
            return robot
        comeback_ns = 0
        try:
            state = msgspec.msgpack.decode(data)
            self._incarnation = int(state["incarnation"]) + 1
            comeback_ns = int(state["robot"]["now_ns"]) + COMEBACK_NS
            robot.restore(state["robot"], comeback_ns)
        except (msgspec.DecodeError, LookupError, ValueError, TypeError, AttributeError) as error:
            log.warning("the saved state does not fit this robot and is left aside: %s", error)
            robot = SimulatedRobot(launch.settings, launch.seed)
            robot.now_ns = comeback_ns  # if that at least could be read: time goes on
        return robot
