"""The `myograft body` command: what a body is, and whether its muscles can hold it."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the command is listed without importing what it runs
    from experiments.feasibility import Feasibility
    from hardware_sim.geometry import Geometry
    from runtime.settings import Control, Spare

SHOWN = 8  # postures that cannot be held are named up to so many
SPARE_LOAD = 1.2  # what a sound body can carry besides its own weight


class Body:
    """Show a body's joints and wires, and whether every posture can be held.

    FILE is a robot, a robot file, or any MJCF with spatial tendons. Draws random postures and asks
    for each by a linear program whether tensions between the robot's floor and ceiling carry
    gravity there, and how strong the strongest muscle has to be at least. Exit code 1 when some
    posture cannot be held.

    Examples:
      myograft body elbow
      myograft body deploy/robots/musashi_arm.toml --postures 2000
      myograft body my_arm.xml --json arm.json
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Arguments."""
        parser.add_argument("file", metavar="FILE", help="robot, robot file or MJCF")
        parser.add_argument("--postures", type=int, default=500, help="how many are tried")
        parser.add_argument("--seed", type=int, default=0, help="of the postures")
        parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there")

    def run(self, args: argparse.Namespace) -> int:
        """Look at it; 0 when every posture can be held."""
        from runtime.cli.main import UsageError

        if not 1 <= args.postures <= 1_000_000:
            raise UsageError("--postures is from 1 to 1000000")
        subject = _read(args.file)
        try:
            geometry = subject.geometry()
        except ValueError as error:
            raise UsageError(f"{subject.file}: {str(error).splitlines()[0]}") from error
        if not geometry.wires or not geometry.joints:
            what = "spatial tendon" if geometry.joints else "hinge joint"
            raise UsageError(f"{subject.file}: has no {what}, so there is nothing to hold")
        found = report(subject, geometry, args.postures, args.seed)
        print_body(subject, geometry, found)
        print_feasibility(found)
        if subject.bare:
            ceiling = f"{subject.control.tension_ceiling_n:g} N"
            print(f"{ceiling} is any robot file's default; 'myograft new' proposes what this needs")
        if args.json:
            args.json.write_text(json.dumps(found, indent=2) + "\n")
        if found["cases"][0]["share"] < 1.0:
            print_failures(found)
            return 1
        return 0


@dataclass(frozen=True)
class Subject:
    """What is looked at: a body, with what a robot file says of it."""

    name: str
    file: Path
    joints: tuple[str, ...]  # (): all hinges
    spares: tuple[Spare, ...]
    control: Control
    bare: bool = False  # no robot file says anything of it

    def geometry(self, spares: bool = False) -> Geometry:
        """Its wires, with or without the spare muscles."""
        from hardware_sim.geometry import Geometry

        attached = [(spare.name, spare.path) for spare in self.spares] if spares else []
        return Geometry(self.file, self.joints, attached)


def _read(word: str) -> Subject:
    from runtime.cli.main import UsageError
    from runtime.settings import Control, SettingsError, load_robot

    path = Path(word)
    if path.suffix == ".xml":
        if not path.is_file():
            raise UsageError(f"{path}: no such file")
        return Subject(path.stem, path, (), (), Control(), bare=True)
    try:
        robot = load_robot(word)
    except SettingsError as error:
        raise UsageError(str(error)) from error
    return Subject(robot.name, robot.body_file, robot.joints, robot.spare, robot.control)


def report(subject: Subject, geometry: Geometry, count: int, seed: int) -> dict[str, Any]:
    """All figures, of plain types: joints, wires and the cases of the feasibility report."""
    import numpy as np

    from experiments.feasibility import assess, postures

    control = subject.control
    drawn = postures(geometry.range_rad, count, seed)
    at = [geometry.at(posture) for posture in drawn]
    length_m = np.array([length for length, *_ in at])  # (K, M)
    arm_m = np.array([-jacobian for _, jacobian, _ in at])  # (K, M, N): positive turns it up
    gravity_nm = np.array([torque for *_, torque in at])  # (K, N)

    def case(name: str, body: Geometry, scale: float) -> dict[str, Any]:
        held = assess(body, drawn, control.tension_floor_n, control.tension_ceiling_n, scale)
        return _case(name, body, held)

    cases = [
        case("as it is", geometry, 1.0),
        case(f"{100 * SPARE_LOAD - 100:.0f} % more weight", geometry, SPARE_LOAD),
    ]
    if subject.spares:
        names = ", ".join(spare.name for spare in subject.spares)
        cases.append(case(f"with {names}", subject.geometry(spares=True), 1.0))
    return {
        "body": str(subject.file),
        "mass_kg": geometry.mass_kg,
        "joints": [
            {
                "name": name,
                "range_deg": np.degrees(geometry.range_rad[i]).round(3).tolist(),
                "gravity_nm": [float(gravity_nm[:, i].min()), float(gravity_nm[:, i].max())],
            }
            for i, name in enumerate(geometry.joints)
        ],
        "wires": [
            {
                "name": name,
                "length_m": [float(length_m[:, k].min()), float(length_m[:, k].max())],
                "moment_arm_m": {
                    joint: [float(arm_m[:, k, i].min()), float(arm_m[:, k, i].max())]
                    for i, joint in enumerate(geometry.joints)
                },
            }
            for k, name in enumerate(geometry.wires)
        ],
        "postures": count,
        "seed": seed,
        "tension_floor_n": control.tension_floor_n,
        "tension_ceiling_n": control.tension_ceiling_n,
        "cases": cases,
    }


def _case(name: str, geometry: Geometry, held: Feasibility) -> dict[str, Any]:
    import numpy as np

    def posture(index: int) -> dict[str, Any]:
        angles = np.degrees(held.angle_rad[index]).round(1).tolist()
        return {
            "number": index,
            "angle_deg": dict(zip(geometry.joints, angles, strict=True)),
            "least_peak_n": finite(float(held.least_peak_n[index])),
        }

    return {
        "name": name,
        "share": held.share,
        "median_n": finite(held.percentile_n(50)),
        "p95_n": finite(held.percentile_n(95)),
        "worst_n": finite(float(held.least_peak_n.max())),
        "worst": posture(held.worst),
        "not_held": [posture(int(i)) for i in np.flatnonzero(~held.feasible)],
    }


def finite(tension_n: float) -> float | None:
    """The tension, or None for one that no muscle has: JSON knows no infinity."""
    return tension_n if tension_n < float("inf") else None


def print_body(subject: Subject, geometry: Geometry, found: dict[str, Any]) -> None:
    """Joints and wires, one a line."""
    mass_kg = sum(geometry.mass_kg.values())
    print(
        f"{subject.name}: {len(geometry.joints)} joints, {len(geometry.wires)} wires,"
        f" {mass_kg:.2f} kg in {subject.file}\n"
    )
    width = max(len(row["name"]) for row in [*found["joints"], *found["wires"]]) + 2
    print(f"{'joint':<{width}}{'range [deg]':>16}{'gravity [Nm]':>18}")
    for row in found["joints"]:
        print(
            f"{row['name']:<{width}}{_span(row['range_deg'], 0):>16}"
            f"{_span(row['gravity_nm'], 1):>18}"
        )
    print(f"\n{'wire':<{width}}{'length [mm]':>16}  moment arms [mm], where it has one")
    for row in found["wires"]:
        arms = {joint: _arm(values) for joint, values in row["moment_arm_m"].items()}
        words = ", ".join(f"{joint} {arm}" for joint, arm in arms.items() if arm)
        length = _span([1000 * value for value in row["length_m"]], 0)
        print(f"{row['name']:<{width}}{length:>16}  {words}")


def print_feasibility(found: dict[str, Any]) -> None:
    """What it takes to hold the postures, case by case."""
    print(
        f"\nleast maximal tension at {found['postures']} random postures (seed {found['seed']}),"
        f" no muscle below {found['tension_floor_n']:g} N"
    )
    width = max(len(case["name"]) for case in found["cases"]) + 2
    share = f"held below {found['tension_ceiling_n']:g} N"
    print(f"{'':<{width}}{share:>18}{'median':>10}{'95 %':>10}{'worst':>10}")
    for case in found["cases"]:
        figures = "".join(f"{_newton(case[k]):>10}" for k in ("median_n", "p95_n", "worst_n"))
        print(f"{case['name']:<{width}}{100 * case['share']:>16.1f} %{figures}")
    print(f"worst posture: {_posture(found['cases'][0]['worst'])}")


def print_failures(found: dict[str, Any], command: str = "body") -> None:
    """The first postures that cannot be held."""
    failures = found["cases"][0]["not_held"]
    print(f"myograft {command}: {len(failures)} postures cannot be held:", file=sys.stderr)
    for posture in failures[:SHOWN]:
        print(f"  {_posture(posture)}", file=sys.stderr)
    if len(failures) > SHOWN:
        names_all = "; --json names all" if command == "body" else ""
        print(f"  and {len(failures) - SHOWN} more{names_all}", file=sys.stderr)


def _posture(posture: dict[str, Any]) -> str:
    angles = ", ".join(f"{name} {angle:.0f}" for name, angle in posture["angle_deg"].items())
    least_n = posture["least_peak_n"]
    need = "no tensions hold it" if least_n is None else f"needs {least_n:.0f} N"
    return f"{angles} deg: {need}"


def _newton(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} N"


def _span(values: list[float], digits: int) -> str:
    return f"{values[0]:.{digits}f} .. {values[1]:.{digits}f}"


def _arm(values_m: list[float]) -> str:
    low, high = (1000 * value for value in values_m)
    return "" if max(-low, high) < 0.5 else f"{low:.0f} .. {high:.0f}"
