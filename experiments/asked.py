"""Who is asked where the joints are, from tension and length alone.

011                 the schema's network by itself
estimator           as the robot has it: mask 011 refined by the lengths of mask 110
..., h_old          the same of the paper's network, before it is sharpened (`train.sharpened`)
direct              a plain network for this one question, learned from the same samples
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from experiments.collect import Array, Recording
from experiments.direct import learn_direct
from experiments.learn import recipe_for, taut
from experiments.watched import Watched
from runtime.messages import Motion
from services.body_schema.motions import taut_samples
from services.body_schema.posture import posture
from services.body_schema.schema import Schema
from services.body_schema.widen import narrowed

Told = tuple[Array, Array | None]  # angles (T, N) [rad], and their confidence if there is one
Asked = dict[str, Callable[[Watched], Told]]
LIVE, DIRECT = "estimator", "direct"


def of_first_schema(
    shipped: Schema, old: Schema, recording: Recording, seed: int, *, quick: bool
) -> Asked:
    """Of a robot as it is shipped, and of h_old; the recording is what both are learned from."""
    theta, f, length, held = taut(recording)
    samples = theta[~held], f[~held], length[~held]
    recipe = recipe_for(len(shipped.joints), quick=quick)
    return {
        "011": _by_mask(shipped),
        LIVE: _as_published,
        "011, h_old": _by_mask(old),
        f"{LIVE}, h_old": _refined(old),
        DIRECT: _direct(learn_direct(old, *samples, recipe, seed)),
    }


def of_grown_schema(grown: Schema, motions: tuple[Motion, ...], seed: int, *, quick: bool) -> Asked:
    """Of a robot that has grown by these motions."""
    from services.body_schema.train import NEW

    samples = taut_samples(motions, len(grown.joints), len(grown.muscles))
    recipe = replace(NEW, steps=NEW.steps // 10, passes=1) if quick else NEW
    return {
        "011": _by_mask(grown),
        LIVE: _as_published,
        DIRECT: _direct(learn_direct(narrowed(grown), *samples, recipe, seed)),
    }


def _by_mask(schema: Schema) -> Callable[[Watched], Told]:
    return lambda seen: (schema.estimate(seen.tension_n, seen.length_m), None)


def _direct(estimate: Callable[[Array, Array], Array]) -> Callable[[Watched], Told]:
    return lambda seen: (estimate(seen.tension_n, seen.length_m), None)


def _as_published(seen: Watched) -> Told:
    return seen.estimate_rad, seen.sigma_rad


def _refined(schema: Schema) -> Callable[[Watched], Told]:
    def ask(seen: Watched) -> Told:
        rows = zip(seen.tension_n, seen.length_m, strict=True)
        found = [posture(schema, f, length) for f, length in rows]
        return np.array([x.angle_rad for x in found]), np.array([x.sigma_rad for x in found])

    return ask
