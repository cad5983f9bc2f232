"""Budget: the rig runs the demo's sequence at ten times real time, relearning counted."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter, process_time

import pytest

from experiments.rig import Rig
from experiments.sequence import Trace, run_sequence
from experiments.session import RigSession
from runtime import messages as m
from runtime.settings import load_robot

BUDGET = 10.0  # x real time on a quiet core
LEAST = 1.0  # a busy machine counts other processes' cache misses and waits, too


@dataclass
class Lap:
    """Wall and processor time since it began."""

    wall_s: float
    cpu_s: float

    @staticmethod
    def start() -> Lap:
        """Begin now."""
        return Lap(perf_counter(), process_time())

    def end(self) -> Lap:
        """What it took."""
        return Lap(perf_counter() - self.wall_s, process_time() - self.cpu_s)


def tell(what: str, robot_s: float, lap: Lap) -> float:
    """Print and give back how fast robot time went, by processor time."""
    speed = robot_s / lap.cpu_s
    print(
        f"{what:<34} {robot_s:6.1f} s of robot time, {speed:5.1f} x real time by processor, "
        f"{robot_s / lap.wall_s:5.1f} x by wall"
    )
    return speed


def test_the_sweep() -> None:
    rig = Rig(load_robot("elbow"))
    rig.run(0.5)
    assert rig.ask(m.Task(name="sweep")).ok
    begin_ns, lap = rig.now_ns, Lap.start()
    rig.run_until(lambda: any(event.kind == "task_done" for event in rig.events), 300.0)
    print()
    speed = tell("the sweep", (rig.now_ns - begin_ns) * 1e-9, lap.end())
    assert speed > LEAST, f"budget {BUDGET:g}"


@pytest.mark.timeout(600)
def test_the_whole_sequence() -> None:
    settings = load_robot("elbow")
    rig = Rig(settings)
    lap = Lap.start()
    run_sequence(RigSession(rig), Trace(settings), lambda *_: None)
    print()
    speed = tell("the demo's sequence", rig.now_ns * 1e-9, lap.end())
    assert speed > LEAST, f"budget {BUDGET:g}"
