"""Real processes over local Zenoh: start, watch, restart, stop, and misfortune."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path

import psutil
import pytest
import zenoh
from mcap.reader import make_reader

from runtime import supervisor
from runtime.backoff import BackoffPolicy, Restart
from runtime.bus import Bus, Question
from runtime.child import Child
from runtime.hubs import HubError, free_endpoint, living_hubs
from runtime.manifest import Spec
from runtime.messages import (
    Event,
    ExecutiveState,
    GroupState,
    Identify,
    Message,
    Reach,
    Reply,
    Task,
    TrainingProgress,
)
from runtime.settings import RobotSettings, load_robot
from runtime.supervisor import Group
from tests.started import started

HERE = "tests.integration.logics"
COUNTER = Spec("counter", entry=f"{HERE}:counter")
ECHO = Spec("echo", entry=f"{HERE}:echo")
PARKER = Spec("executive", entry=f"{HERE}:parker")
SITS = Spec("sits", entry=f"{HERE}:sits")
PATIENCE_S = 30.0  # of wall time, for what only a broken runtime does not do


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path


def settings(name: str) -> RobotSettings:
    """The elbow, on a host without a world: robot time is the host's."""
    robot = load_robot("elbow", name)
    return _with_real_chains(robot)


def _with_real_chains(robot: RobotSettings) -> RobotSettings:
    text = Path(robot.file).read_text().replace('link = "sim:"', 'link = "serial:///dev/null"')
    text = text.replace('"../', f'"{Path(robot.file).parent}/../')
    path = Path(os.environ["XDG_STATE_HOME"]) / f"{robot.name}.toml"
    path.write_text(text)
    return load_robot(str(path), robot.name)


@contextmanager
def running(name: str, *specs: Spec, **options: object) -> Iterator[Group]:
    group = Group(settings(name), processes=specs, **options)  # type: ignore[arg-type]
    group.start()
    try:
        assert group.wait_ready(PATIENCE_S), [row for row in group.rows]
        yield group
    finally:
        group.stop(park=False)


class Ear:
    """Listens on a robot's bus and forgets nothing it has not been asked for."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.heard: list[Message] = []

    def wait_for(
        self,
        wanted: Callable[[Message], bool],
        meanwhile: Callable[[], object] = lambda: None,
    ) -> Message:
        """The next that is wanted. What is done `meanwhile` may be lost until all have met."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            for i, message in enumerate(self.heard):
                if wanted(message):
                    del self.heard[: i + 1]
                    return message
            if time.monotonic() > deadline:
                raise AssertionError(f"it never came, but {self.heard}")
            meanwhile()
            self.heard = [item for item in self.bus.wait(0.1) if isinstance(item, Message)]


@contextmanager
def listening_at(endpoint: str, robot: str, *kinds: type[Message]) -> Iterator[Ear]:
    with Bus(robot, "test", endpoint=endpoint) as bus:
        bus.subscribe(*kinds)
        yield Ear(bus)


@contextmanager
def listening(group: Group, *kinds: type[Message], robot: str = "") -> Iterator[Ear]:
    with listening_at(group.endpoint, robot or group.settings.name, *kinds) as ear:
        yield ear


def happened(kind: str) -> Callable[[Message], bool]:
    return lambda message: isinstance(message, Event) and message.kind == kind


def pid_of(group: Group, process: str) -> int:
    return next(row.pid for row in group.rows if row.process == process)


def only_when_told(group: Group) -> float:
    """How long a supervisor sleeps that looks by itself for restarts alone."""
    return 0.01 if any(row.state == "backoff" for row in group.rows) else 10 * PATIENCE_S


def test_killed_process_is_noticed_at_once_restarted_and_finds_its_store(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Group, "_wait_s", only_when_told)
    with running("killed", COUNTER) as group, listening(group, Event, TrainingProgress) as ear:
        before = ear.wait_for(lambda m: isinstance(m, TrainingProgress) and m.epoch >= 3)
        os.kill(pid_of(group, "counter"), signal.SIGKILL)
        died = ear.wait_for(happened("process_died"))
        assert isinstance(died, Event)
        assert died.data["exit"] == "killed by SIGKILL"
        ear.wait_for(happened("process_restarted"))
        after = ear.wait_for(lambda m: isinstance(m, TrainingProgress))
        assert isinstance(before, TrainingProgress)
        assert isinstance(after, TrainingProgress)
        assert after.epoch > before.epoch
        assert group.rows[0].restarts == 1


def test_requests_are_answered_and_exceptions_told() -> None:
    with running("asked", COUNTER, ECHO) as group, listening(group, Event) as ear:
        (reply,) = group.request(Reach(angle_rad={"elbow": 1.0}))
        assert reply.ok
        assert reply.data["process"] == "echo"
        stumbles = TrainingProgress(job="stumble", stage="failed")
        ear.wait_for(happened("receive_failed"), meanwhile=lambda: ear.bus.publish(stumbles))
        (reply,) = group.request(Reach(angle_rad={"break": 1.0}))
        ear.wait_for(happened("tick_failed"))
        ear.wait_for(happened("process_restarted"))
        assert next(row for row in group.rows if row.process == "echo").last_exit == "exit 1"


def test_odd_messages_end_nothing_and_are_told_once() -> None:
    with running("odd", ECHO) as group, listening(group, Event) as ear:
        key = "odd/training/progress"
        right = "application/msgpack;type=TrainingProgress;v=1"
        odd = [(b"\xc1", right), (b"{}", "application/json"), (b"\x80", right), (b"", right)]
        odd.append((b"\x80", right.replace("v=1", "v=2")))
        with zenoh.open(zenoh.Config.from_json5(_client(group.endpoint))) as stranger:
            told = []
            for payload, encoding in odd:  # LATEST keeps one: let each be met
                put = partial(stranger.put, key, payload, encoding=encoding)
                told.append(ear.wait_for(happened("message_dropped"), meanwhile=put))
            for payload, encoding in odd:
                stranger.put(key, payload, encoding=encoding)
            put = partial(stranger.put, key, b"\x80", encoding=right.replace("v=1", "v=3"))
            told.append(ear.wait_for(happened("message_dropped"), meanwhile=put))
        assert len({event.text for event in told if isinstance(event, Event)}) == len(odd) + 1
        assert group.request(Reach(angle_rad={"elbow": 1.0}))[0].ok
        assert group.rows[0].restarts == 0


def test_two_processes_that_lost_each_other_find_each_other_again() -> None:
    def heard(**angle_rad: float) -> int:
        return int(group.request(Reach(angle_rad=angle_rad or {"elbow": 0.0}))[0].data["heard"])

    with running("severed", COUNTER, ECHO) as group, listening(group, Event) as ear:
        assert heard(sever=1.0) >= 0
        event = ear.wait_for(happened("link_lost"))
        assert isinstance(event, Event)
        assert "counter" in event.text and "echo" in event.text
        before = heard()
        deadline = time.monotonic() + PATIENCE_S
        while heard() <= before + 10:
            assert time.monotonic() < deadline
        assert [row.restarts for row in group.rows] == [0, 0]


def test_two_robots_share_a_network_and_hear_only_themselves() -> None:
    with running("left", COUNTER) as left, running("right", ECHO) as right:
        assert [hub.robot for hub in living_hubs()] == ["left", "right"]
        with listening(right, TrainingProgress, robot="left") as ear:  # over both hubs
            ear.wait_for(lambda m: isinstance(m, TrainingProgress))
        (reply,) = right.request(Reach(angle_rad={"elbow": 1.0}))
        assert reply.data["heard"] == "0"
        assert left.request(Reach(angle_rad={"elbow": 1.0}), timeout_s=1) == []
        refused = Group(settings("left"), processes=(ECHO,))
        with pytest.raises(HubError, match="--name"):
            refused.start()
        assert not refused.run_dir.exists()
        assert (left.run_dir.parent / "latest").resolve() == left.run_dir.resolve()
    assert living_hubs() == []


def test_a_process_that_keeps_dying_is_given_up() -> None:
    policy = BackoffPolicy(first_s=0.01, budget=2)
    dies = Spec("dies", entry=f"{HERE}:dies")
    once = Spec("once", Restart.NEVER, entry=f"{HERE}:dies")
    group = Group(settings("dying"), processes=(dies, once, SITS), policy=policy)
    with group:
        assert not group.wait_ready(PATIENCE_S)
        assert group.wait_for(lambda g: g.rows[0].state == "failed", PATIENCE_S)
        assert group.wait_for(lambda g: g.rows[2].state == "ready", PATIENCE_S)
        assert group.rows[0].restarts == 2
        assert group.rows[1].restarts == 0
        with listening(group, GroupState) as ear:  # retained: a late listener is told
            state = ear.wait_for(lambda m: isinstance(m, GroupState))
            assert isinstance(state, GroupState)
            assert not state.ready


def test_parks_before_it_stops() -> None:
    with (
        running("parked", PARKER, SITS) as group,
        listening(group, Event, ExecutiveState) as ear,
    ):
        ear.wait_for(lambda m: isinstance(m, ExecutiveState))  # by now the two have met
        pids = [row.pid for row in group.rows]
        group.stop()
        ear.wait_for(happened("parked"))
        assert not any(psutil.pid_exists(pid) for pid in pids)
        assert [row.state for row in group.rows] == ["stopped", "stopped"]


def test_a_stop_is_told_to_whoever_reads_what_the_group_says() -> None:
    told: queue.SimpleQueue[str] = queue.SimpleQueue()
    with running("halted", PARKER, say=told.put) as group:
        assert group.request(Task(name="stopped"))[0].ok
        while "stopped" not in (line := told.get(timeout=PATIENCE_S)):
            pass
        assert "myograft reset" in line


def test_hurry_ends_a_long_parking(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(supervisor, "PARK_PATIENCE_S", 10 * PATIENCE_S)
    never = Spec("executive", entry=f"{HERE}:never_parks")
    with running("hurried", never) as group, listening(group, ExecutiveState) as ear:
        stopper = threading.Thread(target=group.stop, daemon=True)
        stopper.start()
        ear.wait_for(lambda m: isinstance(m, ExecutiveState) and m.stage == "park")
        group.hurry()
        stopper.join(PATIENCE_S)
        assert not stopper.is_alive()


def test_a_restart_that_falls_into_a_stop_leaves_nobody_behind(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    due, start, pids = threading.Event(), Child.start, []

    def held_up(child: Child) -> None:
        if child.restarts:
            due.set()
            time.sleep(0.3)  # the stop begins meanwhile
        start(child)
        pids.append(child.row.pid)

    monkeypatch.setattr(Child, "start", held_up)
    with running("late", SITS) as group:
        os.kill(pid_of(group, "sits"), signal.SIGKILL)
        assert due.wait(PATIENCE_S)
    assert not any(psutil.pid_exists(pid) for pid in pids)


def test_a_chains_request_reaches_that_chains_driver_alone() -> None:
    endpoint = free_endpoint()
    with (
        Bus("two", "test", listen=endpoint) as asker,
        Bus("two", "driver-left", endpoint=endpoint) as left,
        Bus("two", "driver-right", endpoint=endpoint) as right,
    ):
        over = threading.Event()

        def answer(bus: Bus) -> None:
            while not over.is_set():
                for item in bus.wait(0.05):
                    assert isinstance(item, Question)
                    item.reply(Reply(ok=True, text=bus.process))

        threads = []
        for bus, chain in ((left, "left"), (right, "right")):
            bus.serve(Identify, chain=chain)
            threads.append(threading.Thread(target=answer, args=(bus,)))
            threads[-1].start()
        try:
            for chain in ("left", "right", "left"):
                replies: list[Reply] = []
                deadline = time.monotonic() + PATIENCE_S
                while not replies and time.monotonic() < deadline:  # they have yet to meet
                    replies = asker.request(Identify(chain=chain, module="m"))
                assert [reply.text for reply in replies] == [f"driver-{chain}"]
            assert asker.request(Identify(chain="none", module="m"), timeout_s=1) == []
            for name in ("", "left?", "*"):
                (refusal,) = asker.request(Identify(chain=name, module="m"))
                assert not refusal.ok
                assert (
                    refusal.text
                    == f"Identify reaches nobody: 'two/chain/{name}/identify' is no key"
                )
        finally:
            over.set()
            for thread in threads:
                thread.join()


def test_who_wants_little_is_not_sent_much() -> None:
    """States are thinned out before they are read; what happens once is not."""
    endpoint = free_endpoint()
    with (
        Bus("thin", "driver-arm", listen=endpoint) as speaker,
        Bus("thin", "all", endpoint=endpoint) as greedy,
        Bus("thin", "few", endpoint=endpoint, most_hz=10.0) as modest,
    ):
        for bus in (greedy, modest):
            bus.subscribe(ExecutiveState, TrainingProgress, every=True)
        deadline = time.monotonic() + PATIENCE_S
        while not (greedy.received and modest.received) and time.monotonic() < deadline:
            speaker.publish(ExecutiveState(stage="hold"))
            for bus in (greedy, modest):
                bus.wait(0.02)
        before = [bus.received.copy() for bus in (greedy, modest)]
        began_s = due = time.monotonic()
        for epoch in range(100):
            speaker.publish(ExecutiveState(stage="hold"))
            speaker.publish(TrainingProgress(job="j", stage="training", epoch=epoch))
            due += 0.01
            time.sleep(max(0.0, due - time.monotonic()))
        for bus in (greedy, modest):
            deadline = time.monotonic() + 5
            last = False
            while not last and time.monotonic() < deadline:
                last = any(getattr(item, "epoch", 0) == 99 for item in bus.wait(0.1))
        took_s = time.monotonic() - began_s  # however late they came
        all_, few = (bus.received - was for bus, was in zip((greedy, modest), before, strict=True))
        # Neither is sent so that it must arrive: on a busy machine one may be lost.
        assert min(all_["TrainingProgress"], few["TrainingProgress"], all_["ExecutiveState"]) > 90
        assert 3 <= few["ExecutiveState"] <= 10 * took_s + 2


def test_a_process_is_said_to_be_ready_before_it_counts_as_ready() -> None:
    told = []
    group = Group(
        settings("said"),
        processes=(COUNTER,),
        say=lambda line: told.append((line, group.ready)),
    )
    with group:
        assert group.wait_ready(PATIENCE_S)
    assert ("said: counter ready", False) in told


def foreground(name: str) -> AbstractContextManager[subprocess.Popen[str]]:
    """`myograft up` with one process, in the foreground."""
    words = ("up", settings(name).file, "--name", name, "--only", "recorder")
    return started("-m", "runtime.cli.main", *words)


def test_up_in_the_foreground_until_ctrl_c(home: Path) -> None:
    with foreground("fore") as up:
        assert up.stdout is not None
        told = ""
        for line in up.stdout:
            told += line
            if "Ctrl-C" in line:
                break
        assert "recorder ready" in told
        assert [hub.robot for hub in living_hubs()] == ["fore"]
        up.send_signal(signal.SIGINT)
        assert "stopped" in up.stdout.read()
        assert up.wait(PATIENCE_S) == 0
    assert living_hubs() == []
    recording = home / "myograft" / "fore" / "runs" / "latest" / "messages.mcap"
    with recording.open("rb") as file:
        assert make_reader(file).get_summary() is not None  # closed whole, not torn


def test_up_goes_on_and_stops_well_when_nobody_reads_its_lines_any_more() -> None:
    with foreground("unread") as up:
        assert up.stdout is not None
        assert up.stdout.readline()
        up.stdout.close()
        (hub,) = living_hubs()
        with listening_at(hub.endpoint, "unread", GroupState) as ear:
            ear.wait_for(lambda m: isinstance(m, GroupState) and m.ready)
        up.send_signal(signal.SIGINT)
        assert up.wait(PATIENCE_S) == 0
    assert living_hubs() == []


SUPERVISOR = """
import sys, threading
from runtime.manifest import Spec
from runtime.settings import load_robot
from runtime.supervisor import Group
specs = tuple(Spec(p, entry=e) for p, e in zip(sys.argv[2::2], sys.argv[3::2]))
group = Group(load_robot(sys.argv[1], "orphaned"), processes=specs)
group.start()
assert group.wait_ready(30)
print(*[row.pid for row in group.rows], flush=True)
threading.Event().wait()
"""


def test_without_their_supervisor_they_park_and_exit() -> None:
    robot = settings("orphaned").file
    arguments = [word for spec in (PARKER, SITS) for word in (spec.process, spec.entry)]
    with started("-c", SUPERVISOR, robot, *arguments) as parent:
        assert parent.stdout is not None
        orphans = [psutil.Process(int(word)) for word in parent.stdout.readline().split()]
        assert len(orphans) == 2
        parent.kill()
    _, left = psutil.wait_procs(orphans, timeout=PATIENCE_S)
    assert not left
    assert living_hubs() == []
    logs = Path(os.environ["XDG_STATE_HOME"], "myograft", "orphaned", "runs", "latest", "logs")
    assert "parking" in (logs / "executive.log").read_text()


def _client(endpoint: str) -> str:
    return f'{{mode: "client", connect: {{endpoints: ["{endpoint}"]}}}}'
