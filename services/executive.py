"""Process: what the robot shall do in, muscle commands out."""

from __future__ import annotations

from runtime.messages import ChainState, JointState
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
    # It acts on its own beat: seven hundred wake-ups a second on four chains would be for nothing.
    launch.run(executive, unhurried=(ChainState, JointState))
