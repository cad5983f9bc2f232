"""A first body schema from a drawing instead of motion: what the robot is believed to be like.

As the paper's authors start: wires run where the drawing says, off by centimetres, nothing rubs;
then a little motion of the robot refines what was learned from it. The wires go with the schema,
fitted to the same motion, so that whoever goes on from here knows the same.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from experiments.trial import Collected, collect_again
from hardware_sim.wire_drive import elastic_stretch_m
from runtime.settings import RobotSettings
from services.body_schema import train
from services.body_schema.motions import SLACK_N
from services.body_schema.network import Array
from services.body_schema.schema import Schema
from services.body_schema.wires import WireModel, Wires, stretch_terms
from services.logic.relearning import fitted, known_paths
from services.logic.wiring import Wiring, nominal_paths

SAMPLES = 25_000
STRONGEST_N = 100.0
REST_N = 8.0  # tension at which lengths were zeroed
REFINE_SEED = 1000  # and up: of robots that refine, which no experiment tries anything on


def displaced_wires(settings: RobotSettings, error_m: float, seed: int) -> WireModel:
    """The robot's wires with every site `error_m` off, each in a random direction."""
    paths = nominal_paths(settings.body_file)
    wiring = Wiring(settings.body_file, settings.joints, {n: paths[n] for n in settings.muscles})
    rng = np.random.default_rng([seed, 7])
    away = rng.normal(size=wiring.sites_m.shape)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    sites = wiring.sites_m + error_m * away
    wiring.place(sites)
    count = len(wiring.muscles)
    stretch = np.tile(_stretch(settings.simulation.elastic_n_m), (count, 1))
    rest = np.radians([joint.rest_deg for joint in settings.joint])
    at_rest = np.vecdot(stretch_terms(np.full(count, REST_N)), stretch)
    offset = at_rest - wiring.lengths(rest)
    wires = Wires(wiring.muscles, wiring.paths, sites, offset, stretch)
    return WireModel(wires, wiring, settings.joints)


def learn_drawn(
    settings: RobotSettings,
    error_m: float,
    seed: int = 0,
    *,
    quick: bool = False,
    progress: Callable[[int, int, float, float, float], None] | None = None,
) -> Schema:
    """h_old of the drawing."""
    model = displaced_wires(settings, error_m, seed)
    theta, f = _samples(settings, len(model.muscles), np.random.default_rng([seed, 8]))
    schema = train.train_old(
        model.joints,
        model.muscles,
        theta,
        f,
        model.lengths(theta, f),
        seed=seed,
        recipe=replace(train.OLD, steps=train.OLD.steps // 10) if quick else train.OLD,
        progress=progress,
    )
    return schema.with_wires(model.wires)


def refine_drawn(
    settings: RobotSettings,
    drawn: Schema,
    motions: int,
    seed: int = 0,
    *,
    quick: bool = False,
    progress: Callable[[int, int, float, float, float], None] | None = None,
) -> tuple[Schema, Collected]:
    """h_old of the drawing after a little motion: network by method (iii), wires fitted.

    Raises:
        SessionError: the drawing is so far off that the robot cannot move.
        TrainingError: no wire was taut.
    """
    network = replace(drawn, wires=None)
    collected = collect_again(settings, REFINE_SEED + seed, network, motions)
    paths = known_paths(drawn, settings)
    model = fitted(drawn, collected.new, drawn.muscles, settings, paths, seed)
    recipe = replace(train.NEW, steps=train.NEW.steps // 10, passes=1) if quick else train.NEW
    refined = train.relearn(
        network, collected.new, "", "iii", seed=seed, recipe=recipe, progress=progress
    )
    return refined.with_wires(model.wires), collected


def _samples(
    settings: RobotSettings, muscles: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    from services.logic.skeleton import Skeleton

    low, high = Skeleton(settings.body_file, settings.joints).range_rad.T
    theta = rng.uniform(low, high, (SAMPLES, len(low)))
    f = SLACK_N + (STRONGEST_N - SLACK_N) * rng.uniform(size=(SAMPLES, muscles)) ** 2
    return theta, f


def _stretch(curve: tuple[float, float, float]) -> Array:
    """Weights of `stretch_terms` that follow an element's data sheet."""
    f = np.linspace(SLACK_N, STRONGEST_N, 200)
    e = np.array([elastic_stretch_m(x, curve) for x in f.tolist()])
    weights, *_ = np.linalg.lstsq(stretch_terms(f), e, rcond=None)
    return np.asarray(weights)
