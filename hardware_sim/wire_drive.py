"""Winding motors and elastic elements of all wires: the physics between module and body.

One motor winds one wire on a spool. Its speed follows the command with a lag, falls with tension as
a DC motor's does, and its winding warms with the square of the tension. The elastic element in
series stretches by e when the wire carries f = a e + b e^2 + c e^3. Constants marked assumed are
not public for the robots we model.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LAG_S = 0.004  # speed loop of the motor driver (assumed)
STALL_TENSION_N = 450.0  # tension at which the motor can no longer wind (assumed)
HEATING_DEGC_N2 = 0.0075  # steady rise per squared tension: 27 degC at 60 N (assumed)
THERMAL_TIME_S = 240.0  # of the winding (assumed)


class WireDrive:
    """Motors of M wires. Arrays have shape (M,) and grow by `add`.

    Attributes:
        speed_m_s: wire paid out per second; negative winds.
        temperature_degc: of the motor windings.
    """

    def __init__(self, count: int, speed_limit_m_s: float, ambient_degc: float) -> None:
        self.speed_limit_m_s = speed_limit_m_s
        self.ambient_degc = ambient_degc
        self.speed_m_s = np.zeros(count)
        self.temperature_degc = np.full(count, ambient_degc)

    def add(self) -> None:
        """One more motor, at rest and cold."""
        self.speed_m_s = np.append(self.speed_m_s, 0.0)
        self.temperature_degc = np.append(self.temperature_degc, self.ambient_degc)

    def remove(self, index: int) -> None:
        """Take one motor away."""
        self.speed_m_s = np.delete(self.speed_m_s, index)
        self.temperature_degc = np.delete(self.temperature_degc, index)

    def step(self, dt_s: float, command_m_s: Array, tension_n: Array) -> Array:
        """Follow winding-speed commands for `dt_s`; returns the wire paid out [m], shape (M,)."""
        v = self.speed_m_s
        v += (command_m_s - v) * (dt_s / (LAG_S + dt_s))
        winding = self.speed_limit_m_s * np.maximum(1.0 - tension_n / STALL_TENSION_N, 0.0)
        np.minimum(np.maximum(v, -winding, out=v), self.speed_limit_m_s, out=v)
        rise = HEATING_DEGC_N2 * tension_n * tension_n + self.ambient_degc - self.temperature_degc
        self.temperature_degc += rise * (dt_s / THERMAL_TIME_S)
        return v * dt_s


def elastic_tension_n(stretch_m: Array, curve: tuple[float, float, float]) -> Array:
    """Tension of the elastic element at a stretch; a slack wire carries none. Shape (M,)."""
    a, b, c = curve
    e = np.maximum(stretch_m, 0.0)
    return e * (a + e * (b + e * c))


def elastic_stretch_m(tension_n: float, curve: tuple[float, float, float]) -> float:
    """Inverse of `elastic_tension_n` for one tension >= 0."""
    a, b, c = curve
    roots = np.roots([c, b, a, -tension_n])
    return float(min(r.real for r in roots if abs(r.imag) < 1e-9 and r.real >= -1e-12))
