"""Starts a robot's processes, watches them, restarts them, and stops them safely.

The supervisor is the hub of its robot's network: it listens on a free loopback port, stands in the
registry (hubs.py) and connects to the other robots' hubs it finds there.
"""

from __future__ import annotations

import contextlib
import os
import queue
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from runtime.backoff import BackoffPolicy
from runtime.bus import Bus
from runtime.child import Child
from runtime.hearing import Hearing
from runtime.hubs import (
    Claim,
    Hub,
    address_file,
    free_endpoint,
    living_hubs,
    make_run_dir,
    next_run_dir,
    robot_home,
)
from runtime.manifest import Spec, chosen, processes_of, simulated
from runtime.member import EXECUTIVE, Member
from runtime.messages import (
    Estop,
    Event,
    ExecutiveState,
    GroupState,
    Health,
    Message,
    Presence,
    ProcessRow,
    Reply,
    Task,
)
from runtime.parking import Parking
from runtime.settings import RobotSettings

GROUP_STATE_S = 1.0
PARK_PATIENCE_S = 20.0  # of wall time: where robot time is slow, so is the arm
TERM_PATIENCE_S = 3.0
MEND = "mend what its log says, then Ctrl-C and `myograft up` again"  # of one that is given up


class Group:
    """One robot's processes under one supervisor. Use as a context manager, or `start` and `stop`.

    Args:
        settings: the robot.
        speed: robot seconds asked for per wall second.
        seed: of everything random.
        only: start these of the robot's processes only.
        connect: more endpoints to connect to: a router, when the robot is split over hosts.
        run_dir: of this run; by default a new one under the robot's state folder, made on start.
        state_dir: what outlives the run; by default the robot's own. A new folder is a new robot.
        processes: other processes than the robot's own: for tests.
        policy: of restarts.
        say: takes lines meant for a person.

    Raises:
        HubError: on start, when a robot of that name is running.
    """

    def __init__(
        self,
        settings: RobotSettings,
        *,
        speed: float = 1.0,
        seed: int = 0,
        only: tuple[str, ...] = (),
        connect: tuple[str, ...] = (),
        run_dir: Path | None = None,
        state_dir: Path | None = None,
        processes: tuple[Spec, ...] | None = None,
        policy: BackoffPolicy | None = None,
        say: Callable[[str], None] = lambda line: None,
    ) -> None:
        self.settings = settings
        self.endpoint = ""
        self.run_dir = run_dir or next_run_dir(settings.name)
        self._chosen_dir = run_dir is not None
        self._state_dir = state_dir or robot_home(settings.name) / "state"
        self._connect = connect
        self._arguments = ["--speed", str(speed), "--seed", str(seed)]
        self._specs = chosen(processes_of(settings) if processes is None else processes, only)
        self._policy = policy
        self._say = say
        self._exits: queue.SimpleQueue[tuple[Child, int]] = queue.SimpleQueue()
        self._children: dict[str, Child] = {}
        self._changed = threading.Condition()
        self._running = False
        self._ending = False
        self._restarting = threading.Lock()
        self._hurry = threading.Event()
        self._hearing = Hearing()
        self._stopped = False
        self._parking: Parking | None = None
        self._state_due_s = 0.0

    def __enter__(self) -> Group:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(park=False)

    # ── for the owner ──────────────────────────────────────────────────────────────────────────

    def start(self) -> None:
        """Open the hub and start every process; returns at once.

        Raises:
            HubError: a robot of that name is running.
            OSError: a folder cannot be made, or a process cannot be started; `stop` ends the rest.
        """
        also = (*self._connect, *(hub.endpoint for hub in living_hubs()))
        self.endpoint = free_endpoint()
        hub = Hub(
            robot=self.settings.name,
            pid=os.getpid(),
            endpoint=self.endpoint,
            run_dir=str(self.run_dir),
            file=self.settings.file,
            started=datetime.now(UTC).isoformat(timespec="seconds"),
        )
        self._claim = Claim(hub)
        if not self._chosen_dir:
            make_run_dir(self.run_dir)  # not before: who is refused leaves nothing behind
        logs = self.run_dir / "logs"
        logs.mkdir(parents=True, exist_ok=True)
        self._bus = Bus(self.settings.name, "supervisor", listen=self.endpoint, also=also)
        self._bus.__enter__()
        self._member = Member(self._bus, follow_world=simulated(self.settings))
        self._member.subscribe(Presence, ExecutiveState)
        self._member.subscribe(Health, wake=False)
        self._member.ready()
        for spec in self._specs:
            self._children[spec.process] = Child(
                spec,
                self._child_arguments(),
                logs / f"{spec.process}.log",
                self._on_exit,
                self._policy,
            )
        self._thread = threading.Thread(target=self._watch, name="supervisor", daemon=True)
        self._thread.start()
        self._running = True
        self._tell_person(f"{self.settings.name}: {len(self._specs)} processes, logs in {logs}")
        for child in self._children.values():
            child.start()

    def wait_ready(self, timeout_s: float = 30.0) -> bool:
        """Wait until every process is ready; False when one failed or time is up."""

        def settled() -> bool:
            return self.ready or any(row.state == "failed" for row in self.rows)

        with self._changed:
            self._changed.wait_for(settled, timeout_s)
        return self.ready

    def wait_for(self, condition: Callable[[Group], bool], timeout_s: float) -> bool:
        """Wait until `condition(group)` holds; looked at whenever a process changes."""
        with self._changed:
            return self._changed.wait_for(lambda: condition(self), timeout_s)

    @property
    def ready(self) -> bool:
        """Every process is ready."""
        return all(child.state == "ready" for child in self._children.values())

    @property
    def time_told(self) -> bool:
        """Robot time runs; not asked of a part of a robot whose world is elsewhere."""
        return "world" not in self._children or self._member.now_ns() is not None

    @property
    def rows(self) -> tuple[ProcessRow, ...]:
        """The table of processes."""
        return tuple(child.row for child in self._children.values())

    def request(self, message: Message, timeout_s: float | None = None) -> list[Reply]:
        """Ask the robot something."""
        return self._bus.request(message, timeout_s)

    def hurry(self) -> None:
        """End a running `stop` at once: estop instead of parking. Safe in a signal handler."""
        self._hurry.set()

    def stop(self, *, park: bool = True) -> None:
        """Park the arm, then end the processes in reverse order, the world last."""
        if not self._running:
            return
        self._running = False
        if park:
            self._park()
        if self._hurry.is_set():
            self._tell_person(f"{self.settings.name}: stopping the arm")
            self._bus.request(Estop(reason="interrupted twice"), timeout_s=2.0)
        with self._restarting:
            self._ending = True  # from now on nobody is started whom nobody would end
        patience_s = 0.5 if self._hurry.is_set() else TERM_PATIENCE_S
        for child in reversed(self._children.values()):
            child.terminate(patience_s)
        self._member.stop()
        self._thread.join()
        self._bus.__exit__(None, None, None)
        self._claim.release()
        self._tell_person(f"{self.settings.name}: stopped")

    # ── the watching thread ────────────────────────────────────────────────────────────────────

    def _watch(self) -> None:
        while not (self._member.stopping and self._exits.empty()):
            changed = False
            for item in self._member.wait(self._wait_s()):
                if isinstance(item, Presence):
                    changed = self._came_or_went(item) or changed
                elif isinstance(item, Health):
                    self._mend_links(item)
                elif isinstance(item, ExecutiveState):
                    self._watch_stop(item)
                    if self._parking is not None:
                        self._parking.see(item, time.monotonic())
            while not self._exits.empty():
                self._bury(*self._exits.get())
                changed = True
            self._tell(self._restart() or changed)
        self._tell(True)

    def _restart(self) -> bool:
        with self._restarting:
            if self._ending:
                return False
            return any([child.restart_if_due() for child in self._children.values()])

    def _wait_s(self) -> float:
        now_s = time.monotonic()
        due = [self._state_due_s]
        due += [c.restart_at_s for c in self._children.values() if c.restart_at_s is not None]
        return min(max(0.0, min(due) - now_s), 0.2)

    def _came_or_went(self, presence: Presence) -> bool:
        child = self._children.get(presence.process)
        if child is None or not presence.alive or child.state != "starting":
            return False
        file = address_file(self.run_dir, presence.process)
        address = f": {file.read_text()}" if file.exists() else ""
        self._tell_person(f"{self.settings.name}: {presence.process} ready{address}")
        child.became_ready()  # after it is said: who waits for readiness has the lines before it
        if child.restarts:
            self._tell_event("process_restarted", "info", child, f"{presence.process} is back")
        return True

    def _bury(self, child: Child, code: int) -> None:
        child.died(code, ending=self._ending)
        if self._ending:
            return
        what = {"backoff": "restarting", "failed": "given up"}.get(child.state, child.state)
        text = f"{child.spec.process} died ({child.last_exit}), {what}: see {child.log_file}"
        if child.state == "failed":
            text += f"; {MEND}"
        self._tell_person(f"{self.settings.name}: {text}")
        level = "info" if child.state == "stopped" else "error"
        self._tell_event("process_died", level, child, text)
        if child.state == "failed":
            given_up = f"{child.spec.process} is given up: {MEND}"
            self._tell_event("process_failed", "error", child, given_up)

    def _watch_stop(self, state: ExecutiveState) -> None:
        stopped = state.stage == "stopped"
        if stopped and not self._stopped and self._running:
            name = self.settings.name
            self._tell_person(f"{name}: stopped; `myograft reset` lets it hold where it is")
        self._stopped = stopped

    def _mend_links(self, health: Health) -> None:
        ready = {name for name, child in self._children.items() if child.state == "ready"}
        if health.process not in ready:
            return
        lost, news = self._hearing.lost(health, ready & self._member.alive)
        if lost:
            self._bus.call_together()
        for other in news:
            text = f"{health.process} no longer heard {other}: they were called together again"
            self._tell_event("link_lost", "warning", self._children[health.process], text)

    def _tell_event(self, kind: str, level: str, child: Child, text: str) -> None:
        self._member.publish(
            Event(
                stamp_ns=self._member.now_ns() or 0,
                process="supervisor",
                level=level,
                kind=kind,
                text=text,
                data={
                    "process": child.spec.process,
                    "exit": child.last_exit,
                    "restarts": str(child.restarts),
                },
            )
        )

    def _tell(self, changed: bool) -> None:
        now_s = time.monotonic()
        now_ns = self._member.now_ns() or 0
        if changed or now_s >= self._state_due_s:
            self._state_due_s = now_s + GROUP_STATE_S
            self._member.publish(
                GroupState(
                    stamp_ns=now_ns,
                    ready=self.ready,
                    run_dir=str(self.run_dir),
                    processes=self.rows,
                )
            )
        self._member.beat(now_ns)
        if changed:
            with self._changed:
                self._changed.notify_all()

    def _tell_person(self, line: str) -> None:
        with contextlib.suppress(OSError):  # nobody reads any more: no reason to let go of a robot
            self._say(line)

    # ── inside ─────────────────────────────────────────────────────────────────────────────────

    def _park(self) -> None:
        executive = self._children.get(EXECUTIVE)
        if executive is None or executive.state != "ready" or self._hurry.is_set():
            return
        self._tell_person(f"{self.settings.name}: parking (Ctrl-C again stops at once)")
        parking = Parking(time.monotonic(), PARK_PATIENCE_S)
        self._parking = parking
        replies = self._bus.request(Task(name="park"), timeout_s=2.0)
        if not any(reply.ok for reply in replies):
            refusal = replies[0].text if replies else "nobody answered"
            self._tell_person(f"{self.settings.name}: not parked: {refusal}")
            return
        while not (parking.over(time.monotonic()) or executive.state != "ready"):
            if self._hurry.wait(0.05):
                return
        how = "parked" if parking.parked else "not parked in time, stopped as it is"
        self._tell_person(f"{self.settings.name}: {how}")

    def _on_exit(self, child: Child, code: int) -> None:
        self._exits.put((child, code))
        self._bus.wake()

    def _child_arguments(self) -> list[str]:
        return [
            *("--robot", self.settings.file),
            *("--name", self.settings.name),
            *("--run-dir", str(self.run_dir)),
            *("--state-dir", str(self._state_dir)),
            *("--endpoint", self.endpoint),
            *("--parent", str(os.getpid())),
            *(word for endpoint in self._connect for word in ("--connect", endpoint)),
            *self._arguments,
        ]
