"""The robot file (TOML) as typed, validated settings.

Every quantity's name carries its unit. What is under `[simulation]` only the simulated world may
read: on a real robot nobody knows it. `load_robot` raises `SettingsError` whose text names file,
line and remedy.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import msgspec

from runtime.messages import MusclePath
from runtime.settings_file import SettingsError as SettingsError
from runtime.settings_file import located, read_toml
from runtime.suggestion import meant


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the robot file. Unknown keys are mistakes."""


class Robot(_Table, frozen=True, kw_only=True):
    """`[robot]`: name, and where body and schema are, seen from the robot file."""

    name: str  # first part of all keys: letters, digits, _ and -
    body: str  # MJCF file
    schema: str = ""  # the shipped schema; without one the robot has to learn it first


class Chain(_Table, frozen=True, kw_only=True):
    """`[[chain]]`: one half-duplex line with one master."""

    name: str  # a part of keys: letters, digits, _ and -
    link: str = (
        "sim:"  # `sim:` is simulated; serial:///dev/ttyUSB0 or serial:///dev/ttyUSB0?baud=1000000
    )
    baud: int = 3_000_000  # one that modules speak; a link's own has the last word
    rate_hz: float = 200.0  # goals written and readings read so often
    max_modules: int = 16  # one more is left alone with its torque off
    watchdog_ms: int = (
        100  # robot time of master's silence after which modules hold; in steps of 20
    )


class Joint(_Table, frozen=True, kw_only=True):
    """`[[joint]]`: a joint of the body and the module that measures it."""

    name: str  # of the MJCF joint
    chain: str  # of its module
    id: int  # 2 to 252, no other's on the chain
    rest_deg: float = 0.0  # where `park` goes


class Muscle(_Table, frozen=True, kw_only=True):
    """`[[muscle]]`: a muscle that is there from the start."""

    name: str  # of the MJCF tendon
    chain: str  # of its module
    id: int  # 2 to 252, no other's on the chain; 1 is kept for fresh modules
    role: str = ""  # flexor, extensor, ...: which muscles sigma_f compares


class Spare(_Table, frozen=True, kw_only=True):
    """`[[spare]]`: a muscle that may be plugged in, with its nominal path."""

    name: str
    chain: str  # where `plug` puts its module
    path: MusclePath  # see below
    role: str = ""  # as a muscle's


class Module(_Table, frozen=True, kw_only=True):
    """`[module]`: limits and constants of the muscle modules, as their data sheet gives them."""

    tension_limit_n: float = 150.0  # modules pay out from 0.88 of it
    winding_speed_m_s: float = 0.25  # greatest; targets move at 0.8 of it
    temperature_limit_degc: float = 80.0  # above it a module gives up tension
    spool_radius_m: float = 0.008  # of the motor's spool

    @property
    def target_speed_m_s(self) -> float:
        """How fast a target length may move: the motor must keep up, and correct errors too."""
        return 0.8 * self.winding_speed_m_s


class Control(_Table, frozen=True, kw_only=True):
    """`[control]`: how the executive moves the arm."""

    tension_floor_n: float = 8.0  # planned tension of a muscle that has nothing to do
    tension_ceiling_n: float = 120.0  # planned tension stays below, the limit is the module's
    stiffness_n_m: float = 20_000.0  # k_stiff that muscles are told
    joint_speed_deg_s: float = 60.0  # of a joint on its way to a target
    settle_s: float = 0.6  # how long the arm has to be at rest
    sharing: Literal["norm", "peak"] = "norm"  # least ||f||^2, or least greatest tension


class Growth(_Table, frozen=True, kw_only=True):
    """`[growth]`: how a new muscle is taken in."""

    n_new: int = 7  # motions to learn a muscle from
    n_check: int = 2  # motions more, to check it by
    method: str = "iv"  # of relearning: i, ii or iii as in the paper, iv: by wires
    bias_min_n: float = 10.0  # tension of the new muscle while it is learned, from ...
    bias_max_n: float = 25.0  # ... to
    residual_limit_mm: float = 4.0  # on held-out motion; above it a candidate is refused


class Payload(_Table, frozen=True, kw_only=True):
    """`[[payload]]`: a thing that a hand takes hold of. Services count with it while it is held."""

    name: str  # of the MJCF body in the simulation
    mass_kg: float  # its weight is counted in while it is held
    link: str  # MJCF body of the hand
    position_m: tuple[float, float, float]  # of its centre of mass in the link's frame, when held


class TaskPath(_Table, frozen=True, kw_only=True):
    """`[[task]]`: postures to go through, in order of the file's joints."""

    name: str
    targets_deg: tuple[tuple[float, ...], ...]  # one row a posture, one angle a joint
    payload: str = ""  # what is carried ...
    grasp_at: int = 0  # ... from this target on (the first is 1), once the arm has settled there
    release_at: int = 0  # ... to this one
    back: str = ""  # the task that brings it back to where this one takes it


class Web(_Table, frozen=True, kw_only=True):
    """`[web]`: where the robot's page is served."""

    address: str = "127.0.0.1"  # to listen on; any but loopback asks for a token
    port: int = 8800  # or the next one that is free
    names: tuple[str, ...] = ()  # host names to be asked by, beside this host's own
    certificate: str = ""  # PEM files, seen from the robot file: with them it is TLS
    key: str = ""
    results: tuple[str, ...] = ()  # folders of experiments' results, seen from the robot file


class Simulation(_Table, frozen=True, kw_only=True):
    """`[simulation]`: truth and imperfection of the simulated robot."""

    assembly_error_m: float = 0.002  # every attachment is off by about this much
    tension_noise_n: float = 0.2  # standard deviation of a load cell's readings
    length_noise_m: float = 2e-5  # of an encoder's
    angle_noise_rad: float = 1e-3  # of a joint module's
    wire_friction: float = 0.2  # mu phi: friction is tension * sinh(mu phi)
    elastic_n_m: tuple[float, float, float] = (1000.0, 0.0, 7.5e7)  # f = a e + b e^2 + c e^3
    ambient_degc: float = 25.0  # where all temperatures begin
    heating_degc_n2: float = 0.0075  # steady rise of a winding per squared tension
    thermal_time_s: float = 240.0  # in which a winding warms and cools
    motor_lag_s: float = 0.004  # of the motor's speed behind its command
    stall_tension_n: float = 450.0  # at which a motor winds no more
    # what nobody expects, for experiments; see experiments/variants.py
    moved_m: float = 0.0  # old insertions sit this far from where h_old learned them
    spare_stiffness: float = 1.0  # of an added muscle's elastic element, over the usual one's
    motor_friction: float = 0.0  # a load cell reads this share too much while its motor winds
    soft_part_m: float = 0.0  # radius of a part that an added wire runs over
    joint_error_m: float = 0.0  # joints sit this far from where the skeleton has them ...
    joint_error_rad: float = 0.0  # ... and their axes are turned by this much


class RobotSettings(_Table, frozen=True, kw_only=True):
    """A whole robot file."""

    robot: Robot
    chain: tuple[Chain, ...]
    joint: tuple[Joint, ...]
    muscle: tuple[Muscle, ...]
    spare: tuple[Spare, ...] = ()
    payload: tuple[Payload, ...] = ()
    task: tuple[TaskPath, ...] = ()
    module: Module = Module()
    control: Control = Control()
    growth: Growth = Growth()
    web: Web = Web()
    simulation: Simulation = Simulation()
    file: str = ""  # filled in by load_robot

    @property
    def name(self) -> str:
        """The robot's name: the first part of all its keys."""
        return self.robot.name

    @property
    def body_file(self) -> Path:
        """The MJCF file."""
        return self.beside(self.robot.body)

    @property
    def schema_file(self) -> Path | None:
        """The shipped schema, if the file names one."""
        return self.beside(self.robot.schema) if self.robot.schema else None

    def beside(self, path: str) -> Path:
        """A path as the robot file means it."""
        return (Path(self.file).parent / path).resolve()

    @property
    def joints(self) -> tuple[str, ...]:
        """Joint names in the file's order."""
        return tuple(joint.name for joint in self.joint)

    @property
    def muscles(self) -> tuple[str, ...]:
        """Names of the muscles that are there from the start, in the file's order."""
        return tuple(muscle.name for muscle in self.muscle)

    @property
    def role(self) -> str:
        """What the first spare is plugged in for; "" without one."""
        return self.spare[0].role if self.spare else ""

    @property
    def alike(self) -> tuple[str, ...]:
        """The muscles in the same role as the first spare, itself last."""
        rows: tuple[Muscle | Spare, ...] = (*self.muscle, *self.spare)
        return tuple(row.name for row in rows if row.role == self.role)


ROBOTS = Path(__file__).parent.parent / "deploy" / "robots"


def find_robot_file(name_or_path: str) -> Path:
    """`elbow` -> `deploy/robots/elbow.toml`; a path stays a path."""
    path = Path(name_or_path)
    if path.suffix == ".toml" or path.is_file():
        return path
    return ROBOTS / f"{name_or_path}.toml"


def load_robot(name_or_path: str, name: str = "") -> RobotSettings:
    """Read a robot file; `name` puts another name in place of the file's.

    Raises:
        SettingsError: the file is missing or says something that cannot be.
    """
    from runtime.settings_checks import robot_mistakes  # here, because it knows the types above

    path = find_robot_file(name_or_path)
    if path != Path(name_or_path) and not path.exists():
        shipped = sorted(file.stem for file in ROBOTS.glob("*.toml"))
        raise SettingsError(
            f"no robot '{name_or_path}'{meant(name_or_path, shipped) or '.'} "
            f"There is: {', '.join(shipped)}, or the path of a robot file"
        )
    settings = read_toml(path, RobotSettings, others=ROBOTS.glob("*.toml"))
    settings = msgspec.structs.replace(settings, file=str(path.resolve()))
    if name:
        robot = msgspec.structs.replace(settings.robot, name=name)
        settings = msgspec.structs.replace(settings, robot=robot)
    for mistake in robot_mistakes(settings):
        if name and mistake.path == ("robot", "name"):
            raise SettingsError(mistake.text)  # it does not stand in the file
        raise located(path, mistake)
    return settings


def load_path(file: str, robot: RobotSettings | None = None) -> MusclePath:
    """Read a muscle's path (`attachment`, `direction`, `relays`) from a TOML file of its own.

    With `robot`, the names in it have to be names of that robot's body.

    Raises:
        SettingsError: the file is missing or says something that cannot be.
    """
    from runtime.body_checks import path_mistakes  # here, because it knows the types above
    from runtime.body_names import read_body

    path = Path(file)
    muscle_path = read_toml(path, MusclePath)
    body = read_body(robot.body_file) if robot else None
    for mistake in path_mistakes(muscle_path, body=body):
        raise located(path, mistake)
    return muscle_path
