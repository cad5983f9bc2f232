"""Run the pieces of an experiment on all cores or on a cluster, and keep each one as it is done.

What is done stands in `units.jsonl` of the results folder: one line that says which settings it
is about, then one line for each finished piece, on disk before the next is taken. A sweep that is
killed at any moment goes on where it was. What failed is tried again at the next start.

Backends: `loky`, by joblib, starts processes here; `dask` sends the pieces to the workers of a
running scheduler (`dask worker URL --nthreads 1` on each host), which need this package too.
"""

from __future__ import annotations

import contextlib
import functools
import json
import os
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Generator, Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

from experiments.progress import Narrate
from experiments.statistics import Run
from experiments.store import Store, SweepError

BACKENDS = ("loky", "dask")


@dataclass(frozen=True)
class Unit:
    """The smallest piece that is run and kept. Its work must depend on nothing else."""

    experiment: str
    variant: str
    seed: int
    n_new: int  # 0: a piece that needs no new motions, such as a baseline

    @property
    def key(self) -> str:
        """What it is known by in the store."""
        return f"{self.experiment}/{self.variant}/n{self.n_new}/seed{self.seed}"


Work = Callable[[Unit], list[Run]]  # of a module's top level, so that other processes find it


class Outcome(NamedTuple):
    """What is known of the units that were asked for."""

    runs: list[Run]
    failed: dict[str, str]  # unit's key -> its error in one line
    worked_s: float  # wall time of all, one after another

    def __str__(self) -> str:
        """The failures, a line each; empty if there are none."""
        lines = [f"failed: {key}: {error}" for key, error in self.failed.items()]
        if lines:
            lines.append(f"{len(lines)} failed; the same command tries them again")
        return "\n".join(lines)


class Stopped(KeyboardInterrupt):
    """Ctrl-C; says what is kept and how to go on."""


def run_units(
    units: Sequence[Unit],
    work: Work,
    store: Store,
    *,
    jobs: int = 2,
    backend: str = "loky",
    address: str = "",
    narrate: Narrate = lambda title, step, steps: None,
) -> Outcome:
    """Run the units that are not kept yet; those that fail do not stop the others.

    Processes that loky starts, and Dask's by default, compute in one thread each. With one job the
    work is done in this process. On a cluster as many are run as it has room for.

    Raises:
        SweepError: a worker process died here, or the cluster cannot be reached.
        Stopped: Ctrl-C.
    """
    wanted = {unit.key: unit for unit in units}
    missing = [unit for key, unit in wanted.items() if not store.is_done(key)]
    title = units[0].experiment if units else ""
    done = len(wanted) - len(missing)
    narrate(title, done, len(wanted))
    try:
        with contextlib.closing(_lines(missing, work, jobs, backend, address)) as lines:
            for line in lines:
                store.append(line)
                done += 1
                narrate(title, done, len(wanted))
    except KeyboardInterrupt:
        kept = sum(store.is_done(key) for key in wanted)
        raise Stopped(
            f"stopped: {kept} of {len(wanted)} pieces are kept in {store.path}; "
            f"the same command goes on from there"
        ) from None
    except SweepError as error:
        raise SweepError(f"{error}; {done} of {len(wanted)} pieces are kept") from error
    return Outcome(store.runs(wanted), store.failed(wanted), store.worked_s(wanted))


def _lines(
    units: Sequence[Unit], work: Work, jobs: int, backend: str, address: str
) -> Generator[str, None, None]:
    """What to keep of each unit, in the order in which they are done."""
    if not units:
        return
    if jobs == 1 and backend == "loky":
        yield from (_attempt(work, unit) for unit in units)
        return
    on = _on_dask(units, work, address) if backend == "dask" else _on_loky(units, work, jobs)
    with contextlib.closing(on):  # ends the workers, or takes back what waits for them
        yield from on


def _on_loky(units: Sequence[Unit], work: Work, jobs: int) -> Generator[str, None, None]:
    from joblib import Parallel, delayed, parallel_config
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    # loky replaces a worker that has grown, as each does with its first run
    warnings.filterwarnings("ignore", message="A worker stopped while some jobs")
    with parallel_config("loky", inner_max_num_threads=1):
        parallel = Parallel(
            n_jobs=jobs, return_as="generator_unordered", batch_size=1, pre_dispatch="n_jobs"
        )
        pieces = (delayed(_attempt)(work, unit, os.getpid()) for unit in units)
        try:  # the call itself hands out the first of them, and may meet a dead worker already
            with contextlib.closing(parallel(pieces)) as lines:
                yield from lines
        except TerminatedWorkerError as error:
            raise SweepError("a worker process died; was there too little memory?") from error


def _on_dask(units: Sequence[Unit], work: Work, address: str) -> Generator[str, None, None]:
    """Straight to the scheduler: joblib's backend for it waits forever when a worker dies."""
    try:
        from distributed import Client, as_completed
        from distributed.client import FutureCancelledError
        from distributed.scheduler import KilledWorker
    except ModuleNotFoundError as error:
        raise SweepError("--backend dask needs the package `distributed`") from error
    try:
        client = Client(address, timeout=10.0)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        text = f"no Dask scheduler answers at {address!r}; `dask scheduler` starts one"
        raise SweepError(text) from error
    with client:
        futures = {client.submit(_attempt, work, unit, pure=False): unit for unit in units}
        for future in as_completed(futures):  # type: ignore[no-untyped-call]
            try:
                yield future.result()
            except KilledWorker:
                yield _failure(futures[future], "its worker died, again and again")
            except FutureCancelledError as error:
                raise SweepError(f"lost the Dask scheduler at {address!r}") from error


@functools.cache
def _end_with(parent: int) -> None:
    """Let this worker not outlive the sweep: else it would go on computing for nobody."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _attempt(work: Work, unit: Unit, parent: int = 0) -> str:
    """Do the work; the line to keep, of a failure too. Runs in the worker."""
    if parent:
        _end_with(parent)
    start = time.perf_counter()
    try:
        runs = [_checked(run) for run in work(unit)]
        wall_s = time.perf_counter() - start
        line = {"key": unit.key, "unit": asdict(unit), "wall_s": wall_s, "runs": runs}
        return json.dumps(line)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(f"{type(error).__name__}: {error}".split())
        place = f"{where.filename.rpartition('/')[2]}:{where.lineno}"
        return _failure(unit, f"{text} ({place})")


def _failure(unit: Unit, error: str) -> str:
    return json.dumps({"key": unit.key, "unit": asdict(unit), "error": error})


def _checked(run: Run) -> Run:
    figures = {name: float(value) for name, value in run["figures"].items()}
    for name, value in figures.items():
        if not abs(value) < float("inf"):
            raise ValueError(f"{run['method']}: {name} is {value}; leave out what has no value")
    return {**run, "figures": figures}
