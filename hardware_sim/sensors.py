"""The simulated robot's sensors: load cells and encoders of its wires, angle sensors of its joints.

Each reads the truth, off by an offset and noise; one that is stuck goes on with what it read last.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hardware_sim.compiled import BLOCK, INTEGER, VECTOR, compiled
from runtime.settings import Simulation

Array = NDArray[np.float64]

NOISE_BLOCK = 1000  # rows of noise drawn at once: a draw of one row costs as much as forty
NO_NOISE: Array = np.zeros((0, 2, 0))  # the offsets changed: draw anew
CREEP_M_S = 0.002  # wire speed beyond which friction at the motor is whole
LOAD_CELL_OFFSET_N = 1.5  # spread of load cells that nobody tared
ENCODER_OFFSET_M = 0.01  # spread of where an encoder begins that was switched on just now


class Sensors:
    """Sensors of M wires and of joints. Arrays have shape (M,), and are stale after `add`.

    Attributes:
        cell_offset_n: what a load cell reads without load.
        encoder_offset_m: the length of wire at which an encoder reads zero.
        stuck: by muscle or joint, what its load cell [N] or angle sensor [rad] reads for ever.
    """

    def __init__(self, simulation: Simulation, rng: np.random.Generator) -> None:
        self.stuck: dict[str, float] = {}
        self.cell_offset_n = np.zeros(0)
        self.encoder_offset_m = np.zeros(0)
        self._simulation = simulation
        self._motor_friction = simulation.motor_friction
        self._rng = rng
        self._use(self.cell_offset_n, self.encoder_offset_m)

    def add(self, serial: int) -> None:
        """Load cell and encoder of one more wire: built like that, whatever the run."""
        offset = np.random.default_rng(serial).normal(0.0, LOAD_CELL_OFFSET_N)
        self._use(np.append(self.cell_offset_n, offset), np.append(self.encoder_offset_m, 0.0))

    def begin_at(self, length_m: float) -> None:
        """The last encoder begins to count about here."""
        self.encoder_offset_m[-1] = length_m + self._rng.normal(0.0, ENCODER_OFFSET_M)
        self._noise = NO_NOISE

    def remove(self, index: int) -> None:
        """Take those of one wire away."""
        self._use(np.delete(self.cell_offset_n, index), np.delete(self.encoder_offset_m, index))

    def restore(self, cell_offset_n: list[float], encoder_offset_m: list[float]) -> None:
        """Take offsets that were saved."""
        self._use(np.array(cell_offset_n), np.array(encoder_offset_m))

    def read(
        self, wires: list[str], tension_n: Array, length_m: Array, speed_m_s: Array
    ) -> tuple[Array, Array]:
        """What load cells [N] and encoders [m] read of what is, by the names of the wires.

        The next call writes them anew.
        """
        if self._row >= len(self._noise):
            self._draw()
        load, length = self._load_n, self._length_m
        _read(self._noise, self._row, tension_n, length_m, load, length)
        self._row += 1
        if self._motor_friction:
            load -= self._motor_friction * tension_n * np.tanh(speed_m_s / CREEP_M_S)
        for name, reading in self.stuck.items():
            if name in wires:
                load[wires.index(name)] = reading
        return load, length

    def read_angle(self, joint: str, angle_rad: float) -> float:
        """What a joint's angle sensor reads [rad]."""
        if self.stuck and (stuck := self.stuck.get(joint)) is not None:
            return stuck
        return angle_rad + self._simulation.angle_noise_rad * self._rng.normal()

    def _use(self, cell_offset_n: Array, encoder_offset_m: Array) -> None:
        self.cell_offset_n, self.encoder_offset_m = cell_offset_n, encoder_offset_m
        self._load_n, self._length_m = np.zeros((2, len(cell_offset_n)))
        self._noise = NO_NOISE
        self._row = 0

    def _draw(self) -> None:
        """What the next readings are off by, offset and noise: (rows, 2, M)."""
        size = ((self._simulation.tension_noise_n,), (self._simulation.length_noise_m,))
        offset = np.stack((self.cell_offset_n, -self.encoder_offset_m))
        drawn = self._rng.normal(size=(NOISE_BLOCK, *offset.shape))
        self._noise = drawn * np.array(size) + offset
        self._row = 0


@compiled(BLOCK, INTEGER, VECTOR, VECTOR, VECTOR, VECTOR)
def _read(
    errors: Array, row: int, tension_n: Array, wire_m: Array, load_n: Array, length_m: Array
) -> None:
    for i in range(len(load_n)):
        load_n[i] = errors[row, 0, i] + tension_n[i]
        length_m[i] = errors[row, 1, i] + wire_m[i]
