"""Muscle modules: the registers through which the bus sees one muscle of a `MuscleBank`."""

from __future__ import annotations

import struct
from typing import Any

from hardware_sim.module import JointModule, Module
from hardware_sim.muscle_bank import Mode, MuscleBank
from runtime.wire.packet import StatusError
from runtime.wire.registers import BY_NAME, GOAL_BLOCK, GOALS, PRESENT_BLOCK, PRESENTS, Kind, Status

__all__ = ["JointModule", "Mode", "Module", "MuscleBank", "MuscleModule"]

_BIAS_HIGH, _STIFFNESS_HIGH = (r.high for r in GOALS[:2])
_BIAS_N, _STIFFNESS_N_M, _TARGET_M = (r.scale for r in GOALS)  # of one count
_LENGTH_M, _TENSION_N, _TEMPERATURE_DEGC = (r.scale for r in PRESENTS[:3])
_BANK_ROWS = {  # register -> row of the bank that holds it
    "temperature_limit": "temperature_limit_degc",
    "tension_limit": "tension_limit_n",
    "winding_speed_limit": "winding_speed_limit_m_s",
    "length_zero": "length_zero_m",
    "tension_tare": "tension_tare_n",
}
_GOAL_ROWS = {"bias_tension": "bias_n", "stiffness": "stiffness_n_m"}
_TARED, _DONE = int(Status.TARED), int(StatusError.NONE)  # an enum's member takes 0.1 us


class MuscleModule(Module):
    """The registers of muscle `index` of a bank. Its index follows when others are removed."""

    kind = Kind.MUSCLE

    def __init__(
        self, bank: MuscleBank, index: int, serial: int, module_id: int = 1, name: str = ""
    ) -> None:
        super().__init__(serial, module_id, name)
        self.bank = bank
        self.index = index
        self._tared = False
        bank.bind(self)

    def hear(self, now_ns: int) -> None:
        """Feed the bus watchdog."""
        self.bank.now_ns = now_ns
        self.bank.heard_ns[self.index] = now_ns

    def read(self, address: int, length: int) -> bytes:
        """As `Module.read`."""
        if address != PRESENT_BLOCK.address or length != PRESENT_BLOCK.length:
            return super().read(address, length)
        length_m, tension_n, temperature_degc, status = self.bank.present(self.index)
        try:  # read all the time: a short way
            return PRESENT_BLOCK.pack_raw(
                round(length_m / _LENGTH_M),
                round(tension_n / _TENSION_N),
                round(temperature_degc / _TEMPERATURE_DEGC),
                status | _TARED if self._tared else status,
            )
        except struct.error:  # off the scale: the long way clips
            return super().read(address, length)

    def write(self, address: int, data: bytes) -> int:
        """As `Module.write`."""
        if address != GOAL_BLOCK.address or len(data) != GOAL_BLOCK.length:
            return super().write(address, data)
        bias, stiffness, target = GOAL_BLOCK.unpack_raw(data)  # written all the time: a short way
        if bias > _BIAS_HIGH or stiffness > _STIFFNESS_HIGH:
            return StatusError.DATA_LIMIT
        bank, i = self.bank, self.index
        if bank.tripped.item(i):
            return StatusError.DATA_RANGE
        bank.bias_n[i], bank.stiffness_n_m[i] = bias * _BIAS_N, stiffness * _STIFFNESS_N_M
        bank.set_target(i, target * _TARGET_M)
        return _DONE

    @property
    def alert(self) -> bool:
        """As `Module.alert`."""
        return bool(self.bank.hardware_error.item(self.index))

    def reboot(self) -> None:
        """Torque off, goals, latches and errors forgotten; the wire stays braked."""
        super().reboot()
        self._tared = False
        self.bank.reboot(self.index)

    def save(self) -> dict[str, Any]:
        """Also its column of the bank."""
        return {**super().save(), "tared": self._tared, "column": self.bank.column(self.index)}

    def restore(self, state: dict[str, Any]) -> None:
        """Also its column of the bank."""
        super().restore(state)
        self._tared = state["tared"]
        self.bank.set_column(self.index, state["column"])

    @property
    def _locked(self) -> bool:
        return bool(self.bank.tripped[self.index])

    def _get(self, name: str) -> int:
        bank, i = self.bank, self.index
        match name:
            case "hardware_error":
                return int(bank.hardware_error[i])
            case "bus_watchdog":
                return -1 if bank.tripped[i] else self._raw[name]
            case "present_position":  # of the motor: wire length over spool radius
                raw_m = bank.length_m[i] + bank.length_zero_m[i]
                value = raw_m / bank.spool_radius_m[i]
            case "present_temperature" | "motor_temperature":
                value = bank.temperature_degc[i]
            case "target_length":
                value = bank.target_length_m[i]
            case "present_length":
                value = bank.length_m[i]
            case "present_tension":
                value = bank.tension_n[i]
            case "status":
                return bank.present(i)[3] | (_TARED if self._tared else 0)
            case _ if name in _BANK_ROWS:
                value = getattr(bank, _BANK_ROWS[name])[i]
            case _ if name in _GOAL_ROWS:
                value = getattr(bank, _GOAL_ROWS[name])[i]
            case _:
                return super()._get(name)
        return round(float(value) / BY_NAME[name].scale)

    def _set(self, name: str, raw: int) -> None:
        super()._set(name, raw)
        value, bank, i = raw * BY_NAME[name].scale, self.bank, self.index
        match name:
            case "torque_enable":
                if raw != self._torque:
                    self._torque = bool(raw)
                    bank.set_torque(i, self._torque)
            case "stop":
                bank.set_stop(i, bool(raw))
            case "bus_watchdog":
                bank.set_watchdog(i, value)
            case "target_length":
                bank.set_target(i, value)
            case _ if name in _GOAL_ROWS:
                getattr(bank, _GOAL_ROWS[name])[i] = value
            case _ if name in _BANK_ROWS:
                bank.set_limit(i, _BANK_ROWS[name], value)
                self._tared |= name == "tension_tare"
