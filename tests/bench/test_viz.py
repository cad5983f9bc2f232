"""Budgets of the picture, at 74 muscles: its processor time, how late it is, what it costs others.

Lag is from a sample's publication to its row in the recording: Rerun's row ids carry the wall time
at which they were made.
"""

from __future__ import annotations

import os
import signal
import time
import warnings
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import psutil
import pytest

from dashboard.stream import Stream
from dashboard.viewer import viewer_binary
from dashboard.viz import canvas_of
from runtime.bus import Bus
from runtime.hubs import free_port
from runtime.messages import ChainState
from tests.bench.timing import tell, tell_p99
from tests.many_muscles import STEP_NS, many_muscles, say
from tests.viz_process import START_NS, Robot, Viz, hub, wait_until

pytest.importorskip("rerun", reason="needs the extra myograft[view]")

WARM_S, MEASURE_S = 4.0, 15.0
CPU_PERCENT, LAG_P99_MS = 10.0, 300.0
GROWTH_MB_MIN = 1.0  # of memory, once the server's share of it is full
FULL_MIN = 8.0  # by when it is
ROUNDS, ROUND_S = 5, 3.0  # of each: short ones in turn, as the machine's noise comes in minutes


def cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def lags_ms(recording: Path, said_ns: dict[int, int]) -> list[float]:
    """How long each sample took from being said to its row of the recording."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no footer: it is meant to be readable after kill -9
        reader = RrdReader(str(recording))
    lags = []
    for chunk in reader.stream():
        if chunk.entity_path == "/muscle" and not chunk.is_static:
            batch = chunk.to_record_batch()
            stamps_ns = batch.column("robot time").cast("int64").to_pylist()
            row_ids = batch.column(0).to_pylist()
            for stamp_ns, row_id in zip(stamps_ns, row_ids, strict=True):
                wall_ns = int.from_bytes(row_id[:8], "big")
                lags.append((wall_ns - said_ns[round(stamp_ns / STEP_NS) * STEP_NS]) / 1e6)
    return lags


def test_drawing_alone(tmp_path: Path) -> None:
    """Curves, charts, lanes, and the body at 15 Hz, into file and server; without the bus."""
    settings = many_muscles(tmp_path)
    body, canvas = canvas_of(settings, "run", tmp_path / "many.rrd", free_port())
    stream = Stream(settings, canvas, body)
    times = range(START_NS, START_NS + round(20e9), STEP_NS)
    said = [[x for x in say(settings, t) if type(x) in stream.inputs] for t in times]
    begin_s = time.process_time()
    for now_ns, messages in zip(times, said, strict=True):
        for message in messages:
            stream.receive(message, now_ns)
        list(stream.tick(now_ns))
    spent_s = time.process_time() - begin_s
    canvas.close()
    print()
    tell("drawing 74 muscles at 100 Hz", 100.0 * spent_s / 20.0, CPU_PERCENT, "% of a core")
    tell("recording", (tmp_path / "many.rrd").stat().st_size / 20e6 * 60.0, 30.0, "MB a minute")


def test_process_over_the_bus(tmp_path: Path) -> None:
    settings = many_muscles(tmp_path)
    with (
        hub(settings.name) as (bus, endpoint),
        Viz(settings, bus, endpoint, tmp_path) as viz,
        Robot(settings, bus) as robot,
    ):
        process = psutil.Process(viz.process.pid)
        time.sleep(WARM_S)
        begin_s, before_s = time.monotonic(), cpu_s(process)
        time.sleep(MEASURE_S)
        percent = 100.0 * (cpu_s(process) - before_s) / (time.monotonic() - begin_s)
        assert viz.end() == 0
    print()
    tell("the whole process, with the bus", percent, CPU_PERCENT, "% of a core")
    lags = np.array(lags_ms(viz.run_dir / "many.rrd", robot.said_ns))
    assert len(lags) > 0.9 * 100.0 * MEASURE_S
    tell("lag from sample to log, p50", float(np.percentile(lags, 50)), LAG_P99_MS / 2, "ms")
    tell("lag from sample to log, p99", float(np.percentile(lags, 99)), LAG_P99_MS, "ms")


# ── what a viewer costs ─────────────────────────────────────────────────────────────────────────


@contextmanager
def viewer_of(url: str) -> Iterator[psutil.Process]:
    """A viewer without a screen that looks at the live picture."""
    from rerun.experimental import ViewerClient

    before = {child.pid for child in psutil.Process().children(recursive=True)}
    with ViewerClient.spawn(
        headless=True, port=free_port(), executable_path=viewer_binary(), memory_limit="1GB"
    ) as viewer:
        viewer.open(url)
        wait_until(lambda: bool(viewer.get_state().recordings), "the viewer's first data")
        children = psutil.Process().children(recursive=True)
        (process,) = [x for x in children if x.pid not in before and x.name() == "rerun"]
        try:
            yield process
        finally:
            if process.is_running():
                process.send_signal(signal.SIGCONT)
                process.kill()


class Ear:
    """Hears chain states as a service does: how old each is when it is there."""

    def __init__(self, robot: str, endpoint: str) -> None:
        self.ages_ms: list[float] = []
        self._robot, self._endpoint = robot, endpoint

    def listen(self, said_ns: dict[int, int], seconds: float) -> None:
        with Bus(self._robot, "ear", endpoint=self._endpoint) as bus:
            bus.subscribe(ChainState, chain="neck")
            end_s = time.monotonic() + seconds
            while time.monotonic() < end_s:
                for state in bus.wait(0.1):
                    assert isinstance(state, ChainState)
                    self.ages_ms.append((time.time_ns() - said_ns[state.stamp_ns]) / 1e6)


@pytest.mark.timeout(300)
def test_no_viewer_costs_the_robot_anything(tmp_path: Path) -> None:
    """Age of chain states at another process, and the robot's longest publication."""
    settings = many_muscles(tmp_path)
    ages_ms: dict[str, list[list[float]]] = {}

    def measure(what: str, robot: Robot, endpoint: str) -> None:
        ear = Ear(settings.name, endpoint)
        robot.longest_s = 0.0
        ear.listen(robot.said_ns, ROUND_S)
        ages_ms.setdefault(what, []).append(ear.ages_ms)
        assert robot.longest_s < 0.5, "the robot waited"

    with hub(settings.name) as (bus, endpoint), Robot(settings, bus) as robot:
        for _ in range(ROUNDS):
            measure("no picture", robot, endpoint)
            with Viz(settings, bus, endpoint, tmp_path) as viz:
                measure("nobody looks", robot, endpoint)
                with viewer_of(viz.url) as viewer:
                    viewer.suspend()
                    measure("the viewer stands still", robot, endpoint)
                    viewer.kill()
                    measure("the viewer was killed", robot, endpoint)
                os.kill(viz.process.pid, signal.SIGSTOP)
                measure("viz stands still", robot, endpoint)
                os.kill(viz.process.pid, signal.SIGKILL)
                measure("viz was killed", robot, endpoint)
    print("\nchain state's age")
    for what, rounds in ages_ms.items():
        tell_p99(what, ages_ms["no picture"], rounds)


def test_no_call_waits_for_a_viewer_that_stands_still(tmp_path: Path) -> None:
    settings = many_muscles(tmp_path)
    port = free_port()
    body, canvas = canvas_of(settings, "run", tmp_path / "many.rrd", port)
    stream = Stream(settings, canvas, body)
    longest_s: dict[str, float] = {}

    def draw(what: str, seconds: float) -> None:
        nonlocal now_ns
        worst, end_ns = 0.0, now_ns + round(seconds * 1e9)
        due_s = time.monotonic()
        while now_ns < end_ns:
            for message in say(settings, now_ns):
                if type(message) in stream.inputs:
                    stream.receive(message, now_ns)
            begin_s = time.perf_counter()
            list(stream.tick(now_ns))
            worst = max(worst, time.perf_counter() - begin_s)
            now_ns += STEP_NS
            due_s += STEP_NS * 1e-9
            time.sleep(max(0.0, due_s - time.monotonic()))
        longest_s[what] = worst

    now_ns = START_NS
    draw("while it opens", 1.0)
    draw("nobody looks", 5.0)
    with viewer_of(canvas.url) as viewer:
        viewer.suspend()
        draw("the viewer stands still", 20.0)
        viewer.kill()
        draw("the viewer was killed", 5.0)
    canvas.close()
    print()
    for what, worst_s in longest_s.items():
        print(f"longest drawing, {what:<24} {1e3 * worst_s:7.1f} ms")
    assert longest_s["the viewer stands still"] < 0.3
    assert longest_s["the viewer was killed"] < 0.3


def watched_mb(pid: int, minutes: float) -> list[tuple[float, float]]:
    """Minutes and resident memory, some times a minute."""
    process, begin_s = psutil.Process(pid), time.monotonic()
    rows = []
    while (passed := (time.monotonic() - begin_s) / 60.0) < minutes:
        rows.append((passed, process.memory_info().rss / 1e6))
        time.sleep(min(5.0, 6.0 * minutes))
    return rows


@pytest.mark.timeout(0)
def test_memory_stays(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """With a viewer that stands still, which is the worst; `--minutes 30` is the real thing."""
    minutes: float = request.config.getoption("--minutes")
    settings = many_muscles(tmp_path)
    with ExitStack() as stack:
        bus, endpoint = stack.enter_context(hub(settings.name))
        viz = stack.enter_context(Viz(settings, bus, endpoint, tmp_path))
        stack.enter_context(Robot(settings, bus))
        stack.enter_context(viewer_of(viz.url)).suspend()
        rows = watched_mb(viz.process.pid, minutes)
        assert viz.process.poll() is None
    print()
    for at in (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0):
        if at <= minutes:
            passed, memory_mb = min(rows, key=lambda row: abs(row[0] - at))
            print(f"memory after {passed:4.1f} min {memory_mb:6.0f} MB")
    assert max(memory_mb for _, memory_mb in rows) < 500.0
    late = [row for row in rows if row[0] > FULL_MIN]
    if late and late[-1][0] - late[0][0] > FULL_MIN:
        slope = float(np.polyfit(*np.array(late).T, 1)[0])
        tell("memory's growth after that", slope, GROWTH_MB_MIN, "MB a minute")
