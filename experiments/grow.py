"""`python -m experiments grow`: the demo's sequence in the rig, for one or many seeds.

The same script as `myograft demo`, on a virtual clock: two runs with one seed are identical.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from experiments.progress import Narrate, bars
from experiments.rig import Rig
from experiments.sequence import Result, Trace, run_sequence
from experiments.session import RigSession
from runtime.settings import RobotSettings, load_robot


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `grow`."""
    parser.add_argument("robot", nargs="?", default="elbow", help="robot or robot file")
    parser.add_argument("--seeds", type=int, default=1, help="how many, from --seed on")
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--json", type=Path, help="write every run to this file")


def run(args: argparse.Namespace) -> int:
    """Run every seed; one line each."""
    settings = load_robot(args.robot)
    runs: list[dict[str, Any]] = []
    print(
        "seed  E_theta before after [rad]  ratio   sigma_f before after [N]  ratio  peak N  x real"
    )
    with bars() as narrate:
        for seed in range(args.seed, args.seed + args.seeds):
            result, faster = grow(settings, seed, narrate)
            b, a = result.before, result.after
            print(
                f"{seed:4d}  {b.e_theta_rad:14.4f} {a.e_theta_rad:7.4f} "
                f"{a.e_theta_rad / b.e_theta_rad:11.2f}  {b.sigma_f_n:14.2f} {a.sigma_f_n:6.2f} "
                f"{a.sigma_f_n / b.sigma_f_n:9.2f}  {result.peak_tension_n:6.1f} {faster:7.1f}",
                flush=True,
            )
            runs.append({"seed": seed, "times_real_time": faster, **asdict(result)})
    if args.json:
        args.json.write_text(json.dumps(runs, indent=1))
    return 0


def grow(settings: RobotSettings, seed: int, narrate: Narrate) -> tuple[Result, float]:
    """One run; also how many times faster than real time it was."""
    start = time.perf_counter()
    rig = Rig(settings, seed)
    result = run_sequence(RigSession(rig), Trace(settings), narrate)
    return result, rig.now_ns * 1e-9 / (time.perf_counter() - start)
