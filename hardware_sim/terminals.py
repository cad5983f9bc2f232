"""`python -m hardware_sim.terminals ROBOT`: a simulated robot whose chains are pseudo-terminals.

Whoever opens one meets modules as on a serial port: our own driver, or others' tools. There is no
bus and no robot time but the host's own: that is how it is with a real robot.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NoReturn

from hardware_sim.pty import PtyChain
from hardware_sim.robot import STEP_NS, SimulatedRobot
from runtime.settings import RobotSettings, SettingsError, load_robot

PACE_S = 0.001
LAG_NS = 50_000_000  # behind by more than this, the lost time is not made up for


def parser() -> argparse.ArgumentParser:
    """What reads the words."""
    made = argparse.ArgumentParser(prog="python -m hardware_sim.terminals", description=__doc__)
    made.add_argument("robot", help="robot or robot file")
    made.add_argument("--folder", type=Path, required=True, help="put a link for each chain here")
    made.add_argument("--seed", type=int, default=0, help="of everything random")
    return made


@contextmanager
def terminals(robot: SimulatedRobot, folder: Path) -> Iterator[list[PtyChain]]:
    """A pseudo-terminal for each chain, and in the folder a link to it by the chain's name."""
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        opened = []
        for name, chain in robot.chains.items():
            terminal = stack.enter_context(PtyChain(chain, lambda: robot.now_ns))
            link = folder / name
            if link.is_symlink():  # of a run that was killed
                link.unlink()
            link.symlink_to(terminal.path)
            stack.callback(link.unlink, missing_ok=True)
            opened.append(terminal)
        yield opened


def keep_pace(robot: SimulatedRobot, opened: list[PtyChain]) -> NoReturn:
    """Step as fast as life, until interrupted."""
    start_ns = time.monotonic_ns() - robot.now_ns
    while True:
        behind_ns = time.monotonic_ns() - start_ns - robot.now_ns
        if behind_ns > LAG_NS:
            start_ns += behind_ns - LAG_NS
            behind_ns = LAG_NS
        with ExitStack() as stack:
            for terminal in opened:
                stack.enter_context(terminal.lock)
            for _ in range(behind_ns // STEP_NS):
                robot.step()
        time.sleep(PACE_S)


def serve(settings: RobotSettings, folder: Path, seed: int) -> NoReturn:
    """Offer the chains, say where, and let the robot live."""
    robot = SimulatedRobot(settings, seed)
    with terminals(robot, folder) as opened:
        for name in robot.chains:
            print(f'chain {name}: link = "serial://{(folder / name).absolute()}"', flush=True)
        keep_pace(robot, opened)


def main(argv: list[str] | None = None) -> int:
    """Run until Ctrl-C."""
    args = parser().parse_args(argv)
    try:
        serve(load_robot(args.robot), args.folder, args.seed)
    except (SettingsError, OSError) as error:
        print(f"python -m hardware_sim.terminals: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM):  # ignored by what a shell starts in the back
        signal.signal(number, signal.default_int_handler)
    sys.exit(main())
