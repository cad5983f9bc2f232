"""`python -m experiments place`: find places for the wires of a body, so that it can be held.

Wires that a person draws look right and leave many postures that no tensions hold. This moves the
sites of a robot's wires inside boxes around where the body file has them, and keeps what lowers the
tensions that its postures ask for. The body file is written anew with `--write`.

The score of a body is a smooth stand-in for the greatest of the least maximal tensions, see
`feasibility.py`: torque that nothing can carry is paid for. So is a moment arm that changes its
sign within the joints' ranges at the joint that the muscle is there for, and a joint that only
short arms move: friction of the wires would decide where it stands.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Sequence
from pathlib import Path

import daqp
import numpy as np

from experiments.feasibility import (
    CURVATURE_1_N,
    MOST_N,
    Array,
    Feasibility,
    assess,
    postures,
)
from hardware_sim.geometry import Geometry
from runtime.settings import RobotSettings, load_robot
from runtime.suggestion import suggestion

POSTURES = 160
UNCARRIED_N_NM2 = 5e4  # price of torque that nothing carries: 0.02 Nm costs 10 N
NORM = 8.0  # of tensions over postures: the worst ones count most
LEAST_ARM_M = 0.015  # a muscle's arm at its own joint should not fall below ...
JOINT_ARM_M = 0.02  # the longest arm in each direction of each joint should not, either ...
ARM_PRICE_N_M = 4000.0  # ... or each mm costs 4 N
CLEAR = 0.7  # of its first distance from the bone's axis is left to a site at least
MIRROR = np.array((1.0, -1.0, 1.0))  # of a link's frame: y points to the left
STEPS_MM = (1.0, 15.0)  # of one trial, drawn evenly in their logarithm


def configure(parser: argparse.ArgumentParser) -> None:
    """Options of `place`."""
    parser.add_argument("robot", help="robot or robot file")
    parser.add_argument("--trials", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--box-mm", type=float, default=30.0, help="half a box's width")
    parser.add_argument("--keep", nargs="+", default=[], metavar="WIRE", help="do not move these")
    parser.add_argument("--load", type=float, default=1.2, help="times gravity")
    parser.add_argument("--write", action="store_true", help="put the places into the body file")


def run(args: argparse.Namespace) -> int:
    """Search, report, and perhaps write."""
    settings = load_robot(args.robot)
    try:
        search = Search(settings, args.box_mm * 1e-3, args.load, args.seed, args.keep)
    except ValueError as error:
        print(f"place: {error}")
        return 2
    print(f"{'trials':>7}  {'score N':>8}  {'feasible':>8}  {'95 % N':>7}  {'worst N':>7}")
    start = time.monotonic()
    for trial in range(args.trials + 1):
        if trial:
            search.trial()
        if trial % max(args.trials // 10, 1) == 0:
            found = search.check()
            print(
                f"{trial:7d}  {search.score:8.1f}  {100 * found.share:6.1f} %  "
                f"{found.percentile_n(95):7.1f}  {found.least_peak_n.max():7.1f}",
                flush=True,
            )
    print(f"after {time.monotonic() - start:.0f} s")
    if args.write:
        write_sites(settings.body_file, search.places_m())
        print(f"written: {settings.body_file}")
    return 0


class Search:
    """Random local search over the sites of one body's wires.

    Attributes:
        score: of the best places so far [N].
    """

    def __init__(
        self,
        settings: RobotSettings,
        box_m: float,
        load: float,
        seed: int,
        keep: Sequence[str] = (),
    ) -> None:
        """Start from where the sites are drawn; wires in `keep` stay there.

        Raises:
            ValueError: `keep` names no wire of the body, or all of them.
        """
        self._settings = settings
        self._geometry = Geometry(settings.body_file, settings.joints)
        self._load = load
        self._rng = np.random.default_rng(seed)
        wires = dict(zip(self._geometry.wires, self._geometry.wire_sites, strict=True))
        for name in keep:
            if name not in wires:
                raise ValueError(f"no wire '{name}'{suggestion(name, wires)}")
        drawn = {site: self._geometry.site_m(site) for wire in wires.values() for site in wire}
        # the right half of a body follows the left one
        self._mirrored = {site: _mirror_name(site) for site in drawn if _mirror_name(site) in drawn}
        self._movable = [
            sites
            for name, sites in wires.items()
            if name not in keep and not any(site in self._mirrored.values() for site in sites)
        ]
        if not self._movable:
            raise ValueError("nothing is left to move")
        self._best = dict(drawn)
        self._box = {site: (at - box_m, at + box_m) for site, at in drawn.items()}
        self._clear_m = {site: CLEAR * np.hypot(*at[:2]) for site, at in drawn.items()}
        self._postures = _extreme_postures(self._geometry.range_rad, seed)
        arms = np.mean([self._geometry.at(p)[1] for p in self._postures], axis=0)  # (M, N)
        self._own = np.argmax(np.abs(arms), axis=1)  # joint that each muscle is there for
        self._sign = np.sign(arms[np.arange(len(arms)), self._own])
        self.score = self._rate()

    def places_m(self) -> dict[str, Array]:
        """Site -> position (3,) [m] in its link's frame, the best so far."""
        return dict(self._best)

    def check(self) -> Feasibility:
        """What the best places do on postures that the search does not see."""
        control = self._settings.control
        unseen = postures(self._geometry.range_rad, 300, 10_000)
        return assess(
            self._geometry, unseen, control.tension_floor_n, control.tension_ceiling_n, self._load
        )

    def trial(self) -> None:
        """Move one wire's sites a little; keep that if it is better."""
        wire = self._movable[self._rng.integers(len(self._movable))]
        step_m = 1e-3 * np.exp(self._rng.uniform(*np.log(STEPS_MM)))
        for site in wire:
            low, high = self._box[site]
            moved = self._best[site] + step_m * self._rng.normal(size=3)
            self._move(site, self._outside(site, np.clip(moved, low, high)))
        score = self._rate()
        if score < self.score:
            self.score = score
            for site in wire:
                self._best[site] = self._geometry.site_m(site)
                if site in self._mirrored:
                    self._best[self._mirrored[site]] = MIRROR * self._best[site]
        else:
            for site in wire:
                self._move(site, self._best[site])

    def _move(self, site: str, place_m: Array) -> None:
        self._geometry.move_site(site, place_m)
        if site in self._mirrored:
            self._geometry.move_site(self._mirrored[site], MIRROR * place_m)

    def _outside(self, site: str, place_m: Array) -> Array:
        """The place, pushed out of the bone: bones run along their link's z axis."""
        distance_m = float(np.hypot(*place_m[:2]))
        if distance_m < self._clear_m[site]:
            place_m[:2] *= self._clear_m[site] / max(distance_m, 1e-6)
        return place_m

    def _rate(self) -> float:
        floor = self._settings.control.tension_floor_n
        peaks, least = [], np.full(len(self._own), np.inf)
        shortest = np.full((2, len(self._geometry.joints)), np.inf)  # down, up
        for posture in self._postures:
            _, jacobian, torque = self._geometry.at(posture)
            peaks.append(_soft_peak(jacobian, self._load * torque, floor))
            own = self._sign * jacobian[np.arange(len(jacobian)), self._own]
            np.minimum(least, own, out=least)
            longest = np.stack((jacobian.max(axis=0), -jacobian.min(axis=0)))
            np.minimum(shortest, longest, out=shortest)
        missing_m = np.maximum(LEAST_ARM_M - least, 0.0).sum()
        missing_m += np.maximum(JOINT_ARM_M - shortest, 0.0).sum()
        return float(np.mean(np.array(peaks) ** NORM) ** (1 / NORM) + ARM_PRICE_N_M * missing_m)


def _extreme_postures(range_rad: Array, seed: int) -> Array:
    """Postures (K, N) [rad] that lie near the ends of the ranges (N, 2) more often than within."""
    even = postures(np.tile((0.0, 1.0), (len(range_rad), 1)), POSTURES, seed)
    low, high = range_rad.T
    return np.asarray(low + (high - low) * np.sin(0.5 * np.pi * even) ** 2)


def _mirror_name(site: str) -> str:
    """Name of the site's counterpart on the right, if it is one on the left."""
    return "right_" + site.removeprefix("left_") if site.startswith("left_") else ""


def _soft_peak(jacobian: Array, torque_nm: Array, floor_n: float) -> float:
    """Least maximal tension [N] plus the price of the torque that is left uncarried."""
    m, n = jacobian.shape
    # x = (f, t), t at least every f; the balance goes into the objective
    balance = np.hstack((jacobian.T, np.zeros((n, 1))))
    h = UNCARRIED_N_NM2 * balance.T @ balance
    h.flat[:: m + 2] += CURVATURE_1_N
    slope = UNCARRIED_N_NM2 * torque_nm @ balance
    slope[-1] = 1.0
    rows = np.hstack((np.eye(m), -np.ones((m, 1))))
    low = np.concatenate((np.full(m + 1, floor_n), np.full(m, -1e30)))
    high = np.concatenate((np.full(m + 1, MOST_N), np.zeros(m)))
    x, _, flag, _ = daqp.solve(h, slope, rows, high, low)
    if flag < 0:
        return MOST_N
    left = torque_nm + balance @ x
    return float(x[m] + UNCARRIED_N_NM2 / 2 * left @ left)


def write_sites(file: Path, places_m: dict[str, Array]) -> None:
    """Put new positions into a body file, to a tenth of a millimetre, and change nothing else."""
    text = file.read_text(encoding="utf-8")
    for site, place in places_m.items():
        words = " ".join(f"{value:.4f}" for value in place)
        pattern = rf'(<site\b[^>]*\bname="{re.escape(site)}"[^>]*\bpos=")[^"]*(")'
        text, count = re.subn(pattern, rf"\g<1>{words}\g<2>", text)
        if count != 1:
            raise ValueError(f"{file.name} has {count} sites '{site}' with a position")
    file.write_text(text, encoding="utf-8")
