"""The structured body schema: wires on the known skeleton, elastic elements in series.

    l = path(theta; sites) + c - e(f)

`path` is the shortest way over a wire's sites and around bones, `c` where the module's encoder
began, `e` the stretch of the elastic element. Few numbers, and each muscle has its own: that is
why a handful of motions is enough to know them (`fit_wires.py`). It answers the same questions as
the network, and it is the network's teacher.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Protocol

import msgspec
import numpy as np

from runtime.messages import MusclePath, Place
from services.body_schema.network import Array

KNEES_N = (4.0, 16.0, 64.0)
STRETCH_TERMS = 1 + len(KNEES_N)


class Geometry(Protocol):
    """Paths on the skeleton, for M wires of P sites and N joints (`logic/wiring.py`)."""

    muscles: tuple[str, ...]
    paths: tuple[MusclePath, ...]  # nominal
    sites_m: Array  # (P, 3) nominal
    wire_of_site: Any  # (P,) int

    def place(self, sites_m: Array) -> None:
        """Lead all wires over these sites (P, 3)."""

    def lengths(self, theta: Array) -> Array:
        """(M,) [m] at theta (N,) [rad]."""

    def lengths_and_jacobian(self, theta: Array) -> tuple[Array, Array]:
        """(M,) [m] and (M, N) [m/rad] at theta (N,) [rad]."""

    def lengths_and_site_slopes(self, theta: Array) -> tuple[Array, Array]:
        """At theta (T, N) [rad]: (T, M) [m], and its slope by a wire's own sites (T, P, 3)."""


def stretch_terms(f: Array) -> Array:
    """Terms of an elastic element's stretch at tensions f (..., M) -> (..., M, K).

    e(f) = sum of w_k times these: a straight line and logarithms, which between them follow any
    element that gets stiffer with load to a few hundredths of a millimetre.
    """
    f = np.maximum(f, 0.0)
    return np.stack([f / 100.0, *(np.log1p(f / knee) for knee in KNEES_N)], axis=-1)


@dataclass(frozen=True, eq=False)
class Wires:
    """What is known of M wires; `sites_m` are the fixed places of all paths in their order."""

    muscles: tuple[str, ...]
    paths: tuple[MusclePath, ...]  # nominal; `sites_m` says where the places really are
    sites_m: Array  # (P, 3), link's frame
    offset_m: Array  # (M,)
    stretch_m: Array  # (M, K) weights of `stretch_terms`

    def to_table(self) -> dict[str, Any]:
        """As plain types that `from_table` reads."""
        return {
            "muscles": self.muscles,
            "paths": msgspec.to_builtins(self.paths),
            "sites_m": self.sites_m.tolist(),
            "offset_m": self.offset_m.tolist(),
            "stretch_m": self.stretch_m.tolist(),
        }

    @staticmethod
    def from_table(table: Any) -> Wires:
        """The wires in a table.

        Raises:
            ValueError: no wires, or numbers that do not fit together.
        """
        try:
            wires = Wires(
                msgspec.convert(table["muscles"], tuple[str, ...]),
                msgspec.convert(table["paths"], tuple[MusclePath, ...]),
                np.array(table["sites_m"], dtype=float).reshape(-1, 3),
                np.array(table["offset_m"], dtype=float),
                np.array(table["stretch_m"], dtype=float),
            )
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"these are no wires: {error!r}") from error
        m = len(wires.muscles)
        if len({*wires.muscles}) != m:
            raise ValueError("a muscle has two wires")
        numbers = (wires.sites_m, wires.offset_m, wires.stretch_m)
        shapes = [(int(wires.first_site[-1]), 3), (m,), (m, STRETCH_TERMS)]
        if len(wires.paths) != m or [x.shape for x in numbers] != shapes:
            raise ValueError("the wires' numbers do not fit together")
        if not all(np.isfinite(x).all() for x in numbers):
            raise ValueError("a number of the wires is not finite")
        return wires

    @property
    def first_site(self) -> Any:
        """(M + 1,): wire k has the sites first_site[k] to first_site[k + 1]."""
        return np.cumsum([0, *(fixed_places(path) for path in self.paths)])

    def of(self, muscles: tuple[str, ...]) -> Wires:
        """These muscles' wires, in this order.

        Raises:
            ValueError: one is not there.
        """
        order = [self.muscles.index(name) for name in muscles]
        first = self.first_site
        sites = [self.sites_m[first[k] : first[k + 1]] for k in order]
        return Wires(
            muscles,
            tuple(self.paths[k] for k in order),
            np.concatenate(sites),
            self.offset_m[order],
            self.stretch_m[order],
        )

    def shifted(self, offset_m: Mapping[str, float]) -> Wires:
        """The wires of modules whose encoders began elsewhere, by so much more [m]."""
        more = np.array([offset_m.get(name, 0.0) for name in self.muscles])
        return replace(self, offset_m=self.offset_m + more)

    def moved_paths(self) -> dict[str, MusclePath]:
        """The paths with their sites where they were found to be: muscle -> path."""
        sites = iter(self.sites_m.tolist())

        def there(place: Place) -> Place:
            if place.wrap:
                return place
            x, y, z = next(sites)
            return msgspec.structs.replace(place, position_m=(x, y, z))

        return {
            name: msgspec.structs.replace(
                path,
                attachment=there(path.attachment),
                relays=tuple(there(place) for place in path.relays),
            )
            for name, path in zip(self.muscles, self.paths, strict=True)
        }


def fixed_places(path: MusclePath) -> int:
    """How many of a path's places are sites on a link."""
    return sum(not place.wrap for place in (path.attachment, *path.relays))


class WireModel:
    """The questions of `Schema`, answered by wires on a skeleton."""

    def __init__(self, wires: Wires, geometry: Geometry, joints: tuple[str, ...]) -> None:
        self.wires = wires
        self.joints = joints
        self.muscles = wires.muscles
        self._geometry = geometry
        geometry.place(wires.sites_m)

    def lengths(self, theta: Array, f: Array) -> Array:
        """As `Schema.lengths`."""
        if theta.ndim == 1:
            path = self._geometry.lengths(theta)
        else:
            path = np.array([self._geometry.lengths(row) for row in theta]).reshape(f.shape)
        return path + self._beside_path(f)

    def lengths_jacobian(self, theta: Array, f: Array) -> Array:
        """As `Schema.lengths_jacobian`."""
        return self.lengths_and_jacobian(theta, f)[1]

    def lengths_and_jacobian(self, theta: Array, f: Array) -> tuple[Array, Array]:
        """As `Schema.lengths_and_jacobian`."""
        path, jacobian = self._geometry.lengths_and_jacobian(theta)
        return path + self._beside_path(f), jacobian

    def _beside_path(self, f: Array) -> Array:
        stretch = np.vecdot(stretch_terms(f), self.wires.stretch_m)
        return np.asarray(self.wires.offset_m - stretch)
