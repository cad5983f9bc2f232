"""The body schema as everything but training uses it: numbers, names and three questions.

    lengths(theta, f)   mask 110: how long are the muscles?       (with its Jacobian dl/dtheta)
    estimate(f, l)      mask 011: where are the joints?
    tensions(theta, l)  mask 101: how strongly is pulled?         (ill-posed: not for control)

Beside the network a schema may carry the wires it was taught by (`wires.py`).

A `Schema` never changes. It travels and is kept as one safetensors blob with all that a reader
needs in its header; numpy alone serves it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load, save

from services.body_schema.folded import Folded
from services.body_schema.network import (
    ANGLES,
    LENGTHS,
    TENSIONS,
    Array,
    Mask,
    Weights,
    columns,
)
from services.body_schema.wires import Wires

KEY, FORMAT = "myograft", "body-schema-1"
LAYERS = 6
CORRELATION = "length_correlation"  # may be missing: older files know of none
ROUNDING = 1e-6


class SchemaError(ValueError):
    """Bytes or numbers that are no body schema; the text says in one sentence why."""


@dataclass(frozen=True, eq=False)
class Schema:
    """Network, scales and names. N joints, M muscles; arrays are float64 and read-only.

    Raises:
        SchemaError: shapes do not fit together, a number is not finite, a scale is not positive.
    """

    joints: tuple[str, ...]  # N
    muscles: tuple[str, ...]  # M, in the order of the columns
    weights: Weights  # six of ((out, in), (out,))
    theta_scale_rad: Array  # (N,)
    tension_scale_n: Array  # (M,)
    length_scale_m: Array  # (M,)
    length_reference_m: Array  # (M,): the length that enters as zero
    length_sigma_m: Array  # (M,): usual residual of mask 110
    angle_sigma_rad: Array  # (N,): usual residual of mask 011
    theta_range_rad: Array  # (N, 2): where it was learned
    tension_range_n: Array  # (M, 2): where it was learned
    meta: Mapping[str, str] = field(default_factory=dict)
    wires: Wires | None = None  # of these muscles and perhaps of others
    length_correlation: Array | None = None  # (M, M) of mask 110's residuals; None: independent

    def __post_init__(self) -> None:
        n, m = len(self.joints), len(self.muscles)
        if not n or not m or len({*self.joints, *self.muscles}) != n + m:
            raise SchemaError("a schema needs joints and muscles, each with a name of its own")
        for name, shape in _shapes(n, m).items():
            object.__setattr__(self, name, _checked(name, getattr(self, name), shape))
        object.__setattr__(self, "weights", _checked_weights(self.weights, n, m))
        if self.length_correlation is not None:
            kept = _checked_correlation(self.length_correlation, m)
            object.__setattr__(self, "length_correlation", kept)
        for name in ("theta_scale_rad", "tension_scale_n", "length_scale_m"):
            if not (getattr(self, name) > 0).all():
                raise SchemaError(f"{name} has to be positive")

    @property
    def residual_mm(self) -> dict[str, float]:
        """Muscle -> usual length residual [mm]."""
        sigmas = self.length_sigma_m * 1e3
        return {name: float(mm) for name, mm in zip(self.muscles, sigmas, strict=True)}

    def scaled(self, theta: Array, f: Array, length: Array) -> Array:
        """Samples as the network has them: (T, N), (T, M), (T, M) -> (T, N + 2 M)."""
        return np.hstack(
            (
                theta / self.theta_scale_rad,
                f / self.tension_scale_n,
                (length - self.length_reference_m) / self.length_scale_m,
            )
        )

    def with_wires(self, wires: Wires) -> Schema:
        """The same network, and the wires beside it."""
        return replace(self, wires=wires)

    # ── the three questions ──────────────────────────────────────────────────────────────────

    def lengths(self, theta: Array, f: Array) -> Array:
        """Mask 110. theta (N,) [rad], f (M,) [N] -> l (M,) [m]; or (B, N), (B, M) -> (B, M)."""
        return self._lengths(theta, f)

    def lengths_jacobian(self, theta: Array, f: Array) -> Array:
        """dl/dtheta (M, N) [m/rad] at theta (N,) [rad], f (M,) [N], f held: analytic."""
        return self.lengths_and_jacobian(theta, f)[1]

    def lengths_and_jacobian(self, theta: Array, f: Array) -> tuple[Array, Array]:
        """Mask 110: l (M,) [m] and dl/dtheta (M, N) [m/rad] at theta (N,) [rad], f (M,) [N]."""
        return self._lengths.with_jacobian(theta, f)

    def estimate(self, f: Array, length: Array) -> Array:
        """Mask 011. f (M,) [N], l (M,) [m] -> theta (N,) [rad]; or with a leading batch."""
        return self._angles(f, length)

    def tensions(self, theta: Array, length: Array) -> Array:
        """Mask 101. theta (N,) [rad], l (M,) [m] -> f (M,) [N]; or with a leading batch."""
        return self._tensions(theta, length)

    def reconstruct(
        self, theta: Array, f: Array, length: Array, mask: Mask
    ) -> tuple[Array, Array, Array]:
        """All outputs under one mask: theta (N,) [rad], f (M,) [N], l (M,) [m]."""
        a, b = [
            x for x, on in zip((theta, f, length), mask, strict=True) if on
        ]  # what the mask leaves out is not looked at
        y = self._fold(mask, (1, 1, 1))(a, b)
        c = columns(len(self.joints), len(self.muscles))
        return y[c.theta], y[c.tension], y[c.length]

    @cached_property
    def _lengths(self) -> Folded:
        return self._fold(LENGTHS, (0, 0, 1))

    @cached_property
    def _angles(self) -> Folded:
        return self._fold(ANGLES, (1, 0, 0))

    @cached_property
    def _tensions(self) -> Folded:
        return self._fold(TENSIONS, (0, 1, 0))

    def _fold(self, mask: Mask, wanted: tuple[int, int, int]) -> Folded:
        n, m = len(self.joints), len(self.muscles)
        c = columns(n, m)
        scale = np.concatenate((self.theta_scale_rad, self.tension_scale_n, self.length_scale_m))
        offset = np.concatenate((np.zeros(n + m), self.length_reference_m))
        inputs = np.flatnonzero(np.repeat(mask, (n, m, m)))
        outputs = np.flatnonzero(np.repeat(wanted, (n, m, m)))
        constant = np.zeros(c.mask.stop)
        constant[c.mask] = mask
        return Folded(
            self.weights,
            inputs=inputs,
            scale_in=scale[inputs],
            offset_in=offset[inputs],
            constant=constant,
            outputs=outputs,
            scale_out=scale[outputs],
            offset_out=offset[outputs],
        )

    # ── bytes ────────────────────────────────────────────────────────────────────────────────

    def to_bytes(self) -> bytes:
        """One safetensors blob; joints, muscles and meta stand in its header."""
        n, m = len(self.joints), len(self.muscles)
        tensors = {name: np.ascontiguousarray(getattr(self, name)) for name in _shapes(n, m)}
        if self.length_correlation is not None:
            tensors[CORRELATION] = np.ascontiguousarray(self.length_correlation)
        for layer, (w, b) in enumerate(self.weights):
            tensors[f"w{layer}"] = np.ascontiguousarray(w, dtype=np.float32)
            tensors[f"b{layer}"] = np.ascontiguousarray(b, dtype=np.float32)
        header = {
            "format": FORMAT,
            "joints": self.joints,
            "muscles": self.muscles,
            "meta": dict(self.meta),
            "wires": self.wires and self.wires.to_table(),
        }
        # one entry: safetensors writes several in random order, and equal schemas are equal bytes
        return save(tensors, {KEY: json.dumps(header, sort_keys=True)})

    @classmethod
    def from_bytes(cls, data: bytes) -> Schema:
        """The schema in a blob.

        Raises:
            SchemaError: truncated, foreign, of another format, or numbers that cannot be.
        """
        try:
            tensors = load(data)
            header = _header(data)
        except (SafetensorError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise SchemaError(f"not a whole file of this format: {error!r}") from error
        joints, muscles = _names(header, "joints"), _names(header, "muscles")
        try:
            arrays = {name: tensors[name] for name in _shapes(len(joints), len(muscles))}
            weights = tuple((tensors[f"w{i}"], tensors[f"b{i}"]) for i in range(LAYERS))
        except KeyError as error:
            raise SchemaError(f"the schema lacks the array {error}") from error
        meta = header.get("meta")
        if not isinstance(meta, dict):
            raise SchemaError("the schema's meta is no table of words")
        table = header.get("wires")
        try:
            wires = None if table is None else Wires.from_table(table)
        except ValueError as error:
            raise SchemaError(str(error)) from error
        return cls(
            joints=joints,
            muscles=muscles,
            weights=weights,
            meta=meta,
            wires=wires,
            length_correlation=tensors.get(CORRELATION),
            **arrays,
        )


def _shapes(n: int, m: int) -> dict[str, tuple[int, ...]]:
    return {
        "theta_scale_rad": (n,),
        "tension_scale_n": (m,),
        "length_scale_m": (m,),
        "length_reference_m": (m,),
        "length_sigma_m": (m,),
        "angle_sigma_rad": (n,),
        "theta_range_rad": (n, 2),
        "tension_range_n": (m, 2),
    }


def _checked(name: str, value: Array, shape: tuple[int, ...]) -> Array:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        raise SchemaError(f"{name} holds no numbers")
    array = array.astype(np.float64)  # a copy: nobody else can change it
    if array.shape != shape:
        raise SchemaError(f"{name} has shape {array.shape}, {shape} was expected")
    if not np.isfinite(array).all():
        raise SchemaError(f"{name} holds a number that is not finite")
    array.setflags(write=False)
    return array


def _checked_correlation(value: Array, m: int) -> Array:
    array = _checked(CORRELATION, value, (m, m))
    whole = np.allclose(array.diagonal(), 1.0) and np.allclose(array, array.T)
    if not whole or np.linalg.eigvalsh(array)[0] < -ROUNDING:
        raise SchemaError(f"{CORRELATION} is no matrix of correlations")
    return array


def _checked_weights(weights: Weights, n: int, m: int) -> Weights:
    if len(weights) != LAYERS:
        raise SchemaError(f"the network has {len(weights)} layers, {LAYERS} were expected")
    sizes = [n + 2 * m + 3, *(np.shape(b)[0] if np.ndim(b) == 1 else -1 for _, b in weights)]
    sizes[-1] = n + 2 * m
    return tuple(
        (
            _single(_checked(f"w{i}", w, (sizes[i + 1], sizes[i]))),
            _single(_checked(f"b{i}", b, (sizes[i + 1],))),
        )
        for i, (w, b) in enumerate(weights)
    )


def _single(array: Array) -> Array:
    """Rounded to single precision, in which weights are learned and kept."""
    rounded = array.astype(np.float32).astype(np.float64)
    rounded.setflags(write=False)
    return rounded


def _header(data: bytes) -> dict[str, Any]:
    size = int.from_bytes(data[:8], "little")
    entries = json.loads(data[8 : 8 + size]).get("__metadata__", {})
    header = json.loads(entries.get(KEY, "{}"))
    if header.get("format") != FORMAT:
        raise ValueError(f"its format is {header.get('format')}, this program reads {FORMAT}")
    return dict(header)


def _names(header: dict[str, Any], key: str) -> tuple[str, ...]:
    names = header.get(key)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise SchemaError(f"the schema does not name its {key}")
    return tuple(names)
