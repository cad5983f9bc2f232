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

# numpy takes an array of no dimension at half the price of a float
_NOTHING = np.array(0.0)


class WireDrive:
    """Motors of M wires. Arrays have shape (M,) and grow by `add`.

    Attributes:
        speed_m_s: wire paid out per second; negative winds.
        temperature_degc: of the motor windings.
    """

    def __init__(
        self,
        count: int,
        speed_limit_m_s: float,
        ambient_degc: float,
        heating_degc_n2: float = HEATING_DEGC_N2,
    ) -> None:
        self.ambient_degc = ambient_degc
        self._heating = heating_degc_n2
        self._limit_m_s = np.array(speed_limit_m_s)
        self._slowing_m_s_n = np.array(speed_limit_m_s / STALL_TENSION_N)
        self.speed_m_s = np.zeros(count)
        self.temperature_degc = np.full(count, ambient_degc)
        self._resize()

    def add(self) -> None:
        """One more motor, at rest and cold."""
        self.speed_m_s = np.append(self.speed_m_s, 0.0)
        self.temperature_degc = np.append(self.temperature_degc, self.ambient_degc)
        self._resize()

    def remove(self, index: int) -> None:
        """Take one motor away."""
        self.speed_m_s = np.delete(self.speed_m_s, index)
        self.temperature_degc = np.delete(self.temperature_degc, index)
        self._resize()

    def step(self, dt_s: float, command_m_s: Array, tension_n: Array) -> Array:
        """Follow winding-speed commands for `dt_s`.

        Returns:
            The wire paid out [m], (M,); overwritten by the next call.
        """
        speed, change, winding = self.speed_m_s, self._change, self._winding
        np.subtract(command_m_s, speed, out=change)
        change *= dt_s / (LAG_S + dt_s)
        speed += change
        np.multiply(tension_n, self._slowing_m_s_n, out=winding)
        winding -= self._limit_m_s
        np.minimum(winding, _NOTHING, out=winding)  # at stall it winds no more
        np.maximum(speed, winding, out=speed)
        np.minimum(speed, self._limit_m_s, out=speed)
        return np.multiply(speed, dt_s, out=change)

    def warm(self, dt_s: float, tension_n: Array) -> None:
        """Let the windings warm or cool for `dt_s`, short against `THERMAL_TIME_S`."""
        rise = self._heating * tension_n * tension_n + self.ambient_degc - self.temperature_degc
        self.temperature_degc += rise * (dt_s / THERMAL_TIME_S)

    def _resize(self) -> None:
        self._change, self._winding = np.zeros((2, len(self.speed_m_s)))


def elastic_tension_n(stretch_m: Array, curve: tuple[float, float, float]) -> Array:
    """Tension of the elastic element at a stretch; a slack wire carries none. Shape (M,)."""
    a, b, c = curve
    e = np.maximum(stretch_m, _NOTHING)
    tension: Array = e * c
    tension += b
    tension *= e
    tension += a
    tension *= e
    return tension


def elastic_stretch_m(tension_n: float, curve: tuple[float, float, float]) -> float:
    """Inverse of `elastic_tension_n` for one tension >= 0."""
    a, b, c = curve
    roots = np.roots([c, b, a, -tension_n])
    return float(min(r.real for r in roots if abs(r.imag) < 1e-9 and r.real >= -1e-12))
