"""`python -m experiments reach`: run a robot's task in the rig; how near does it come to it?

Scored is what truly was, at each target while the executive called the arm settled.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from experiments.oracle import know_all
from experiments.rig import Rig, RigTimeoutError
from runtime import messages as m
from runtime.messages import Message
from runtime.settings import load_robot
from runtime.suggestion import suggestion

BEGIN_S = 0.5
STAYS_S = 2.0  # a payload that was put down is watched for so long
A_TARGET_S = 30.0  # of robot time: longer, and something is wrong


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `reach`."""
    parser.add_argument("robot", nargs="?", default="musashi_arm", help="robot or robot file")
    parser.add_argument("--task", default="reach")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--oracle", action="store_true", help="control by the body's truth: what friction leaves"
    )


class Watch:
    """True angles and tensions of one task, target by target."""

    def __init__(self) -> None:
        self.state: m.ExecutiveState | None = None
        self.angle_rad: dict[int, list[tuple[float, ...]]] = {}  # at each target, when settled
        self.peak_n: dict[int, float] = {}  # greatest true tension on the way to and at each
        self.strongest: dict[int, str] = {}

    def see(self, message: Message) -> None:
        """Take in a message."""
        if isinstance(message, m.ExecutiveState):
            self.state = message
        if not isinstance(message, m.WorldTruth) or self.state is None:
            return
        if not self.state.task or self.state.growing:  # growing, it counts other steps
            return
        step = self.state.step
        highest = max(range(len(message.muscles)), key=message.tension_n.__getitem__)
        if message.tension_n[highest] > self.peak_n.get(step, 0.0):
            self.peak_n[step] = message.tension_n[highest]
            self.strongest[step] = message.muscles[highest]
        if self.state.settled:
            self.angle_rad.setdefault(step, []).append(message.angle_rad)


def run(args: argparse.Namespace) -> int:
    """Run the task; 0 when it ended."""
    settings = load_robot(args.robot)
    task = next((task for task in settings.task if task.name == args.task), None)
    if task is None:
        hint = suggestion(args.task, [row.name for row in settings.task])
        print(f"{settings.file}: no task '{args.task}'{hint}")
        return 2
    rig, watch = Rig(settings, args.seed), Watch()
    rig.watchers.append(watch.see)
    plant = rig.robot.plant
    start = time.perf_counter()
    rig.run(BEGIN_S)
    if args.oracle:
        know_all(rig)
    reply = rig.ask(m.Task(name=task.name))
    if not reply.ok:
        print(reply.text)
        return 1
    try:
        rig.run_until(
            lambda: any(event.kind == "task_done" for event in rig.events),
            A_TARGET_S * len(task.targets_deg),
            f"the end of task '{task.name}'",
        )
    except RigTimeoutError as error:
        print(error)
    for event in rig.events:
        if event.level != "info" or event.kind in ("grasp", "release"):
            print(f"{event.stamp_ns * 1e-9:7.1f} s  {event.text}")
    if task.payload:
        put = plant.payload_m(task.payload)
        rig.run(STAYS_S)
        moved_m = float(np.linalg.norm(plant.payload_m(task.payload) - put))
        words = ", ".join(f"{name} {1000 * v:.0f}" for name, v in zip("xyz", put, strict=True))
        print(f"'{task.payload}' ended at {words} mm and moved {1000 * moved_m:.1f} mm since")
    faster = rig.now_ns * 1e-9 / (time.perf_counter() - start)
    print(f"{'target':>6}{'error':>12}{'worst joint':>28}{'peak tension':>30}")
    errors = []
    for step, target in enumerate(np.radians(task.targets_deg), start=1):
        if step not in watch.angle_rad:
            print(f"{step:6d}  not reached")
            continue
        off = np.mean(watch.angle_rad[step], axis=0) - target
        errors.append(np.linalg.norm(off))
        worst = int(np.argmax(np.abs(off)))
        print(
            f"{step:6d}{errors[-1]:8.4f} rad{settings.joints[worst]:>20}{off[worst]:+8.4f}"
            f"{watch.strongest[step]:>24}{watch.peak_n[step]:6.1f} N"
        )
    if not errors:
        return 1
    print(f"E_theta {np.mean(errors):.4f} rad, worst {max(errors):.4f} rad")
    print(f"greatest true tension {max(watch.peak_n.values()):.1f} N, {faster:.1f} x real time")
    return 0 if len(errors) == len(task.targets_deg) else 1
