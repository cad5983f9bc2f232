"""Winding motors and elastic elements of all wires: the physics between module and body.

One motor winds one wire on a spool. Its speed follows the command with a lag, falls with tension as
a DC motor's does, and its winding warms with the square of the tension. The elastic element in
series stretches by e when the wire carries f = a e + b e^2 + c e^3. Constants marked assumed are
not public for the robots we model.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware_sim.compiled import NUMBER, VECTOR, compiled, records

Array = NDArray[np.float64]

LAG_S = 0.004  # speed loop of the motor driver (assumed)
STALL_TENSION_N = 450.0  # tension at which the motor can no longer wind (assumed)
HEATING_DEGC_N2 = 0.0075  # steady rise per squared tension: 27 degC at 60 N (assumed)
THERMAL_TIME_S = 240.0  # of the winding (assumed)

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

    def __init__(
        self,
        count: int,
        speed_limit_m_s: float,
        ambient_degc: float,
        heating_degc_n2: float = HEATING_DEGC_N2,
    ) -> None:
        self.ambient_degc = ambient_degc
        self._heating = heating_degc_n2
        self._limit_m_s = speed_limit_m_s
        self._use(np.array([(0.0, ambient_degc, 0.0, 0.0)] * count, MOTOR))

    def add(self) -> None:
        """One more motor, at rest and cold."""
        new = np.array([(0.0, self.ambient_degc, 0.0, 0.0)], MOTOR)
        self._use(np.append(self._motors, new))

    def remove(self, index: int) -> None:
        """Take one motor away."""
        self._use(np.delete(self._motors, index))

    def step(self, dt_s: float, command_m_s: Array, tension_n: Array, wire_m: Array) -> None:
        """Follow winding-speed commands for `dt_s`: adds to the lengths of wire, `wire_m`."""
        _wind(self._motors, dt_s, self._limit_m_s, command_m_s, tension_n, wire_m)

    def warm(self, dt_s: float, tension_n: Array) -> None:
        """Let the windings warm or cool for `dt_s`, short against `THERMAL_TIME_S`."""
        rise = self._heating * tension_n * tension_n + self.ambient_degc - self.temperature_degc
        self.temperature_degc += rise * (dt_s / THERMAL_TIME_S)

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


@compiled(records(MOTOR), NUMBER, NUMBER, VECTOR, VECTOR, VECTOR)
def _wind(
    motors: Any,
    dt_s: float,
    limit_m_s: float,
    command_m_s: Array,
    tension_n: Array,
    wire_m: Array,
) -> None:
    for i in range(len(motors)):
        motor = motors[i]
        change = (command_m_s[i] - motor.speed_m_s) * (dt_s / (LAG_S + dt_s))
        winding = tension_n[i] * (limit_m_s / STALL_TENSION_N) - limit_m_s
        speed = max(motor.speed_m_s + change, min(winding, 0.0))  # at stall it winds no more
        motor.speed_m_s = speed = min(speed, limit_m_s)
        wire_m[i] += speed * dt_s
        motor.peak_speed_m_s = max(motor.peak_speed_m_s, abs(speed))
        motor.peak_tension_n = max(motor.peak_tension_n, tension_n[i])
