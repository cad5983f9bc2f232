"""What a module is to its bus: an image of registers, with the semantics of the X series.

`MuscleModule` shows one muscle of a `MuscleBank` through the control table of
`runtime/wire/registers.py`; `JointModule` shows one joint angle. `chain.py` strings them together.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import cache
from typing import Any

from hardware_sim.muscle_bank import Mode, MuscleBank
from runtime.wire.packet import StatusError
from runtime.wire.registers import (
    BAUD_RATES,
    BY_NAME,
    GOAL_BLOCK,
    GOALS,
    PRESENT_BLOCK,
    TABLE,
    Keep,
    Kind,
    Register,
    Status,
)

__all__ = ["JointModule", "Mode", "Module", "MuscleBank", "MuscleModule"]

_GOAL_HIGH = {register.name: register.high * register.scale for register in GOALS}
_AMBIENT_DEGC = 25
_MAX_SPAN = 1024  # bytes that one read or write may touch

_BANK_ROWS = {  # register -> row of the bank that holds it
    "temperature_limit": "temperature_limit_degc",
    "tension_limit": "tension_limit_n",
    "winding_speed_limit": "winding_speed_limit_m_s",
    "length_zero": "length_zero_m",
    "tension_tare": "tension_tare_n",
}
_GOAL_ROWS = {"bias_tension": "bias_n", "stiffness": "stiffness_n_m"}
_ENDLESS = {"present_position", "present_angle", "present_length", "target_length"}


class Module:
    """A device on a chain.

    Attributes:
        serial: unique, for ever.
        name: of the muscle or joint, for faults and for the log; the firmware does not know it.
        link_errors: packets with a wrong checksum that it heard.
        pending: (address, data) of a registered write, waiting for its action.
    """

    kind: Kind

    def __init__(self, serial: int, module_id: int = 1, name: str = "") -> None:
        self.serial = serial
        self.name = name
        self.link_errors = 0
        self.pending: tuple[int, bytes] | None = None
        self._raw = {r.name: r.default for r in _table(self.kind) if r.keep is not Keep.READ_ONLY}
        self._raw["id"] = module_id
        self._torque = False

    @property
    def id(self) -> int:
        """Its address on the line."""
        return self._raw["id"]

    @property
    def baud(self) -> int:
        """Baud rate [1/s] at which it listens."""
        return BAUD_RATES[self._raw["baud_rate"]]

    @baud.setter
    def baud(self, baud: int) -> None:
        self._raw["baud_rate"] = BAUD_RATES.index(baud)

    @property
    def return_delay_s(self) -> float:
        """Pause before it answers [s]."""
        return self._raw["return_delay"] * BY_NAME["return_delay"].scale

    @property
    def status_return_level(self) -> int:
        """0: answers pings alone; 1: reads, too; 2: everything that asks it alone."""
        return self._raw["status_return_level"]

    @property
    def alert(self) -> bool:
        """Whether `hardware_error` is not zero."""
        return bool(self._get("hardware_error"))

    def hear(self, now_ns: int) -> None:
        """An intact packet went by on the line."""

    def ping(self) -> bytes:
        """Model number and firmware version, as a ping is answered."""
        return self.read(0, 2) + self.read(6, 1)

    def read(self, address: int, length: int) -> bytes:
        """`length` bytes of the image; gaps read 0. Empty: no register begins there."""
        plan = _plan(self.kind, address, length)
        if plan is None:
            return b""
        image = bytearray(length)
        for at, register in plan:
            data = self._bytes(register)
            low, high = max(at, 0), min(at + register.size, length)
            image[low:high] = data[low - at : high - at]
        return bytes(image)

    def write(self, address: int, data: bytes) -> int:
        """Write one register or several that lie together, all or none; the error as `check`."""
        values: list[tuple[str, int]] = []
        error = self.check(address, data, values)
        if not error:
            for name, raw in values:
                self._set(name, raw)
        return error

    def check(self, address: int, data: bytes, values: list[tuple[str, int]] | None = None) -> int:
        """What `write` would answer; `values` takes the registers' names and raw values.

        Returns:
            A `StatusError`: ACCESS (no such register, read only, or kept and torque is on),
            DATA_LENGTH (not whole registers), DATA_LIMIT (a value it may not have), DATA_RANGE
            (goals while the bus watchdog is tripped).
        """
        plan = _plan(self.kind, address, len(data))
        if plan is None:
            return StatusError.ACCESS
        if sum(r.size for _, r in plan) != len(data) or plan[0][0] < 0:
            return StatusError.DATA_LENGTH
        for at, r in plan:
            if r.keep is Keep.READ_ONLY or (r.keep is Keep.EEPROM and self._torque):
                return StatusError.ACCESS
            raw = int.from_bytes(data[at : at + r.size], "little", signed=r.signed)
            if not r.low <= raw <= r.high:
                return StatusError.DATA_LIMIT
            if self._locked and r.name in _GOAL_HIGH:
                return StatusError.DATA_RANGE
            if values is not None:
                values.append((r.name, raw))
        return StatusError.NONE

    def reboot(self) -> None:
        """Start anew: what lies in RAM goes back to its default."""
        self.pending = None
        self._torque = False
        self.link_errors = 0
        for register in _table(self.kind):
            if register.keep is Keep.RAM:
                self._raw[register.name] = register.default

    def factory_reset(self, option: int) -> bool:
        """FF: all; 01: all but the id; 02: all but id and baud rate. False: no such option."""
        spared = {0xFF: (), 1: ("id",), 2: ("id", "baud_rate")}.get(option)
        if spared is None:
            return False
        self.reboot()
        for register in _table(self.kind):
            if register.keep is Keep.EEPROM and register.name not in spared:
                self._set(register.name, register.default)
        return True

    def save(self) -> dict[str, Any]:
        """All that it remembers, as plain data; see `restore`."""
        return {
            "kind": int(self.kind),
            "serial": self.serial,
            "name": self.name,
            "torque": self._torque,
            "link_errors": self.link_errors,
            "registers": dict(self._raw),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Be as `save` found it."""
        self.serial, self.name = state["serial"], state["name"]
        self.link_errors = state["link_errors"]
        self._torque = state["torque"]
        self._raw.update(state["registers"])

    @property
    def _locked(self) -> bool:
        """Whether goals are refused."""
        return False

    def _get(self, name: str) -> int:
        match name:
            case "model_number":
                return int(self.kind)
            case "serial_number":
                return self.serial
            case "link_errors":
                return self.link_errors
            case "firmware_version":
                return BY_NAME[name].default
            case "present_temperature":
                return _AMBIENT_DEGC
        return self._raw.get(name, 0)

    def _set(self, name: str, raw: int) -> None:
        self._raw[name] = raw

    def _bytes(self, register: Register) -> bytes:
        bits = 8 * register.size
        raw = self._get(register.name)
        if register.name in _ENDLESS:  # turns of a spool are counted until the counter overflows
            return (raw % (1 << bits)).to_bytes(register.size, "little")
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if register.signed else (0, 2**bits - 1)
        clipped = min(max(raw, low), high)
        return clipped.to_bytes(register.size, "little", signed=register.signed)


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
        bank, i = self.bank, self.index  # read all the time: a short way
        try:
            return PRESENT_BLOCK.encode(
                {
                    "present_length": bank.length_m.item(i),
                    "present_tension": bank.tension_n.item(i),
                    "motor_temperature": bank.temperature_degc.item(i),
                    "status": self._status(),
                }
            )
        except struct.error:  # off the scale: the long way clips
            return super().read(address, length)

    def write(self, address: int, data: bytes) -> int:
        """As `Module.write`."""
        if address != GOAL_BLOCK.address or len(data) != GOAL_BLOCK.length:
            return super().write(address, data)
        goals = GOAL_BLOCK.decode(data)  # written all the time: a short way
        if any(value > _GOAL_HIGH[name] for name, value in goals.items()):
            return StatusError.DATA_LIMIT
        if self._locked:
            return StatusError.DATA_RANGE
        for name, row in _GOAL_ROWS.items():
            getattr(self.bank, row)[self.index] = goals[name]
        self.bank.set_target(self.index, goals["target_length"])
        return StatusError.NONE

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

    def _status(self) -> int:
        bits = int(self.bank.mode.item(self.index)) | (Status.TARED if self._tared else 0)
        return bits | (Status.TENSION_CAPPED if self.bank.capped(self.index) else 0)

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
                return self._status()
            case _ if name in _BANK_ROWS:
                value = getattr(bank, _BANK_ROWS[name])[i]
            case _ if name in _GOAL_ROWS:
                value = getattr(bank, _GOAL_ROWS[name])[i]
            case _:
                return super()._get(name)
        return round(float(value) / BY_NAME[name].scale)

    def _set(self, name: str, raw: int) -> None:
        value, bank, i = raw * BY_NAME[name].scale, self.bank, self.index
        self._raw[name] = raw
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


class JointModule(Module):
    """The registers of a module that measures one joint.

    Args:
        serial: unique.
        angle_rad: gives the reading of the angle sensor [rad].
        module_id: address on the line.
    """

    kind = Kind.JOINT

    def __init__(
        self, serial: int, angle_rad: Callable[[], float], module_id: int = 1, name: str = ""
    ) -> None:
        super().__init__(serial, module_id, name)
        self._angle_rad = angle_rad

    def _get(self, name: str) -> int:
        if name in ("present_angle", "present_position"):
            return round(self._angle_rad() / BY_NAME[name].scale)
        return super()._get(name)


@cache
def _table(kind: Kind) -> tuple[Register, ...]:
    return tuple(sorted((r for r in TABLE if kind in r.kinds), key=lambda r: r.address))


@cache
def _plan(kind: Kind, address: int, length: int) -> tuple[tuple[int, Register], ...] | None:
    """Registers that a span touches, with their offsets in it; None: none stands at its start."""
    touched = tuple(
        (r.address - address, r)
        for r in _table(kind)
        if r.address < address + length and r.address + r.size > address
    )
    return touched if touched and touched[0][0] <= 0 and length <= _MAX_SPAN else None
