"""The viz process on a bus of its own, and a made-up robot that talks to it at its own pace."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self

from runtime.bus import Bus
from runtime.child import spawn
from runtime.hubs import free_endpoint
from runtime.manifest import chosen, processes_of
from runtime.messages import Message
from runtime.priority import step_back
from runtime.settings import RobotSettings
from tests.many_muscles import STEP_NS, say

START_NS = 1_000_000_000
KEPT = 30_000  # five minutes


class Viz:
    """One viz process, started and ready."""

    def __init__(self, settings: RobotSettings, bus: Bus, endpoint: str, folder: Path) -> None:
        self.run_dir = folder / "run-1"
        self.run_dir.mkdir(exist_ok=True)
        where = ["--run-dir", str(self.run_dir), "--state-dir", str(folder)]
        arguments = ["--robot", settings.file, *where, "--endpoint", endpoint]
        (spec,) = chosen(processes_of(settings), ("viz",))
        self.process = spawn(spec, arguments, folder / "viz.log")
        try:
            self._await(bus)
        except BaseException:
            self.process.kill()
            raise
        step_back(self.process.pid, spec.nice)

    def _await(self, bus: Bus) -> None:
        deadline = time.monotonic() + 60.0
        while "viz" not in bus.alive():
            assert self.process.poll() is None, "viz ended at once: see its log"
            assert time.monotonic() < deadline, "viz does not become ready"

    @property
    def url(self) -> str:
        """Where a viewer finds it."""
        return next(self.run_dir.glob("*.viewer")).read_text()

    def end(self) -> int:
        """Ask it to stop; its exit code."""
        self.process.terminate()
        return self.process.wait(60.0)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


class Robot:
    """Says what 74 muscles would say, a hundred times a second, from a thread of its own.

    Attributes:
        said_ns: stamp -> wall time (UTC) at which it was said, of the last minutes.
        longest_s: how long the longest publication took.
    """

    def __init__(self, settings: RobotSettings, bus: Bus) -> None:
        self.said_ns: dict[int, int] = {}
        self.longest_s = 0.0
        self._settings = settings
        self._bus = bus
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._talk, daemon=True)

    def _talk(self) -> None:
        now_ns, due = START_NS, time.monotonic()
        while not self._over.is_set():
            messages: list[Message] = list(say(self._settings, now_ns))
            self.said_ns[now_ns] = time.time_ns()
            for message in messages:
                begin_s = time.perf_counter()
                self._bus.publish(message)
                self.longest_s = max(self.longest_s, time.perf_counter() - begin_s)
            if len(self.said_ns) > KEPT:
                del self.said_ns[next(iter(self.said_ns))]
            now_ns += STEP_NS
            due = max(due + STEP_NS * 1e-9, time.monotonic() - 0.1)
            time.sleep(max(0.0, due - time.monotonic()))

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._over.set()
        self._thread.join()


@contextmanager
def hub(robot: str) -> Iterator[tuple[Bus, str]]:
    """A bus to be the first on, and its endpoint."""
    endpoint = free_endpoint()
    with Bus(robot, "test", listen=endpoint) as bus:
        yield bus, endpoint


def wait_until(
    done: Callable[[], bool], what: str, limit_s: float = 20.0, pause_s: float = 0.02
) -> None:
    """Wait for a condition."""
    deadline = time.monotonic() + limit_s
    while not done():
        assert time.monotonic() < deadline, f"{what} did not happen within {limit_s:g} s"
        time.sleep(pause_s)
