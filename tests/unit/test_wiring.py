"""Wires on the known skeleton: slopes are those of lengths, sites go where they are put."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from runtime.messages import MusclePath, Place
from runtime.settings import RobotSettings, load_robot
from services.body_schema.wires import WireModel, Wires
from services.logic.skeleton import Skeleton
from services.logic.wiring import Wiring, nominal_paths, served
from tests.unit.arm_bench import shipped

STEP = 1e-6
ROBOTS = [load_robot(name) for name in ("elbow", "musashi_arm")]


def wired(settings: RobotSettings) -> Wiring:
    """All wires of a robot, its spare's too."""
    paths = nominal_paths(settings.body_file)
    paths |= {spare.name: spare.path for spare in settings.spare}
    return Wiring(settings.body_file, settings.joints, paths)


def postures(settings: RobotSettings) -> np.ndarray:
    low, high = Skeleton(settings.body_file, settings.joints).range_rad.T
    return np.random.default_rng(4).uniform(low, high, (6, len(low)))


def straight(settings: RobotSettings) -> Wires:
    """The elbow's wires where they are drawn, unstretched."""
    wiring = wired(settings)
    m = len(wiring.muscles)
    return Wires(wiring.muscles, wiring.paths, wiring.sites_m, np.zeros(m), np.zeros((m, 4)))


@pytest.mark.parametrize("settings", ROBOTS, ids=lambda s: s.name)
def test_slopes_by_joints_are_finite_differences(settings: RobotSettings) -> None:
    wiring = wired(settings)
    largest = 0.0
    for theta in postures(settings):
        length, jacobian = wiring.lengths_and_jacobian(theta)
        np.testing.assert_array_equal(length, wiring.lengths(theta))
        for j, step in enumerate(STEP * np.eye(len(theta))):
            slope = (wiring.lengths(theta + step) - wiring.lengths(theta - step)) / (2 * STEP)
            np.testing.assert_allclose(jacobian[:, j], slope, atol=1e-6)
        largest = max(largest, float(np.abs(jacobian).max()))
    assert largest > 0.02  # moment arms of centimetres


@pytest.mark.parametrize("settings", ROBOTS, ids=lambda s: s.name)
def test_slopes_by_sites_are_finite_differences(settings: RobotSettings) -> None:
    wiring = wired(settings)
    sites = wiring.sites_m
    assert len(sites) == len(wiring.wire_of_site) >= 2 * len(wiring.muscles)
    some = np.array(postures(settings)[:3])
    for theta, length, slopes in zip(some, *wiring.lengths_and_site_slopes(some), strict=True):
        wiring.place(sites)
        np.testing.assert_array_equal(length, wiring.lengths(theta))
        for p, k in enumerate(wiring.wire_of_site):
            for axis in range(3):
                ends = []
                for sign in (1.0, -1.0):
                    moved = sites.copy()
                    moved[p, axis] += sign * STEP
                    wiring.place(moved)
                    ends.append(wiring.lengths(theta))
                change = (ends[0] - ends[1]) / (2 * STEP)
                assert change[k] == pytest.approx(slopes[p, axis], abs=1e-5)
                assert not np.delete(change, k).any()  # a site belongs to one wire


def test_wires_that_share_a_site_on_the_drawing_have_one_each() -> None:
    settings = ROBOTS[0]
    wiring = wired(settings)
    assert wiring.muscles == (*settings.muscles, settings.spare[0].name)
    assert wiring.wire_of_site.tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    spare = settings.spare[0].path
    assert wiring.sites_m[6].tolist() == list(spare.attachment.position_m or ())
    assert wiring.sites_m[7].tolist() == list(spare.relays[-1].position_m or ())


def test_a_site_without_a_position_is_refused_in_words() -> None:
    settings = ROBOTS[0]
    nowhere = MusclePath(
        attachment=Place(link="upper_arm"),
        direction=(0.0, 0.0, -1.0),
        relays=(Place(link="forearm", position_m=(0.0, 0.0, 0.0)),),
    )
    with pytest.raises(ValueError, match="'upper_arm' has no position"):
        Wiring(settings.body_file, settings.joints, {"loose": nowhere})


# ── who answers ───────────────────────────────────────────────────────────────────────────────


def test_wires_are_served_only_if_all_muscles_have_one() -> None:
    settings, schema = ROBOTS[0], shipped()
    wires = straight(settings)

    def answers(wires: Wires | None) -> object:
        return served(replace(schema, wires=wires), settings.body_file, settings.joints)

    network = replace(schema, wires=None)
    assert served(network, settings.body_file, settings.joints) is network
    assert not isinstance(answers(wires.of(schema.muscles[:2])), WireModel)
    whole = answers(wires.of(tuple(reversed(schema.muscles))))
    assert isinstance(whole, WireModel)
    more = answers(wires)  # of four muscles, for a schema of three: one was pulled off
    assert isinstance(more, WireModel)
    theta, f = np.array([1.0]), np.full(3, 20.0)
    for model in (whole, more):
        assert model.muscles == schema.muscles and model.joints == settings.joints
        expected = wired(settings).lengths(theta)[:3]
        np.testing.assert_allclose(model.lengths(theta, f), expected, atol=1e-12)


def test_wires_answer_for_one_sample_as_for_many_and_shorten_by_their_stretch() -> None:
    settings = ROBOTS[1]
    wiring = wired(settings)
    m, n = len(wiring.muscles), len(settings.joints)
    rng = np.random.default_rng(2)
    stretch = rng.uniform(0.0, 0.003, (m, 4))
    wires = Wires(wiring.muscles, wiring.paths, wiring.sites_m, np.full(m, -0.2), stretch)
    model = WireModel(wires, wiring, settings.joints)
    theta, f = postures(settings), rng.uniform(4.0, 100.0, (6, m))
    many = model.lengths(theta, f)
    for row in range(6):
        length, jacobian = model.lengths_and_jacobian(theta[row], f[row])
        np.testing.assert_allclose(model.lengths(theta[row], f[row]), many[row], atol=1e-12)
        np.testing.assert_allclose(length, many[row], atol=1e-12)
        np.testing.assert_array_equal(jacobian, model.lengths_jacobian(theta[row], f[row]))
        assert jacobian.shape == (m, n)
    slack = model.lengths(theta, np.zeros_like(f))
    np.testing.assert_allclose(slack, [wiring.lengths(t) - 0.2 for t in theta], atol=1e-12)
    assert (many < slack - 1e-4).all()
    np.testing.assert_array_equal(model.lengths(theta, -f), slack)  # a load cell reads below zero
