"""A first schema from a drawing: every site exactly so far off, the rest as data sheets say."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from experiments.imperfect import (
    REST_N,
    SAMPLES,
    STRONGEST_N,
    _samples,
    displaced_wires,
    refine_drawn,
)
from experiments.rig import shipped_schema
from hardware_sim.wire_drive import elastic_stretch_m
from runtime.settings import RobotSettings, load_robot
from services.body_schema.motions import SLACK_N, residuals_m
from services.body_schema.schema import Schema
from services.body_schema.wires import stretch_terms
from services.logic.skeleton import Skeleton
from services.logic.wiring import Wiring, nominal_paths, served

ROBOTS = [load_robot(name) for name in ("elbow", "musashi_arm")]


def drawn(settings: RobotSettings) -> Wiring:
    paths = nominal_paths(settings.body_file)
    return Wiring(settings.body_file, settings.joints, {n: paths[n] for n in settings.muscles})


@pytest.mark.parametrize("settings", ROBOTS, ids=lambda s: s.name)
@pytest.mark.parametrize("error_m", [0.0, 0.02])
def test_every_site_is_exactly_so_far_off(settings: RobotSettings, error_m: float) -> None:
    wires = displaced_wires(settings, error_m, seed=3).wires
    assert wires.muscles == settings.muscles
    away = wires.sites_m - drawn(settings).sites_m
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), error_m, atol=1e-12)
    if error_m:
        assert len(np.unique(away.round(6), axis=0)) == len(away)  # each goes its own way


def test_a_seed_is_one_drawing() -> None:
    one, same, other = (displaced_wires(ROBOTS[0], 0.02, seed).wires.sites_m for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert (np.linalg.norm(one - other, axis=1) > 1e-3).all()


@pytest.mark.parametrize("settings", ROBOTS, ids=lambda s: s.name)
def test_lengths_are_zero_at_rest_whatever_the_error(settings: RobotSettings) -> None:
    rest = np.radians([joint.rest_deg for joint in settings.joint])
    model = displaced_wires(settings, 0.02, seed=0)
    at_rest = model.lengths(rest, np.full(len(model.muscles), REST_N))
    np.testing.assert_allclose(at_rest, 0.0, atol=1e-12)


def test_elements_give_as_their_data_sheet_says() -> None:
    model = displaced_wires(ROBOTS[0], 0.0, seed=0)
    f = np.linspace(SLACK_N, STRONGEST_N, 50)
    sheet = [elastic_stretch_m(x, ROBOTS[0].simulation.elastic_n_m) for x in f.tolist()]
    for weights in model.wires.stretch_m:
        np.testing.assert_allclose(stretch_terms(f) @ weights, sheet, atol=1e-4)


def test_samples_are_all_over_the_joints_ranges_and_never_slack() -> None:
    settings = ROBOTS[1]
    theta, f = _samples(settings, 10, np.random.default_rng(0))
    low, high = Skeleton(settings.body_file, settings.joints).range_rad.T
    assert theta.shape == (SAMPLES, 5) and f.shape == (SAMPLES, 10)
    assert (theta >= low).all() and (theta <= high).all()
    assert (np.ptp(theta, axis=0) > 0.99 * (high - low)).all()
    assert f.min() >= SLACK_N and f.max() <= STRONGEST_N
    assert np.median(f) < 0.35 * STRONGEST_N  # more where elements are soft


def test_a_little_motion_refines_what_the_drawing_said() -> None:
    growth = msgspec.structs.replace(ROBOTS[0].growth, n_check=1)
    settings = msgspec.structs.replace(ROBOTS[0], growth=growth)
    drawing = displaced_wires(settings, 0.02, seed=0)
    shipped = Schema.from_bytes(shipped_schema(settings) or b"")
    refined, collected = refine_drawn(settings, shipped.with_wires(drawing.wires), 1, quick=True)
    assert (len(collected.new), len(collected.check)) == (1, 1)
    assert refined.muscles == collected.muscles == settings.muscles
    before = residuals_m(drawing, collected.check)
    after = residuals_m(served(refined, settings.body_file, settings.joints), collected.check)
    assert (after < 0.1 * before).all() and after.max() < 0.5e-3
