"""What any module is to its bus: an image of registers, with the semantics of the X series.

The table of registers is `runtime/wire/registers.py`. Joint modules, which only measure, are here;
muscle modules, which have loops to run, are in `firmware.py`; `chain.py` strings them together.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from struct import Struct
from typing import Any

from runtime.wire.packet import StatusError
from runtime.wire.registers import (
    BAUD_RATES,
    BY_NAME,
    GOALS,
    PRESENT_BLOCK,
    TABLE,
    Keep,
    Kind,
    Register,
)

_AMBIENT_DEGC = 25
_MAX_SPAN = 1024  # bytes that one read or write may touch
_RETURN_DELAY_S = BY_NAME["return_delay"].scale
_GOALS = {register.name for register in GOALS}
_ANGLE = BY_NAME["present_angle"]
_ANGLE_BLOCK = Struct(f"<I{PRESENT_BLOCK.length - _ANGLE.size}x")  # gaps read 0
_ENDLESS = {"present_position", "present_angle", "present_length", "target_length"}


class Module:
    """A device on a chain.

    Attributes:
        serial: unique, for ever.
        name: of the muscle or joint, for faults and for the log; the firmware does not know it.
        id: its address on the line.
        baud: baud rate [1/s] at which it listens.
        return_delay_s: pause before it answers [s].
        status_return_level: 0: it answers pings alone; 1: reads, too; 2: all that asks it alone.
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
        self._settle()

    def listen_at(self, baud: int) -> None:
        """Set its baud rate [1/s]."""
        self._set("baud_rate", BAUD_RATES.index(baud))

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
            if self._locked and r.name in _GOALS:
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
        self._settle()

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
        self._settle()

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
        self._settle()

    def _settle(self) -> None:
        """Take out of the registers what is looked at with every packet."""
        raw = self._raw
        self.id = raw["id"]
        self.baud = BAUD_RATES[raw["baud_rate"]]
        self.return_delay_s = raw["return_delay"] * _RETURN_DELAY_S
        self.status_return_level = raw["status_return_level"]

    def _bytes(self, register: Register) -> bytes:
        bits = 8 * register.size
        raw = self._get(register.name)
        if register.name in _ENDLESS:  # turns of a spool are counted until the counter overflows
            return (raw % (1 << bits)).to_bytes(register.size, "little")
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if register.signed else (0, 2**bits - 1)
        clipped = min(max(raw, low), high)
        return clipped.to_bytes(register.size, "little", signed=register.signed)


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

    def read(self, address: int, length: int) -> bytes:
        """As `Module.read`."""
        if address != PRESENT_BLOCK.address or length != PRESENT_BLOCK.length:
            return super().read(address, length)
        raw = round(self._angle_rad() / _ANGLE.scale)  # read all the time: a short way
        return _ANGLE_BLOCK.pack(raw % (1 << 8 * _ANGLE.size))

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
