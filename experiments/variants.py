"""What the body may be besides what everybody believes: fixed before any method was tuned.

Each variant changes the simulated robot, or what its services believe, and nothing else.
"""

from __future__ import annotations

import zlib
from dataclasses import asdict, dataclass, field

import msgspec

from experiments.learn import of_drawing, of_paper
from runtime.cli.main import UsageError
from runtime.settings import RobotSettings
from services.body_schema.schema import Schema
from services.logic.arm import Arm
from services.logic.skeleton import Skeleton


@dataclass(frozen=True)
class Variant:
    """One way in which a body is not as believed.

    Attributes:
        text: what it is, for the help.
        simulation: fields of `[simulation]` that differ.
        believed_load: gravity that the services reckon with, over the true one.
    """

    text: str
    simulation: dict[str, float] = field(default_factory=dict)
    believed_load: float = 1.0
    drawn: bool = False  # h_old is what a drawing taught, not the robot itself

    def old(self, settings: RobotSettings) -> Schema:
        """h_old."""
        return Schema.from_bytes(self._stored(settings))

    def told(self, settings: RobotSettings) -> dict[str, object]:
        """What decides about results: all of it but the words."""
        known = asdict(self) | {"schema_crc": zlib.crc32(self._stored(settings))}
        del known["text"], known["drawn"]  # the schema's sum tells
        return known

    def _stored(self, settings: RobotSettings) -> bytes:
        file = settings.schema_file
        if file is None:
            raise UsageError(f"{settings.file}: an experiment begins with a schema; name one")
        begins_with = (of_drawing if self.drawn else of_paper)(file)
        if not begins_with.exists():
            raise UsageError(f"{begins_with}: not there; `python -m experiments learn` makes it")
        return begins_with.read_bytes()

    def settings(self, settings: RobotSettings) -> RobotSettings:
        """The robot of this variant."""
        simulation = msgspec.structs.replace(settings.simulation, **self.simulation)
        return msgspec.structs.replace(settings, simulation=simulation)

    def arm(self, kind: type[Arm]) -> type[Arm]:
        """An arm that reckons with the believed load."""
        if self.believed_load == 1.0:
            return kind
        load = self.believed_load

        class Loaded(kind):  # type: ignore[valid-type, misc]
            def __init__(self, settings: RobotSettings, skeleton: Skeleton) -> None:
                super().__init__(settings, skeleton)
                skeleton.gravity_scale = load

        return Loaded


# Of any body
SURPRISES = {
    "moved2": Variant("old insertions 2 mm elsewhere since h_old", {"moved_m": 0.002}),
    "moved4": Variant("old insertions 4 mm elsewhere since h_old", {"moved_m": 0.004}),
    "stiff": Variant("the new muscle's elastic element twice as stiff", {"spare_stiffness": 2.0}),
    "motor": Variant(
        "friction at the motor too: in motion readings are off by 5 %", {"motor_friction": 0.05}
    ),
    "soft": Variant("the new wire runs over a soft part", {"soft_part_m": 0.005}),
    "load": Variant("the load is known 10 % wrong", believed_load=1.1),
}
# Of a body of several joints: where h_old comes from
BEGINNINGS = {
    "clean": Variant("h_old from the robot itself; nothing but the assembly error"),
    "model": Variant(
        "h_old from a geometric model, sites 20 mm off, no friction, refined on five motions",
        drawn=True,
    ),
}

VARIANTS = {"clean": Variant("nothing but the assembly error")} | SURPRISES

ARM_VARIANTS = (
    BEGINNINGS
    | SURPRISES
    | {
        "all": Variant(
            "h_old from the model; readings 10 % off in motion, a soft part, joints 5 mm and "
            "15 mrad off, noise tripled",
            {
                "motor_friction": 0.1,
                "soft_part_m": 0.01,
                "joint_error_m": 0.005,
                "joint_error_rad": 0.015,
                "tension_noise_n": 0.6,
                "length_noise_m": 6e-5,
                "angle_noise_rad": 3e-3,
            },
            drawn=True,
        )
    }
)

LIFT_VARIANTS = BEGINNINGS | SURPRISES
