"""Sweeps in real processes: killed, stopped, and on a cluster."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from experiments.store import Store
from experiments.sweep import run_units
from tests.sweep_work import UNITS, die, squares


def wait_until(true: Callable[[], object], within_s: float = 60.0) -> None:
    deadline = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < deadline, "it did not come to pass"
        time.sleep(0.02)


def workers(folder: Path) -> list[int]:
    """Processes of which each hangs in a unit."""
    return [int(path.name.partition("-")[2]) for path in folder.glob("worker-*")]


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_sweep_that_is_ended_leaves_nobody_and_goes_on(
    tmp_path: Path, how: signal.Signals
) -> None:
    sweep = subprocess.Popen(
        [sys.executable, "-m", "tests.sweep_work", str(tmp_path)],
        env={**os.environ, "MYOGRAFT_TEST_FOLDER": str(tmp_path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        wait_until(lambda: len(workers(tmp_path)) == 2 and (tmp_path / "kept-2").exists())
        if how is signal.SIGINT:
            os.killpg(sweep.pid, how)  # as a terminal does
        else:
            sweep.kill()
        out, err = sweep.communicate(timeout=60.0)
        wait_until(lambda: not any(map(psutil.pid_exists, workers(tmp_path))))
    finally:
        sweep.kill()
    if how is signal.SIGINT:
        assert sweep.returncode == 130 and "Traceback" not in err
        assert out.startswith("stopped: 2 of 6 pieces are kept in ")
    asked: list[int] = []
    with Store(tmp_path, {"made": "up"}) as store:
        assert [store.is_done(unit.key) for unit in UNITS] == [True] * 2 + [False] * 4
        outcome = run_units(
            UNITS, squares, store, jobs=1, narrate=lambda title, step, steps: asked.append(step)
        )
    assert asked == [2, 3, 4, 5, 6] and not outcome.failed
    assert [run["figures"]["square"] for run in outcome.runs] == [0, 1, 4, 9, 16, 25]


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # Dask's own
def test_the_workers_of_a_dask_cluster_find_the_same(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
        Store(tmp_path, {"made": "up"}) as store,
    ):
        address = cluster.scheduler_address
        killed = run_units(UNITS[:1], die, store, backend="dask", address=address)
        outcome = run_units(UNITS, squares, store, backend="dask", address=address)
    assert killed.failed == {UNITS[0].key: "its worker died, again and again"}
    assert not outcome.failed
    assert [run["figures"]["square"] for run in outcome.runs] == [0, 1, 4, 9, 16, 25]
    assert {run["figures"]["threads"] for run in outcome.runs} == {1.0}
