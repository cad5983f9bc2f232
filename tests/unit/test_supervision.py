"""The supervisor's decisions, without processes: back-off, parking, who is started, where."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from runtime.backoff import Backoff, BackoffPolicy, Restart
from runtime.child import describe_exit
from runtime.cli import up
from runtime.cli.main import REFUSED, main
from runtime.hubs import ENDPOINT_VARIABLE, Claim, Hub, HubError, find_hub, living_hubs
from runtime.mailbox import Mailbox
from runtime.manifest import processes_of
from runtime.messages import ExecutiveState, ProcessRow
from runtime.parking import Parking
from runtime.priority import step_back
from runtime.settings import load_robot
from runtime.store import FileStore
from runtime.supervisor import Group


def test_the_wait_doubles_up_to_the_longest() -> None:
    backoff = Backoff(Restart.ALWAYS, BackoffPolicy(first_s=0.05, longest_s=0.3))
    assert [backoff.died(1, wall_s=0.0) for _ in range(5)] == [0.05, 0.1, 0.2, 0.3, 0.3]


def test_who_only_looks_or_learns_steps_back() -> None:
    """So does its session, where Linux groups by session: a nice level counts within one only."""
    specs = {spec.process: spec.nice for spec in processes_of(load_robot("elbow"))}
    back = {name for name, nice in specs.items() if nice}
    assert back == {"recorder", "retrainer", "web", "viz"} & specs.keys()
    with subprocess.Popen(["sleep", "60"], start_new_session=True) as child:
        try:
            step_back(child.pid, 7)
            assert os.getpriority(os.PRIO_PROCESS, child.pid) == 7
            assert os.sched_getscheduler(child.pid) == os.SCHED_BATCH
            session = Path(f"/proc/{child.pid}/autogroup")
            deadline = time.monotonic() + 30.0
            while session.exists() and "nice 7" not in session.read_text():
                assert time.monotonic() < deadline
                time.sleep(0.01)
        finally:
            child.kill()
    step_back(child.pid, 7)  # gone is no mistake


def test_up_says_ready_however_late_and_once_for_whom_it_waits(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(up, "PATIENCE_S", 0.0)
    settled = {"left": iter([False, False, True]), "right": iter([True])}

    class Late(Group):
        def wait_ready(self, timeout_s: float = 30.0) -> bool:
            return next(settled[self.settings.name])

    groups = [Late(load_robot("elbow", name), processes=()) for name in settled]
    up._tell_when_ready(list(groups), threading.Event())
    told = [line.partition(" after")[0] for line in capsys.readouterr().out.splitlines()]
    assert told == [
        "right: ready",
        "left: still waiting for the world to tell the time",
        "left: ready",
    ]


def test_up_tells_a_process_that_is_given_up_from_one_that_is_late(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(up, "PATIENCE_S", 0.0)
    others = iter(["starting", "backoff", "ready"])

    class Broken(Group):
        state = ""

        def wait_ready(self, timeout_s: float = 30.0) -> bool:
            self.state = next(others)
            return False

        @property
        def rows(self) -> tuple[ProcessRow, ...]:
            states = {"viz": "failed", "estimator": self.state}
            return tuple(ProcessRow(process=k, state=v, pid=0) for k, v in states.items())

    up._tell_when_ready([Broken(load_robot("elbow"), processes=())], threading.Event())
    assert capsys.readouterr().out.splitlines() == [
        "elbow: still waiting for estimator",
        "elbow: runs without viz: mend what its log says, then Ctrl-C and `myograft up` again",
    ]


@pytest.fixture
def signals() -> Iterator[None]:
    """`up` takes them; they are given back."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("signals")
def test_up_that_cannot_start_a_process_says_so_and_ends(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.setattr("runtime.child.sys.executable", "/nowhere/python")
    assert main(["up", "elbow"]) == REFUSED
    told = capsys.readouterr()
    assert "/nowhere/python" in told.err
    assert "elbow: stopped" in told.out
    assert living_hubs() == []


@pytest.mark.usefixtures("signals")
def test_up_without_a_place_for_its_state_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    assert main(["up", "elbow"]) == REFUSED
    assert str(tmp_path / "file") in capsys.readouterr().err


def test_the_budget_ends_and_the_window_moves_on() -> None:
    backoff = Backoff(Restart.ALWAYS, BackoffPolicy(budget=2, window_s=60))
    assert backoff.died(1, wall_s=0.0) is not None
    assert backoff.died(1, wall_s=1.0) is not None
    assert backoff.died(1, wall_s=2.0) is None
    assert backoff.died(1, wall_s=100.0) == 0.05


@pytest.mark.parametrize(
    ("restart", "code", "restarted"),
    [
        (Restart.ALWAYS, 0, True),
        (Restart.ALWAYS, -9, True),
        (Restart.ON_FAILURE, 0, False),
        (Restart.ON_FAILURE, 1, True),
        (Restart.NEVER, 1, False),
    ],
)
def test_policies(restart: Restart, code: int, restarted: bool) -> None:
    assert (Backoff(restart).died(code, wall_s=0.0) is not None) is restarted


def test_exits_are_told_in_words() -> None:
    assert describe_exit(3) == "exit 3"
    assert describe_exit(-11) == "killed by SIGSEGV"
    assert describe_exit(-99) == "killed by signal 99"


def test_parking_is_over_when_the_arm_holds_again() -> None:
    parking = Parking(asked_at_s=0.0, patience_s=10.0)
    parking.see(ExecutiveState(stage="hold"), 0.01)  # said before it had heard of parking
    assert not parking.over(0.02)
    parking.see(ExecutiveState(stage="park"), 0.03)
    parking.see(ExecutiveState(stage="hold"), 3.0)
    assert parking.over(3.0)


def test_an_arm_that_is_parked_already_need_not_be_seen_moving() -> None:
    parking = Parking(asked_at_s=0.0, patience_s=10.0)
    parking.see(ExecutiveState(stage="hold"), 1.5)
    assert parking.over(1.5)


def test_parking_has_its_time() -> None:
    parking = Parking(asked_at_s=0.0, patience_s=10.0)
    parking.see(ExecutiveState(stage="park"), 1.0)
    assert not parking.over(9.9)
    assert parking.over(10.1)


def test_a_simulated_robot_has_a_world_and_a_real_one_has_none() -> None:
    robot = load_robot("elbow")
    names = [spec.process for spec in processes_of(robot)]
    assert names[:2] == ["world", "driver-arm"]
    assert {"estimator", "executive", "retrainer", "recorder", "web"} <= set(names)
    chain = msgspec.structs.replace(robot.chain[0], link="serial:///dev/ttyUSB0")
    real = msgspec.structs.replace(robot, chain=(chain,))
    assert "world" not in [spec.process for spec in processes_of(real)]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv(ENDPOINT_VARIABLE, raising=False)
    return tmp_path


def hub(robot: str) -> Hub:
    return Hub(robot=robot, pid=1, endpoint=f"tcp/127.0.0.1:{len(robot)}")


def test_registry_knows_who_lives(home: Path) -> None:
    with pytest.raises(HubError, match="myograft up"):
        find_hub()
    claim = Claim(hub("elbow"))
    assert find_hub() == hub("elbow")
    assert find_hub("elbow") == hub("elbow")
    with pytest.raises(HubError, match="Running: elbow"):
        find_hub("left")
    with pytest.raises(HubError, match="--name"):
        Claim(hub("elbow"))
    other = Claim(hub("left"))
    with pytest.raises(HubError, match="--robot"):
        find_hub()
    claim.release()
    assert living_hubs() == [hub("left")]
    other.release()
    assert living_hubs() == []


def test_a_dead_hubs_file_counts_for_nothing(home: Path) -> None:
    folder = home / "myograft" / "hubs"
    folder.mkdir(parents=True)
    (folder / "elbow.json").write_bytes(msgspec.json.encode(hub("elbow")))
    (folder / "left.json").write_bytes(b"{half a fi")
    assert living_hubs() == []
    Claim(hub("elbow")).release()


def test_the_environment_names_a_hub_elsewhere(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ENDPOINT_VARIABLE, "tcp/10.0.0.7:7447")
    assert find_hub("elbow").endpoint == "tcp/10.0.0.7:7447"
    with pytest.raises(HubError, match="--robot"):
        find_hub()


def test_store_keeps_blobs_whole(tmp_path: Path) -> None:
    store = FileStore(tmp_path / "state")
    assert store.load("a") is None
    assert store.names() == []
    store.save("b", b"1")
    store.save("a", b"2")
    store.save("b", b"3")
    assert store.load("b") == b"3"
    assert store.names() == ["a", "b"]
    for name in ("", "../a", "a/b", ".hidden"):
        with pytest.raises(ValueError, match="no name"):
            store.save(name, b"")


def test_mailbox_keeps_the_newest_or_all_in_order() -> None:
    box: Mailbox[str] = Mailbox()
    box.post("state", "old", depth=1)
    box.post("event", "first")
    box.post("state", "new", depth=1)
    box.post("event", "second")
    assert box.wait(0) == ["first", "new", "second"]
    assert box.wait(0) == []


def test_mailbox_is_bounded_and_counts_what_it_lost() -> None:
    box: Mailbox[int] = Mailbox()
    for i in range(5):
        box.post("q", i, depth=3)
    assert box.wait(0) == [2, 3, 4]
    assert box.overflown == 2


def test_mailbox_wakes_its_reader() -> None:
    box: Mailbox[int] = Mailbox()
    poster = threading.Thread(target=box.post, args=("q", 1))
    poster.start()
    assert box.wait(10.0) == [1]
    poster.join()


def test_mailbox_lets_its_reader_sleep_over_what_can_wait() -> None:
    box: Mailbox[int] = Mailbox()
    box.post("clock", 1, depth=1, wake=False)
    assert box.wait(0.0) == [1]  # it is there when somebody looks


def test_mailbox_may_be_woken_before_anybody_waits_and_twice() -> None:
    box: Mailbox[int] = Mailbox()
    box.wake()
    box.wake()
    box.post("q", 1)
    assert box.wait(10.0) == [1]
    assert box.wait(0.0) == []


def test_mailbox_lets_go_of_a_reader_that_was_held_up_past_its_time() -> None:
    box: Mailbox[str] = Mailbox()
    reader = threading.get_ident()
    before = signal.signal(signal.SIGUSR1, lambda *_: time.sleep(0.15))  # past the reader's time
    hold_up = threading.Timer(0.02, signal.pthread_kill, (reader, signal.SIGUSR1))
    rescue = threading.Timer(10.0, box.post, ("q", "woken by the rescue"))
    hold_up.start()
    rescue.start()
    try:
        assert box.wait(0.1) == []
    finally:
        rescue.cancel()
        hold_up.join()
        signal.signal(signal.SIGUSR1, before)
