"""Process: the master of one daisy chain."""

from __future__ import annotations

from runtime.process import Launch
from services.logic.muscle_driver import MuscleDriver


def main(launch: Launch) -> None:
    """Run `driver-<chain>` of one robot."""
    launch.run(MuscleDriver(launch.settings, launch.instance, launch.store))
