"""A whole robot in processes of its own, and someone who watches it from the bus."""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self, TypeVar

import pytest

from runtime import messages as m
from runtime.bus import Bus
from runtime.messages import Message, Reply
from runtime.settings import RobotSettings, load_robot
from runtime.supervisor import Group

WATCHED = (
    m.ChainBody,
    m.ChainState,
    m.Clock,
    m.Event,
    m.ExecutiveState,
    m.GroupState,
    m.Health,
    m.JointEstimate,
    m.Presence,
    m.SchemaVersion,
    m.TrainingProgress,
    m.WorldTruth,
)
PATIENCE_S = 60.0  # of wall time, for what only a broken robot does not do
START_S = 0.2  # usual wall time in which a Python of ours starts: see `within`

M = TypeVar("M", bound=Message)


class Heard(NamedTuple):
    """A message and the wall time at which it was here."""

    at_s: float
    message: Message


class Watch:
    """Hears everything that one robot says and keeps it with the time at which it came."""

    def __init__(self, bus: Bus) -> None:
        self.heard: list[Heard] = []
        self._bus = bus
        self._news = threading.Condition()
        self._over = False
        self._thread = threading.Thread(target=self._listen, daemon=True)

    def __enter__(self) -> Self:
        self._bus.subscribe(*WATCHED, every=True)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over = True
        self._bus.wake()
        self._thread.join()

    def _listen(self) -> None:
        while not self._over:
            items = self._bus.wait(0.5)
            now_s = time.monotonic()
            with self._news:
                self.heard += [Heard(now_s, item) for item in items if isinstance(item, Message)]
                self._news.notify_all()

    def mark(self) -> int:
        """This moment, as a place in all that is heard."""
        with self._news:
            return len(self.heard)

    def wait_for(
        self,
        kind: type[M],
        wanted: Callable[[M], bool] = lambda message: True,
        *,
        since: int,
        timeout_s: float = PATIENCE_S,
        what: str = "",
    ) -> tuple[float, M]:
        """The first message of a type, from `since` on, that is wanted, and when it came."""
        deadline = time.monotonic() + timeout_s
        at = since
        with self._news:
            while True:
                for heard in self.heard[at:]:
                    if isinstance(heard.message, kind) and wanted(heard.message):
                        return heard.at_s, heard.message
                at = len(self.heard)
                left = deadline - time.monotonic()
                if left <= 0.0:
                    said = "\n".join(e.text for e in self.events(since)[-8:])
                    last = (self.of(kind, since) or ["none"])[-1]
                    raise AssertionError(
                        f"{what or kind.__name__} never came; but:\n{said}\nthe last: {last}"
                    )
                self._news.wait(left)

    def wait_event(self, kind: str, *, since: int, timeout_s: float = PATIENCE_S) -> m.Event:
        """The first event of a kind from `since` on; ends early when growth fails instead."""
        failures = ("grow_failed", "shrink_failed", "refit_refused", "growth_given_up")

        def over(event: m.Event) -> bool:
            return event.kind == kind or event.kind in failures

        _, event = self.wait_for(m.Event, over, since=since, timeout_s=timeout_s, what=kind)
        assert event.kind == kind, event.text
        return event

    def of(self, kind: type[M], since: int = 0) -> list[M]:
        """All messages of a type from `since` on."""
        return [h.message for h in self.heard[since:] if isinstance(h.message, kind)]

    def events(self, since: int = 0) -> list[m.Event]:
        """All events from `since` on."""
        return self.of(m.Event, since)

    def last(self, kind: type[M], wanted: Callable[[M], bool] = lambda message: True) -> M:
        """The newest message of a type that is wanted."""
        for heard in reversed(self.heard):
            if isinstance(heard.message, kind) and wanted(heard.message):
                return heard.message
        raise AssertionError(f"no {kind.__name__} was ever heard")


class Robot:
    """A running group and its watch."""

    def __init__(self, group: Group, watch: Watch, state_dir: Path) -> None:
        self.group = group
        self.watch = watch
        self.state_dir = state_dir

    def ask(self, request: Message) -> Reply:
        """Put a request; the reply of the one who serves it, which must be yes."""
        replies = self.group.request(request)
        assert replies, f"nobody answered {request}"
        assert replies[0].ok, replies[0].text
        return replies[0]

    def pid(self, process: str) -> int:
        return next(row.pid for row in self.group.rows if row.process == process)

    def kill(self, process: str) -> float:
        """kill -9; gives the wall time of it."""
        pid = self.pid(process)
        assert pid
        killed_at = time.monotonic()
        os.kill(pid, signal.SIGKILL)
        return killed_at

    def hold(self, stage: str = "hold", timeout_s: float = PATIENCE_S) -> None:
        """Wait until the arm has come to rest somewhere."""
        self.watch.wait_for(
            m.ExecutiveState,
            lambda state: state.stage == stage and state.settled,
            since=self.watch.mark(),
            timeout_s=timeout_s,
            what=f"the arm in stage {stage}",
        )


@contextmanager
def running(
    settings: RobotSettings, folder: Path, *, speed: float = 1.0, state_dir: Path | None = None
) -> Iterator[Robot]:
    """A new robot, ready and holding."""
    state_dir = state_dir or folder / "state"
    group = Group(settings, speed=speed, run_dir=folder / "run", state_dir=state_dir)
    try:
        group.start()
        with (
            Bus(settings.name, "test", endpoint=group.endpoint) as bus,
            Watch(bus) as watch,
        ):
            robot = Robot(group, watch, state_dir)
            assert group.wait_ready(2 * PATIENCE_S), group.rows
            robot.hold()
            yield robot
    finally:
        group.stop(park=False)


class Command:
    """`myograft WORDS` in a process of its own, and what it prints."""

    def __init__(self, *words: str) -> None:
        self.lines: list[str] = []
        self.process = subprocess.Popen(
            [sys.executable, "-m", "runtime.cli.main", *words],
            stdout=subprocess.PIPE,
            text=True,
        )
        self._news = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            with self._news:
                self.lines.append(line)
                self._news.notify_all()

    def wait_line(self, words: str, count: int = 1) -> None:
        with self._news:
            said = self._news.wait_for(
                lambda: sum(words in line for line in self.lines) >= count, 2 * PATIENCE_S
            )
        assert said, f"'{words}' was never said, but:\n{''.join(self.lines)}"

    def end(self) -> int:
        """Ctrl-C; gives the exit code."""
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
        return self.over()

    def over(self) -> int:
        """It ends by itself; gives the exit code. One that does not is killed."""
        try:
            code = self.process.wait(2 * PATIENCE_S)
        finally:
            self.process.kill()
        self._reader.join(PATIENCE_S)
        assert self.process.stdout is not None
        self.process.stdout.close()
        return code


def elbow(folder: Path, name: str, steps: int = 16) -> RobotSettings:
    """The elbow's file with so many steps in its sweep, under another name."""
    shipped = load_robot("elbow")
    once = itertools.cycle(shipped.task[0].targets_deg)
    targets = [list(row) for row in itertools.islice(once, steps)]
    head, _, _ = Path(shipped.file).read_text().partition("[[task]]")
    text = head.replace('"../', f'"{Path(shipped.file).parent}/../')
    text = text.replace('name = "elbow"', f'name = "{name}"', 1)
    text += f'[[task]]\nname = "sweep"\ntargets_deg = {targets}\n'
    file = folder / f"{name}.toml"
    file.write_text(text)
    return load_robot(str(file))


def waited_s(pid: int) -> float:
    """How long a process has stood ready while others had the processor: its most patient thread.

    Bounds in wall time are about what a robot does, not about how busy a machine is that others
    use, too: this is taken off. Where the kernel does not tell, nothing is.
    """
    longest_ns = 0
    for thread in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with contextlib.suppress(OSError):  # it has just ended
            longest_ns = max(longest_ns, int(thread.read_text().split()[1]))
    return longest_ns * 1e-9


def within(took_s: float, limit_s: float) -> bool:
    """Whether it took no longer than that, on a host as fast as usual.

    Where it did, the limit is stretched by what a Python of ours now takes longer to start.
    """
    if took_s < limit_s:
        return True
    began_s = time.monotonic()
    subprocess.run(
        [sys.executable, "-c", "import runtime.process"], check=True, start_new_session=True
    )
    slowness = (time.monotonic() - began_s) / START_S
    print(f"this host is {slowness:.1f} times slower than usual")
    return took_s < limit_s * slowness


@pytest.fixture(scope="module", autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A state folder, and so a registry of hubs, of this module's own."""
    folder = tmp_path_factory.mktemp("home")
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(0.0005)  # as the robot's own processes do: the supervisor is in this one
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder))
        yield folder
    sys.setswitchinterval(interval_s)
