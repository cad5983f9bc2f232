"""Process: what the robot shall do in, muscle commands out."""

from __future__ import annotations

from runtime.process import Launch
from services.logic.arm import Arm
from services.logic.executive import Executive
from services.logic.skeleton import Skeleton


def main(launch: Launch) -> None:
    """Run the executive until told to stop; it goes on with what a former one was about."""
    settings = launch.settings
    skeleton = Skeleton(settings.body_file, settings.joints)
    executive = Executive(settings, Arm(settings, skeleton), launch.store, launch.seed)
    executive.resume()
    launch.run(executive)
