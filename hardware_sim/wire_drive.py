"""Winding motors and elastic elements of all wires: the physics between module and body.

One motor winds one wire on a spool. Its speed follows the command with a lag, falls with tension as
a DC motor's does, and its winding warms with the square of the tension. The elastic element in
series stretches by e when the wire carries f = a e + b e^2 + c e^3. The constants are the robot
file's, `[simulation]`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware_sim.compiled import NUMBER, VECTOR, compiled, records
from runtime.settings import Simulation

Array = NDArray[np.float64]

MOTOR = np.dtype(
    [
        ("speed_m_s", np.float64),
        ("temperature_degc", np.float64),
        ("peak_speed_m_s", np.float64),
        ("peak_tension_n", np.float64),
    ]
)


class WireDrive:
    """Motors of M wires. Arrays have shape (M,), and are stale after `add` and `remove`.

    Attributes:
        speed_m_s: wire paid out per second; negative winds.
        temperature_degc: of the motor windings.
        peak_speed_m_s, peak_tension_n: greatest so far; of speed, either way.
    """

    def __init__(self, count: int, speed_limit_m_s: float, constants: Simulation) -> None:
        self._constants = constants
        self._limit_m_s = speed_limit_m_s
        self._use(np.array([self._cold()] * count, MOTOR))

    def _cold(self) -> tuple[float, float, float, float]:
        return (0.0, self._constants.ambient_degc, 0.0, 0.0)

    def add(self) -> None:
        """One more motor, at rest and cold."""
        new = np.array([self._cold()], MOTOR)
        self._use(np.append(self._motors, new))

    def remove(self, index: int) -> None:
        """Take one motor away."""
        self._use(np.delete(self._motors, index))

    def step(self, dt_s: float, command_m_s: Array, tension_n: Array, wire_m: Array) -> None:
        """Follow winding-speed commands for `dt_s`: adds to the lengths of wire, `wire_m`."""
        lag_s, stall_n = self._constants.motor_lag_s, self._constants.stall_tension_n
        _wind(self._motors, dt_s, self._limit_m_s, lag_s, stall_n, command_m_s, tension_n, wire_m)

    def warm(self, dt_s: float, tension_n: Array) -> None:
        """Let the windings warm or cool for `dt_s`, short against their thermal time."""
        x = self._constants
        rise = x.heating_degc_n2 * tension_n * tension_n + x.ambient_degc - self.temperature_degc
        self.temperature_degc += rise * (dt_s / x.thermal_time_s)

    def _use(self, motors: NDArray[np.void]) -> None:
        self._motors = motors
        self.speed_m_s = motors["speed_m_s"]
        self.temperature_degc = motors["temperature_degc"]
        self.peak_speed_m_s = motors["peak_speed_m_s"]
        self.peak_tension_n = motors["peak_tension_n"]


@compiled(NUMBER, NUMBER, NUMBER, NUMBER)
def elastic_tension_n(stretch_m: float, a: float, b: float, c: float) -> float:
    """Tension of the elastic element at a stretch; a slack wire carries none."""
    e = max(stretch_m, 0.0)
    return ((c * e + b) * e + a) * e


@compiled(VECTOR, VECTOR, VECTOR, NUMBER, NUMBER, NUMBER, NUMBER, VECTOR, VECTOR)
def stretch_wires(
    path_m: Array,
    wire_m: Array,
    stiffness: Array,
    a: float,
    b: float,
    c: float,
    friction: float,
    tension_n: Array,
    friction_n: Array,
) -> None:
    """What M wires carry, and how much of it their guides can hold.

    Args:
        path_m, wire_m: geometric length of the path, and of the wire that is paid out.
        stiffness: of each elastic element over the usual one's; 0 is a torn wire.
        a, b, c: the usual elastic curve.
        friction: at the guides, as a share of the tension.
        tension_n, friction_n: the results.
    """
    for i in range(len(path_m)):
        tension = elastic_tension_n(path_m[i] - wire_m[i], a, b, c) * stiffness[i]
        tension_n[i] = tension
        friction_n[i] = tension * friction


def elastic_stretch_m(tension_n: float, curve: tuple[float, float, float]) -> float:
    """Inverse of `elastic_tension_n` for one tension >= 0."""
    a, b, c = curve
    roots = np.roots([c, b, a, -tension_n])
    return float(min(r.real for r in roots if abs(r.imag) < 1e-9 and r.real >= -1e-12))


@compiled(records(MOTOR), NUMBER, NUMBER, NUMBER, NUMBER, VECTOR, VECTOR, VECTOR)
def _wind(
    motors: Any,
    dt_s: float,
    limit_m_s: float,
    lag_s: float,
    stall_n: float,
    command_m_s: Array,
    tension_n: Array,
    wire_m: Array,
) -> None:
    for i in range(len(motors)):
        motor = motors[i]
        change = (command_m_s[i] - motor.speed_m_s) * (dt_s / (lag_s + dt_s))
        winding = tension_n[i] * (limit_m_s / stall_n) - limit_m_s
        speed = max(motor.speed_m_s + change, min(winding, 0.0))  # at stall it winds no more
        motor.speed_m_s = speed = min(speed, limit_m_s)
        wire_m[i] += speed * dt_s
        motor.peak_speed_m_s = max(motor.peak_speed_m_s, abs(speed))
        motor.peak_tension_n = max(motor.peak_tension_n, tension_n[i])
