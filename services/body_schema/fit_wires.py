"""Wires from motion: where the sites are, where the encoder began, how the elastic element gives.

Maximum a posteriori by Gauss-Newton. The joints are measured, so every muscle is a problem of its
own, of ten or twenty unknowns:

    data    l - model(theta, f) in the samples in which the wire is taut, robustly (soft L1)
    old     what h_old says at random (theta, f), weighted by how far it is off on the new motion
    prior   sites about their nominal places, elastic elements about the others'
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from services.body_schema.motions import SLACK_N, TrainingError, check_samples
from services.body_schema.network import Array
from services.body_schema.schema import Schema
from services.body_schema.wires import STRETCH_TERMS, Geometry, Wires, stretch_terms

DATA_SIGMA_M = 0.15e-3  # sensors and what the model leaves out, beside a sample's tension noise
TENSION_SIGMA_N = 0.3
VIRTUAL_SIGMA_M = 0.3e-3  # what h_old is off by anyway
MISFIT_COUNTS = 10.0  # h_old is off in one way everywhere: its samples are no independent witnesses
SAMPLES = 500  # of new motion: neighbours say the same
ROUNDS = 12
DONE_M = 1e-6


@dataclass(frozen=True)
class Beliefs:
    """What is believed before anything moved, as standard deviations, and who else is asked.

    Attributes:
        site_sigma_m: each way, of hands that fix a module where it nominally is.
        offset_sigma_m: nobody knows where an encoder began.
        stretch_mean_m, stretch_sigma_m: (K,) of the terms of an element of which nothing is known.
        element_share: a newcomer's element differs from the others' mean by this share ...
        element_sigma_m: (K,) ... and each of its terms by this.
        virtual: samples that h_old is asked for.
        outlier: a residual of so many deviations counts little more if it is greater.
    """

    site_sigma_m: float = 0.005
    offset_sigma_m: float = 1.0
    stretch_mean_m: tuple[float, ...] = (0.001, 0.0, 0.003, 0.0)
    stretch_sigma_m: tuple[float, ...] = (0.005,) * STRETCH_TERMS
    element_share: float = 0.5
    element_sigma_m: tuple[float, ...] = (0.3e-3,) * STRETCH_TERMS
    virtual: int = 120
    outlier: float = 1.0


USUAL = Beliefs()


@dataclass(frozen=True, eq=False)
class Weighed:
    """theta (T, N) [rad], f (T, M) [N], l (T, M) [m], each length with its deviation."""

    theta: Array
    f: Array
    length: Array
    sigma: Array  # (T, M) [m]; inf where nothing is known

    def __add__(self, other: Weighed) -> Weighed:
        return Weighed(
            np.concatenate((self.theta, other.theta)),
            np.concatenate((self.f, other.f)),
            np.concatenate((self.length, other.length)),
            np.concatenate((self.sigma, other.sigma)),
        )


def fit_wires(
    geometry: Geometry,
    theta: Array,
    f: Array,
    length: Array,
    old: Schema | None = None,
    *,
    beliefs: Beliefs = USUAL,
    seed: int = 0,
) -> Wires:
    """Wires of M muscles from samples theta (T, N) [rad], f (T, M) [N], length (T, M) [m].

    The columns are those of `geometry.muscles`. `old`, if given, knows some of the muscles.

    Raises:
        TrainingError: nothing to learn from, or see `check_samples`.
    """
    check_samples(theta, f, length)
    if not len(theta):
        raise TrainingError("no motion to learn the wires from")
    rng = np.random.default_rng(seed)
    every = max(1, len(theta) // SAMPLES)
    data = _measured(theta[::every], f[::every], length[::every])
    if old is not None:
        data = data + _virtual(old, geometry.muscles, data, beliefs.virtual, rng)
    sites, offset, stretch = _start(geometry, data, beliefs)
    prior = stretch.copy(), np.diag(1.0 / np.square(beliefs.stretch_sigma_m))
    known = np.array([old is not None and name in old.muscles for name in geometry.muscles])
    for stage in (known, ~known):  # the newcomers' elements are expected to be like the others'
        if not stage.any():
            continue
        _descend(geometry, data, sites, offset, stretch, prior, stage, beliefs)
        if stage is known:
            prior = _like(stretch[known].mean(axis=0), len(known), beliefs)
    return Wires(geometry.muscles, geometry.paths, sites, offset, stretch)


def _measured(theta: Array, f: Array, length: Array) -> Weighed:
    """Sensor noise in metres; a slack wire's length says nothing."""
    compliance = 0.008 / (np.maximum(f, SLACK_N) + 8.0)  # m/N of a usual element
    sigma = np.hypot(DATA_SIGMA_M, compliance * TENSION_SIGMA_N)
    return Weighed(theta, f, length, np.where(f >= SLACK_N, sigma, np.inf))


def _virtual(
    old: Schema, muscles: Sequence[str], data: Weighed, count: int, rng: np.random.Generator
) -> Weighed:
    """What h_old says where it was learned, trusted as far as it is right on the new motion."""
    columns = [muscles.index(name) for name in old.muscles]
    low, high = old.theta_range_rad.T
    weak, strong = old.tension_range_n.T
    theta = rng.uniform(low, high, (count, len(low)))
    share = rng.uniform(size=(count, len(weak))) ** 2  # more where elements are soft
    f_old = np.maximum(weak + share * (strong - weak), SLACK_N)
    off = data.length[:, columns] - old.lengths(data.theta, data.f[:, columns])
    known = np.isfinite(data.sigma[:, columns])
    misfit = np.sqrt((off**2 * known).sum(axis=0) / np.maximum(known.sum(axis=0), 1))  # (M_old,)
    f = np.full((count, len(muscles)), SLACK_N)
    length = np.zeros_like(f)
    sigma = np.full_like(f, np.inf)
    f[:, columns] = f_old
    length[:, columns] = old.lengths(theta, f_old)
    excess = np.sqrt(np.maximum(misfit**2 - VIRTUAL_SIGMA_M**2, 0.0))
    sigma[:, columns] = np.hypot(VIRTUAL_SIGMA_M, MISFIT_COUNTS * excess)
    return Weighed(theta, f, length, sigma)


def _start(geometry: Geometry, data: Weighed, beliefs: Beliefs) -> tuple[Array, Array, Array]:
    """Nominal sites, usual elements, and the offset that fits best to them."""
    m = len(geometry.muscles)
    sites = geometry.sites_m.copy()
    stretch = np.tile(beliefs.stretch_mean_m, (m, 1))
    geometry.place(sites)
    path = np.array([geometry.lengths(t) for t in data.theta])
    off = data.length - path + np.vecdot(stretch_terms(data.f), stretch)
    offset = np.zeros(m)
    for k in range(m):
        known = np.isfinite(data.sigma[:, k])
        if not known.any():
            raise TrainingError(f"{geometry.muscles[k]} was never taut: nothing is known of it")
        offset[k] = np.median(off[known, k])
    return sites, offset, stretch


def _like(mean: Array, count: int, beliefs: Beliefs) -> tuple[Array, Array]:
    """Mean (M, K) and information (K, K) of elements of the known ones' kind, about as soft."""
    apart = np.diag(np.square(beliefs.element_sigma_m))
    covariance = beliefs.element_share**2 * np.outer(mean, mean) + apart
    return np.tile(mean, (count, 1)), np.asarray(np.linalg.inv(covariance))


def _descend(
    geometry: Geometry,
    data: Weighed,
    sites: Array,
    offset: Array,
    stretch: Array,
    prior: tuple[Array, Array],
    wanted: Array,
    beliefs: Beliefs,
) -> None:
    """Gauss-Newton for all wanted muscles at once, in place."""
    terms = stretch_terms(data.f)  # (T, M, K)
    mean, information = prior
    nominal = geometry.sites_m
    stretch[wanted] = mean[wanted]
    for _ in range(ROUNDS):
        geometry.place(sites)
        path, slopes = geometry.lengths_and_site_slopes(data.theta)
        moved = 0.0
        for k in np.flatnonzero(wanted):
            own = np.flatnonzero(geometry.wire_of_site == k)
            known = np.isfinite(data.sigma[:, k])
            sigma = data.sigma[known, k]
            model = path[known, k] + offset[k] - terms[known, k] @ stretch[k]
            residual = (data.length[known, k] - model) / sigma
            # the square root of soft L1's weight
            robust = (1.0 + (residual / beliefs.outlier) ** 2) ** -0.25
            columns = np.hstack(
                (
                    slopes[known][:, own].reshape(len(sigma), -1),
                    np.ones((len(sigma), 1)),
                    -terms[known, k],
                )
            )
            a = columns * (robust / sigma)[:, None]
            hessian = a.T @ a
            slope = a.T @ (residual * robust)
            s = 3 * len(own)
            pull = (nominal[own] - sites[own]).ravel() / beliefs.site_sigma_m**2
            hessian[np.arange(s), np.arange(s)] += beliefs.site_sigma_m**-2
            slope[:s] += pull
            hessian[s, s] += beliefs.offset_sigma_m**-2
            hessian[s + 1 :, s + 1 :] += information
            slope[s + 1 :] += information @ (mean[k] - stretch[k])
            step = np.linalg.solve(hessian, slope)
            site_step = step[:s].reshape(-1, 3)
            size = float(np.abs(site_step).max())
            share = min(1.0, 0.01 / size) if size else 1.0  # no site jumps over a bone
            sites[own] += share * site_step
            offset[k] += share * step[s]
            stretch[k] += share * step[s + 1 :]
            moved = max(moved, size)
        if moved < DONE_M:
            break
    geometry.place(sites)
