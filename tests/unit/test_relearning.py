"""Jobs of method iv: whose wires are known from where, and what goes wrong in words."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import msgspec
import numpy as np
import pytest

from experiments.variants import VARIANTS
from runtime.messages import Motion, MusclePath, Place, TrainingJob
from runtime.settings import load_robot
from services.body_schema import train
from services.body_schema.motions import TrainingError
from services.body_schema.posture import posture
from services.body_schema.schema import Schema
from services.body_schema.wires import WireModel, Wires
from services.logic.relearning import by_wires, fitted, grown, known_paths, refitted
from services.logic.wiring import Wiring, nominal_paths
from tests.unit import analytic_body as body
from tests.unit.schemas import untrained

SETTINGS = load_robot("elbow")
NEW = SETTINGS.spare[0].name
MUSCLES = (*SETTINGS.muscles, NEW)
SHORT = train.Recipe(steps=12, batch=512, rate=1e-3)


@pytest.fixture(autouse=True)
def short_recipes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train, "teach", partial(train.teach, recipe=SHORT))


def wiring() -> Wiring:
    paths = nominal_paths(SETTINGS.body_file) | {NEW: SETTINGS.spare[0].path}
    return Wiring(SETTINGS.body_file, SETTINGS.joints, paths)


def truth() -> WireModel:
    """The elbow with every site 3 mm off."""
    geometry = wiring()
    sites = geometry.sites_m + np.sqrt(3.0) * 1e-3 * np.array([1.0, -1.0, 1.0])
    stretch = np.tile([0.002, 0.0, 0.004, 0.0], (4, 1))
    wires = Wires(geometry.muscles, geometry.paths, sites, np.full(4, -0.2), stretch)
    return WireModel(wires, geometry, SETTINGS.joints)


def motions(order: tuple[str, ...] = MUSCLES) -> list[Motion]:
    """Three motions of the true elbow, columns in an order."""
    model, rng = truth(), np.random.default_rng(6)
    columns = [MUSCLES.index(name) for name in order]
    found = []
    for low, high in ((0.1, 1.4), (1.9, 0.6), (0.9, 2.1)):
        s = np.linspace(0.0, 1.0, 50)[:, None]
        theta = low + s * (high - low)
        f = 50.0 + 42.0 * np.cos(2 * np.pi * (1.5 * s + rng.uniform(size=4)))
        length = model.lengths(theta, f)
        rest = np.zeros(50, dtype=bool)
        found.append(body.motion(theta, f[:, columns], length[:, columns], rest))
    return found


def base(muscles: tuple[str, ...] = SETTINGS.muscles) -> Schema:
    return untrained(muscles=muscles)


def job(**more: object) -> TrainingJob:
    fields: dict[str, object] = {
        "job": "job-1",
        "kind": "grow",
        "joints": SETTINGS.joints,
        "muscles": MUSCLES,
        "base_version": 1,
        "motions": tuple(motions()),
        "method": "iv",
        **more,
    }
    return TrainingJob(**fields)  # type: ignore[arg-type]


def done(*_: float) -> None:
    """Progress that nobody watches."""


# ── known paths ───────────────────────────────────────────────────────────────────────────────


def elsewhere(x: float) -> MusclePath:
    return MusclePath(
        attachment=Place(link="upper_arm", position_m=(x, 0.0, 0.0)),
        direction=(0.0, 0.0, -1.0),
        relays=(Place(link="forearm", position_m=(x, 0.0, -0.05)),),
    )


def wires_of(muscle: str, x: float) -> Wires:
    path = elsewhere(0.0)
    sites = np.array([[x, 0.0, 0.0], [x, 0.0, -0.05]])
    return Wires((muscle,), (path,), sites, np.zeros(1), np.zeros((1, 4)))


def test_the_robot_file_goes_before_the_drawing_and_what_was_found_before_both() -> None:
    drawn = nominal_paths(SETTINGS.body_file)
    assert known_paths(base(), SETTINGS) == drawn | {NEW: SETTINGS.spare[0].path}
    other = msgspec.structs.replace(SETTINGS.spare[0], name="triceps", path=elsewhere(0.1))
    settings = msgspec.structs.replace(SETTINGS, spare=(*SETTINGS.spare, other))
    assert known_paths(base(), settings)["triceps"] == elsewhere(0.1)
    found = base().with_wires(wires_of("triceps", 0.2))
    assert known_paths(found, settings) == {
        **drawn,
        NEW: SETTINGS.spare[0].path,
        "triceps": elsewhere(0.2),
    }


def test_a_muscle_whose_path_nobody_told_is_named() -> None:
    muscles = (*SETTINGS.muscles, "stranger")
    with pytest.raises(TrainingError, match=r"wire of stranger nominally runs; plug it in"):
        grown(base(), job(muscles=muscles), SETTINGS, done)


# ── jobs ──────────────────────────────────────────────────────────────────────────────────────


def test_wires_are_fitted_and_stand_beside_the_network() -> None:
    order = (NEW, *reversed(SETTINGS.muscles))  # as a chain may name them
    old = base()
    schema = grown(old, job(muscles=order, motions=tuple(motions(order))), SETTINGS, done)
    assert schema.muscles == MUSCLES
    assert schema.wires is not None and schema.wires.muscles == MUSCLES
    model, right = WireModel(schema.wires, wiring(), SETTINGS.joints), truth()
    rng = np.random.default_rng(8)
    theta, f = rng.uniform(0.1, 2.0, (50, 1)), rng.uniform(8.0, 90.0, (50, 4))
    np.testing.assert_allclose(model.lengths(theta, f), right.lengths(theta, f), atol=0.5e-3)


def test_readings_that_no_posture_has_do_not_blow_up_mask_011() -> None:
    """A pupil that was only ever shown what fits together said 0.13 rad to a stuck load cell."""
    old, teacher = VARIANTS["clean"].old(SETTINGS), truth()
    pupil = train.teach(old, motions(), NEW, teacher.lengths, recipe=train.Recipe(200, 32, 3e-3))
    s = np.linspace(0.0, 1.0, 40)[:, None]
    theta, f = 0.3 + 1.5 * s, 25.0 + 15.0 * np.cos(2 * np.pi * (s + 0.25 * np.arange(4)))
    length = teacher.lengths(theta, f)
    for muscle in range(4):
        stuck = f.copy()
        stuck[:, muscle] = 60.0
        told = [posture(pupil, *reading) for reading in zip(stuck, length, strict=True)]
        off = np.array([x.angle_rad for x in told]) - theta
        assert np.abs(off).max() < 2e-3, MUSCLES[muscle]


def test_a_body_is_learned_again_by_wires_as_it_is() -> None:
    old = base(MUSCLES)
    schema = by_wires(old, motions(), "", SETTINGS)
    assert schema.muscles == MUSCLES
    assert schema.wires is not None and schema.wires.muscles == MUSCLES


def test_wires_start_where_they_were_found_before() -> None:
    at = truth().wires
    known = base(MUSCLES).with_wires(replace(at, offset_m=np.zeros(4)))
    model = fitted(known, motions(), MUSCLES, SETTINGS, known_paths(known, SETTINGS))
    away = np.linalg.norm(model.wires.sites_m - at.sites_m, axis=1)
    blank = base(MUSCLES)
    anew = fitted(blank, motions(), MUSCLES, SETTINGS, known_paths(blank, SETTINGS)).wires.sites_m
    assert away.max() < 1e-3 < np.linalg.norm(anew - at.sites_m, axis=1).max()


@pytest.mark.parametrize("wrong", ["none", "slack", "narrow", "nan", "infinite", "uneven", "few"])
def test_motions_that_teach_nothing_are_refused_in_words(wrong: str) -> None:
    motion = motions()[0]
    theta, f, length = (np.array(a) for a in (motion.angle_rad, motion.tension_n, motion.length_m))
    if wrong == "slack":
        f[:, 3] = 1.0
    if wrong == "narrow":
        f, length = f[:, :3], length[:, :3]
    if wrong == "nan":
        length[3, 3] = np.nan
    if wrong == "infinite":
        theta[3] = np.inf
    if wrong == "uneven":
        length = length[:-1]
    if wrong == "few":
        theta, f, length = theta[:5], f[:5], length[:5]
    bad = [] if wrong == "none" else [body.motion(theta, f, length, np.zeros(50, dtype=bool))]
    with pytest.raises(TrainingError):
        by_wires(base(), bad, NEW, SETTINGS)


@pytest.mark.parametrize(
    "muscles", [(*MUSCLES, "wing"), MUSCLES[1:], ("wing", "tail", *SETTINGS.muscles)]
)
def test_growth_is_by_one_muscle(muscles: tuple[str, ...]) -> None:
    with pytest.raises(TrainingError, match="is not one muscle more"):
        grown(base(), job(muscles=muscles, motions=()), SETTINGS, done)


def test_a_muscle_that_came_back_keeps_its_wire_with_another_offset() -> None:
    former = by_wires(base(MUSCLES), motions(), "", SETTINGS)
    shifted = [
        msgspec.structs.replace(
            motion,
            length_m=tuple((*row[:3], row[3] + 0.03) for row in motion.length_m),
        )
        for motion in motions()
    ]
    expected = former.lengths(
        np.concatenate([np.array(x.angle_rad) for x in shifted]),
        np.concatenate([np.array(x.tension_n) for x in shifted]),
    )
    measured = np.concatenate([np.array(x.length_m) for x in shifted])
    again = refitted(former, job(motions=tuple(shifted)), (NEW,), limit_m=1.0)
    assert again.wires is not None and former.wires is not None
    moved = again.wires.offset_m - former.wires.offset_m
    np.testing.assert_allclose(moved[:3], 0.0, atol=1e-15)
    assert moved[3] == pytest.approx((measured - expected)[:, 3].mean())
    np.testing.assert_array_equal(again.wires.sites_m, former.wires.sites_m)
