"""Motions to learn from: they fill the ranges and lie far apart."""

from __future__ import annotations

import numpy as np
import pytest

from services.logic.targets import FLOOR_SPREAD_N, RANGE_MARGIN, spread_targets

START_RAD = np.zeros(2)
RANGE_RAD = np.array([[-0.1, 2.3], [0.0, 1.0]])


@pytest.mark.parametrize("count", [2, 7, 15])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_targets_are_stratified_over_every_range(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    targets = spread_targets(count, RANGE_RAD, 3, (8.0, 35.0), rng, START_RAD)
    assert len(targets) == count
    low, high = RANGE_RAD.T
    margin = RANGE_MARGIN * (high - low)
    angles = np.array([target.angle_rad for target in targets])
    shares = (angles - low - margin) / (high - low - 2 * margin)
    biases = (np.array([[target.bias_n] for target in targets]) - 8.0) / 27.0
    for column in np.hstack([shares, biases]).T:
        assert column.min() >= 0.0 and column.max() <= 1.0
        # one value in every stratum: none is left out, none is taken twice
        assert sorted(np.round(column * (count - 1)).astype(int)) == list(range(count))
    floors = np.array([target.floor_n for target in targets])
    assert floors.shape == (count, 3)
    assert floors.min() >= 0.0 and floors.max() <= FLOOR_SPREAD_N


def test_the_first_target_is_far_from_where_the_arm_is() -> None:
    for start in (np.array([0.0]), np.array([2.2])):
        (one,) = spread_targets(1, RANGE_RAD[:1], 3, (8.0, 35.0), np.random.default_rng(0), start)
        assert abs(one.angle_rad[0] - start[0]) > 0.8 * np.ptp(RANGE_RAD[0])


def test_targets_travel_far_from_one_to_the_next() -> None:
    targets = spread_targets(
        9, RANGE_RAD[:1], 3, (8.0, 35.0), np.random.default_rng(0), START_RAD[:1]
    )
    angles = np.array([target.angle_rad[0] for target in targets])
    steps = np.abs(np.diff(angles))
    assert steps.mean() > np.ptp(angles) / 3  # of points in random order a third would do


def test_targets_are_the_seeds_own_and_no_motion_is_no_target() -> None:
    def made(seed: int) -> object:
        return spread_targets(5, RANGE_RAD, 3, (8.0, 35.0), np.random.default_rng(seed), START_RAD)

    assert made(1) == made(1) != made(2)
    assert spread_targets(0, RANGE_RAD, 3, (8.0, 35.0), np.random.default_rng(0), START_RAD) == ()
    (one,) = spread_targets(1, RANGE_RAD, 3, (8.0, 35.0), np.random.default_rng(0), START_RAD)
    assert -0.1 < one.angle_rad[0] < 2.3
