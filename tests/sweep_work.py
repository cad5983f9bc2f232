"""Units of work for the tests of sweeps: other processes import them from here."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

from experiments.statistics import Run
from experiments.store import Store
from experiments.sweep import Stopped, Unit, run_units

UNITS = [Unit("made_up", "plain", seed, 3) for seed in range(6)]


def row(unit: Unit, **figures: float) -> Run:
    return Run(
        method="(i)",
        control="exact",
        n_new=unit.n_new,
        seed=unit.seed,
        variant=unit.variant,
        figures=figures,
    )


def squares(unit: Unit) -> list[Run]:
    return [row(unit, square=unit.seed**2, threads=float(os.environ.get("OMP_NUM_THREADS", "0")))]


def odd_ones_fail(unit: Unit) -> list[Run]:
    if unit.seed % 2:
        raise ValueError(f"seed {unit.seed}\nis odd")
    return squares(unit)


def die(unit: Unit) -> list[Run]:
    os._exit(7)


def third_hangs(unit: Unit) -> list[Run]:
    """Seeds from 2 on say where they run, and never end."""
    if unit.seed >= 2:
        Path(os.environ["MYOGRAFT_TEST_FOLDER"], f"worker-{os.getpid()}").touch()
        while True:
            time.sleep(0.05)
    return squares(unit)


def kept(done: int) -> None:
    """Say how many are on disk."""
    Path(os.environ["MYOGRAFT_TEST_FOLDER"], f"kept-{done}").touch()


def main(folder: Path) -> int:
    """A sweep that does not end by itself."""
    try:
        with Store(folder, {"made": "up"}) as store:
            run_units(UNITS, third_hangs, store, jobs=2, narrate=lambda _, done, __: kept(done))
    except Stopped as stop:
        print(stop)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
