"""Wires are found again from a few short motions, whatever hands, elements and sensors did."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hardware_sim.wire_drive import elastic_stretch_m
from runtime.settings import load_robot
from services.body_schema.fit_wires import Beliefs, fit_wires
from services.body_schema.motions import SLACK_N, TrainingError
from services.body_schema.network import Array
from services.body_schema.wires import WireModel, Wires, stretch_terms
from services.logic.wiring import Wiring, nominal_paths

SETTINGS = load_robot("elbow")
OLD = SETTINGS.muscles
NEW = SETTINGS.spare[0].name
PATHS = nominal_paths(SETTINGS.body_file) | {NEW: SETTINGS.spare[0].path}
RANGE_RAD = (0.0, 2.1)
ELEMENT = (1800.0, 0.0, 3.0e7)  # other than the usual element, and no sum of `stretch_terms`
TENSIONS_N = np.linspace(0.0, 130.0, 1301)


def geometry() -> Wiring:
    return Wiring(SETTINGS.body_file, SETTINGS.joints, PATHS)


class Truth:
    """A robot whose every site is some millimetres off, with its own elastic elements."""

    def __init__(self, away_m: float = 0.004, seed: int = 1) -> None:
        wiring, rng = geometry(), np.random.default_rng(seed)
        away = rng.normal(size=wiring.sites_m.shape)
        away *= away_m / np.linalg.norm(away, axis=1, keepdims=True)
        m = len(wiring.muscles)
        wires = Wires(
            wiring.muscles,
            wiring.paths,
            wiring.sites_m + away,
            rng.normal(-0.2, 0.05, m),
            np.zeros((m, 4)),
        )
        self._path = WireModel(wires, wiring, SETTINGS.joints)
        self._e_m = np.array([elastic_stretch_m(f, ELEMENT) for f in TENSIONS_N.tolist()])

    def lengths(self, theta: Array, f: Array) -> Array:
        return self._path.lengths(theta, f) - np.interp(f, TENSIONS_N, self._e_m)

    def motions(self, count: int, seed: int) -> tuple[Array, Array, Array]:
        """Short motions as the sensors see them; on each, every tension rises and falls."""
        rng = np.random.default_rng([seed, 5])
        s = np.linspace(0.0, 1.0, 60)[:, None]
        at = rng.permutation(np.linspace(*RANGE_RAD, count + 1))
        theta = np.concatenate([at[k] + s * (at[k + 1] - at[k]) for k in range(count)])
        phase = rng.uniform(size=(count, 1, 4))
        f = 52.0 + 46.0 * np.cos(2.0 * np.pi * (1.5 * s + phase)).reshape(-1, 4)
        length = self.lengths(theta, f)
        return (
            theta + rng.normal(0.0, 1e-3, theta.shape),
            f + rng.normal(0.0, 0.2, f.shape),
            length + rng.normal(0.0, 2e-5, f.shape),
        )


@dataclass
class HOld:
    """What h_old says of the old muscles: the truth, and how far it is off from it."""

    truth: Truth
    off_m: float = 0.0
    muscles = OLD
    theta_range_rad = np.array([RANGE_RAD])
    tension_range_n = np.array([[5.0, 110.0]] * len(OLD))

    def lengths(self, theta: Array, f: Array) -> Array:
        known = np.hstack((f, np.full((len(f), 1), 20.0)))
        bend = self.off_m * np.array([1.0, -1.0, 0.7]) * np.cos(1.5 * theta + 0.5)
        return np.asarray(self.truth.lengths(theta, known)[:, :3] + bend)


def worst_mm(wires: Wires, truth: Truth) -> Array:
    """Greatest error of each muscle's length where nothing was measured, (M,)."""
    rng = np.random.default_rng(77)
    theta = rng.uniform(*RANGE_RAD, (400, 1))
    f = rng.uniform(6.0, 100.0, (400, 4))
    error = WireModel(wires, geometry(), SETTINGS.joints).lengths(theta, f)
    return np.asarray(np.abs(error - truth.lengths(theta, f)).max(axis=0) * 1e3)


def fit(truth: Truth, count: int, old: Any = None, seed: int = 3) -> Wires:
    return fit_wires(geometry(), *truth.motions(count, seed), old)


GOOD_MM = 0.3


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("count", [2, 3])
def test_two_or_three_short_motions_are_enough(count: int, seed: int) -> None:
    truth = Truth(seed=seed)
    drawn = fit_wires(geometry(), *truth.motions(count, seed), beliefs=Beliefs(site_sigma_m=1e-6))
    assert worst_mm(drawn, truth).max() > 1.0  # the drawing alone will not do
    assert (worst_mm(fit(truth, count, seed=seed), truth) < GOOD_MM).all()


@pytest.mark.parametrize("off_m", [0.0, 0.004])
def test_h_old_helps_and_cannot_spoil(off_m: float) -> None:
    truth = Truth()
    off = worst_mm(fit(truth, 2, HOld(truth, off_m)), truth)
    alone = worst_mm(fit(truth, 2), truth)
    assert (off < GOOD_MM).all()
    if off_m:
        assert (off[:3] < alone[:3] + 0.05).all()
    else:
        assert (off[:3] < alone[:3]).all()


def test_h_old_keeps_what_the_motions_do_not_show() -> None:
    truth = Truth()
    theta, f, length = truth.motions(2, 3)
    near = theta[:, 0] < 0.8
    few = (theta[near], f[near], length[near])
    alone = worst_mm(fit_wires(geometry(), *few), truth)
    helped = worst_mm(fit_wires(geometry(), *few, HOld(truth)), truth)  # type: ignore[arg-type]
    assert alone[:3].max() > 2.0 * helped[:3].max()
    assert (helped[:3] < GOOD_MM).all()


def test_slack_samples_are_not_looked_at() -> None:
    truth, rng = Truth(), np.random.default_rng(9)
    theta, f, length = truth.motions(3, 3)
    slack = rng.uniform(size=f.shape) < 0.2
    f[slack] = rng.uniform(-1.0, SLACK_N - 0.1, slack.sum())
    found = []
    for more_m in (0.01, 0.03):
        length[slack] += more_m
        found.append(fit_wires(geometry(), theta, f, length, HOld(truth)))  # type: ignore[arg-type]
    assert (worst_mm(found[0], truth) < GOOD_MM).all()
    for name in ("sites_m", "offset_m", "stretch_m"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))


def test_a_few_foul_readings_do_little() -> None:
    truth = Truth()
    theta, f, length = truth.motions(3, 3)
    length[::20] += 0.01
    assert (worst_mm(fit_wires(geometry(), theta, f, length), truth) < GOOD_MM).all()


def test_by_least_squares_they_do_much() -> None:
    truth = Truth()
    theta, f, length = truth.motions(3, 3)
    length[::20] += 0.01
    trusting = Beliefs(outlier=np.inf)
    assert worst_mm(fit_wires(geometry(), theta, f, length, beliefs=trusting), truth).max() > 0.5


def test_h_old_may_be_left_unasked() -> None:
    truth, deaf = Truth(), Beliefs(virtual=0)
    right, wrong = (
        fit_wires(geometry(), *truth.motions(2, 3), HOld(truth, off_m), beliefs=deaf)  # type: ignore[arg-type]
        for off_m in (0.0, 0.004)
    )
    assert right.to_table() == wrong.to_table()


def test_elements_are_told_from_paths() -> None:
    truth = Truth()
    wires = fit(truth, 3, HOld(truth))
    f = np.array([10.0, 30.0, 90.0])
    expected = np.array([elastic_stretch_m(x, ELEMENT) for x in f.tolist()])
    for k in range(4):
        e = stretch_terms(f) @ wires.stretch_m[k]
        np.testing.assert_allclose(e - e[0], expected - expected[0], atol=3e-4)


def test_the_same_samples_give_the_same_wires() -> None:
    truth = Truth()
    one, two = fit(truth, 2, HOld(truth)), fit(truth, 2, HOld(truth))
    assert one.to_table() == two.to_table()
    assert one.muscles == (*OLD, NEW) and one.paths == tuple(PATHS.values())


def test_a_muscle_that_was_never_taut_is_named() -> None:
    theta, f, length = Truth().motions(2, 3)
    f[:, 3] = 2.0
    with pytest.raises(TrainingError, match=f"{NEW} was never taut"):
        fit_wires(geometry(), theta, f, length)


def test_no_motion_teaches_nothing() -> None:
    none = np.zeros((0, 4))
    with pytest.raises(TrainingError, match="no motion"):
        fit_wires(geometry(), np.zeros((0, 1)), none, none)
