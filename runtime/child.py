"""One supervised process: started in a session of its own, its death noticed at once."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from runtime.backoff import Backoff, BackoffPolicy, Restart
from runtime.manifest import Spec, declared
from runtime.messages import ProcessRow
from runtime.priority import step_back

# One thread each: on few cores, spinning BLAS threads take the time that control needs.
_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "PYTHONFAULTHANDLER": "1",
    "PYTHONUNBUFFERED": "1",
    "MUJOCO_GL": "disable",  # nobody draws by it: else it looks for a window system, 0.05 s each
    # Rerun would warn in each run that its file has no footer: dashboard/sinks.py wants none.
    "RUST_LOG": "warn,re_log_encoding::rrd::file_sink=error",
}
_UNHURRIED = {
    # Zenoh reads the network with two threads that wake each other: one does.
    "ZENOH_RUNTIME": "(rx: (worker_threads: 1))",
    # Rerun's allocator gives memory back at once: else the picture's creeps up for half an hour.
    "MIMALLOC_PURGE_DELAY": "0",
}


class Child:
    """Start, watch and restart one process.

    Args:
        spec: what to start.
        arguments: of `python -m runtime.process`, after the process's name.
        log_file: where its output is appended.
        on_exit: called from a thread of its own, with the exit code, the moment it is dead.
    """

    def __init__(
        self,
        spec: Spec,
        arguments: list[str],
        log_file: Path,
        on_exit: Callable[[Child, int], None],
        policy: BackoffPolicy | None = None,
    ) -> None:
        self.spec = spec
        self.state = "stopped"
        self.restarts = 0
        self.last_exit = ""
        self.restart_at_s: float | None = None  # wall time
        self.log_file = log_file
        self._arguments = arguments
        self._on_exit = on_exit
        self._backoff = Backoff(spec.restart, policy)
        self._process: subprocess.Popen[bytes] | None = None
        self._waiter = threading.Thread()

    @property
    def row(self) -> ProcessRow:
        """What the group's table says of it."""
        running = self.state in ("starting", "ready") and self._process is not None
        return ProcessRow(
            process=self.spec.process,
            state=self.state,
            pid=self._process.pid if running and self._process else 0,
            restarts=self.restarts,
            last_exit=self.last_exit,
        )

    def start(self) -> None:
        """Start it now."""
        self.restart_at_s = None
        self.state = "starting"
        self._process = spawn(self.spec, self._arguments, self.log_file)
        self._waiter = threading.Thread(target=self._wait, args=(self._process,), daemon=True)
        self._waiter.start()
        if self.restarts or not self.spec.awaited:
            self._step_back()

    def became_ready(self) -> None:
        """Take note of its liveliness token; from now on at the latest it has its priority."""
        self.state = "ready"
        self._step_back()

    def _step_back(self) -> None:
        if self.spec.nice and self._process is not None:
            step_back(self._process.pid, self.spec.nice)

    def died(self, exit_code: int, *, ending: bool) -> None:
        """Take note of its death; unless the group is ending, plan its restart."""
        self.last_exit = describe_exit(exit_code)
        if ending:
            self.state = "stopped"
            return
        now_s = time.monotonic()
        delay_s = self._backoff.died(exit_code, now_s)
        if delay_s is None:
            meant = exit_code == 0 and self.spec.restart is not Restart.ALWAYS
            self.state = "stopped" if meant else "failed"
            return
        self.state = "backoff"
        self.restart_at_s = now_s + delay_s

    def restart_if_due(self) -> bool:
        """Start it again if its time has come."""
        if self.restart_at_s is None or time.monotonic() < self.restart_at_s:
            return False
        self.restarts += 1
        self.start()
        return True

    def terminate(self, patience_s: float) -> None:
        """SIGTERM, and SIGKILL for one that does not go; `on_exit` has been called after this."""
        self.restart_at_s = None
        if self._process is None:
            return
        self._signal(signal.SIGTERM)
        try:
            self._process.wait(patience_s)
        except subprocess.TimeoutExpired:
            self._signal(signal.SIGKILL)
            self._process.wait()
        self._waiter.join()

    def _signal(self, number: signal.Signals) -> None:
        assert self._process is not None
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(number)

    def _wait(self, process: subprocess.Popen[bytes]) -> None:
        self._on_exit(self, process.wait())


def spawn(spec: Spec, arguments: list[str], log_file: Path) -> subprocess.Popen[bytes]:
    """Start a process once; what it writes is appended to `log_file`."""
    entry = ["--entry", spec.entry or declared(spec.process)]
    unhurried = _UNHURRIED if spec.nice else {}
    with log_file.open("ab") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "runtime.process", spec.process, *entry, *arguments],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,  # Ctrl-C is for the supervisor, who parks the arm first
            env={**_ENVIRONMENT, **unhurried, **os.environ},
        )
    return process


def describe_exit(code: int) -> str:
    """`exit 1`, `killed by SIGKILL`."""
    if code >= 0:
        return f"exit {code}"
    with contextlib.suppress(ValueError):
        return f"killed by {signal.Signals(-code).name}"
    return f"killed by signal {-code}"
