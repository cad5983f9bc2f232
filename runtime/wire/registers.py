"""The modules' control table: one table, used by master and module alike.

Where a register means the same as on the Dynamixel X series (protocol 2.0 control table of the
XM430, emanual.robotis.com) it has that address and size, so that other people's clients can read
it. Ours start at 700: goals lie together at 720 and presents at 740, so that one sync write
commands a chain and one sync read senses it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum, IntEnum
from operator import mul, truediv
from struct import Struct
from typing import NamedTuple


class Kind(IntEnum):
    """Model numbers (register 0)."""

    MUSCLE = 0x4D31
    JOINT = 0x4A31


class Keep(Enum):
    """What becomes of a value when the module is switched off."""

    EEPROM = "eeprom"  # kept; writing is refused while torque is enabled
    RAM = "ram"  # goes back to its default
    READ_ONLY = "read only"  # writing is refused


class Register(NamedTuple):
    """One entry: raw little-endian integer times `scale` is the value in `unit`."""

    name: str
    address: int
    size: int
    keep: Keep
    scale: float = 1.0
    unit: str = ""
    signed: bool = False
    default: int = 0
    low: int = 0  # raw limits of what may be written
    high: int = 2**63 - 1
    kinds: tuple[Kind, ...] = (Kind.MUSCLE, Kind.JOINT)

    def encode(self, value: float) -> bytes:
        """Value in `unit` -> bytes on the line. OverflowError when it does not fit."""
        return round(value / self.scale).to_bytes(self.size, "little", signed=self.signed)

    def decode(self, data: bytes) -> float:
        """Bytes on the line -> value in `unit`."""
        return int.from_bytes(data[: self.size], "little", signed=self.signed) * self.scale


_M = (Kind.MUSCLE,)
_J = (Kind.JOINT,)
_E, _R, _P = Keep.EEPROM, Keep.RAM, Keep.READ_ONLY

TABLE = (
    # as on the X series
    Register("model_number", 0, 2, _P),
    Register("model_information", 2, 4, _P),
    Register("firmware_version", 6, 1, _P, default=1),
    Register("id", 7, 1, _E, default=1, high=252),
    Register("baud_rate", 8, 1, _E, default=5, high=7),  # index: 5 is 3 Mbaud
    Register("return_delay", 9, 1, _E, 2e-6, "s", default=0, high=254),
    Register("temperature_limit", 31, 1, _E, 1.0, "degC", default=80, high=100, kinds=_M),
    Register("torque_enable", 64, 1, _R, high=1, kinds=_M),
    Register("led", 65, 1, _R, high=1),
    Register("status_return_level", 68, 1, _R, default=2, high=2),
    Register("hardware_error", 70, 1, _P),
    Register("bus_watchdog", 98, 1, _R, 0.02, "s", signed=True, low=0, high=127, kinds=_M),
    Register("present_position", 132, 4, _P, 2 * 3.141592653589793 / 4096, "rad", signed=True),
    Register("present_temperature", 146, 1, _P, 1.0, "degC"),
    # ours, kept: present_tension = load cell - tension_tare, present_length = wire - length_zero
    Register("serial_number", 700, 8, _P),
    Register("tension_limit", 708, 2, _E, 0.01, "N", default=15_000, high=40_000, kinds=_M),
    Register("winding_speed_limit", 710, 2, _E, 1e-4, "m/s", default=2500, high=10_000, kinds=_M),
    Register("length_zero", 712, 4, _E, 1e-6, "m", signed=True, low=-(2**31), kinds=_M),
    Register("tension_tare", 716, 2, _E, 0.01, "N", signed=True, low=-2000, high=2000, kinds=_M),
    # ours, the stop and right behind it the goals: one block of 8 bytes
    Register("stop", 719, 1, _R, high=1, kinds=_M),  # 1: pay out at bounded speed, latched
    Register("bias_tension", 720, 2, _R, 0.01, "N", high=40_000, kinds=_M),
    Register("stiffness", 722, 2, _R, 1.0, "N/m", high=60_000, kinds=_M),
    Register("target_length", 724, 4, _R, 1e-6, "m", signed=True, low=-(2**31), kinds=_M),
    # ours, presents: one block of 9 bytes; a joint module answers its first 4
    Register("present_angle", 740, 4, _P, 1e-6, "rad", signed=True, kinds=_J),
    Register("present_length", 740, 4, _P, 1e-6, "m", signed=True, kinds=_M),
    Register("present_tension", 744, 2, _P, 0.01, "N", signed=True, kinds=_M),
    Register("motor_temperature", 746, 2, _P, 0.1, "degC", signed=True, kinds=_M),
    Register("status", 748, 1, _P, kinds=_M),
    Register("link_errors", 750, 2, _P),
)

MEANINGS = {
    "model_number": "19761 (0x4D31): muscle module; 18993 (0x4A31): joint module",
    "model_information": "0",
    "firmware_version": "also in the answer to a ping",
    "id": "address on the line; 1 as it comes from the factory",
    "baud_rate": "index into the baud rates",
    "return_delay": "pause before it answers",
    "temperature_limit": "above it the module gives up tension",
    "torque_enable": "0: the brake holds the wire; 1: goals are obeyed",
    "led": "1: on",
    "status_return_level": "0: answers pings alone; 1: reads, too; 2: everything",
    "hardware_error": "bits, see below; not 0: every answer carries the alert bit",
    "bus_watchdog": "silence of the master after which the wire is held; 0: off; -1: it tripped,"
    " and goals are refused until 0 is written",
    "present_position": "of a muscle module's motor, of a joint module's joint",
    "present_temperature": "of the module",
    "serial_number": "unique, for ever: by it a module is known again",
    "tension_limit": "no reference above 0.88 of it, and from there the wire is paid out",
    "winding_speed_limit": "greatest speed of winding and paying out",
    "length_zero": "wire length at which present_length is 0",
    "tension_tare": "reading of the load cell at which present_tension is 0",
    "stop": "1: pay out at bounded speed until the wire is slack, latched; 0: clear it",
    "bias_tension": "f_bias of f_ref = f_bias + k_stiff (l - l_ref)",
    "stiffness": "k_stiff",
    "target_length": "l_ref",
    "present_angle": "of the joint",
    "present_length": "wire paid out, from length_zero",
    "present_tension": "of the wire at the load cell, from tension_tare",
    "motor_temperature": "of the winding",
    "status": "bits, see below",
    "link_errors": "packets with a wrong checksum that it heard since power-on",
}

BY_NAME = {register.name: register for register in TABLE}
_CODES = {1: "b", 2: "h", 4: "i", 8: "q"}


class Block:
    """Registers that lie side by side, read and written as one span of `length` bytes.

    `pack_raw` and `unpack_raw` are for what is said every cycle: raw integers, one of each register
    in their order, to bytes and back.
    """

    def __init__(self, registers: Iterable[Register]) -> None:
        self.registers = tuple(registers)
        self.address = end = self.registers[0].address
        codes = ""
        for register in self.registers:
            if register.address != end:
                raise ValueError(f"{register.name} does not begin at {end}, where the block ends")
            end += register.size
            code = _CODES[register.size]
            codes += code if register.signed else code.upper()
        self.length = end - self.address
        struct = Struct("<" + codes)
        self.pack_raw, self.unpack_raw = struct.pack, struct.unpack_from
        self._names = tuple(register.name for register in self.registers)
        self._scales = tuple(register.scale for register in self.registers)

    def encode(self, values: Mapping[str, float]) -> bytes:
        """Register name -> value, all of them. Raises struct.error when one does not fit."""
        wanted = [values[name] for name in self._names]
        return self.pack_raw(*map(round, map(truediv, wanted, self._scales)))

    def decode(self, data: bytes) -> dict[str, float]:
        """Register name -> value in its unit. `data` has at least `length` bytes."""
        values = map(mul, self.unpack_raw(data), self._scales)
        return dict(zip(self._names, values, strict=True))


def block(*names: str) -> Block:
    """The block of the registers so named, in the order of their addresses."""
    return Block(BY_NAME[name] for name in names)


GOALS = (BY_NAME["bias_tension"], BY_NAME["stiffness"], BY_NAME["target_length"])
PRESENTS = tuple(
    BY_NAME[name] for name in ("present_length", "present_tension", "motor_temperature", "status")
)
GOAL_BLOCK = Block(GOALS)
PRESENT_BLOCK = Block(PRESENTS)
BAUD_RATES = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000, 4_500_000)


class Status(IntEnum):
    """Bits of the `status` register."""

    FOLLOWING = 1  # torque is enabled and goals are obeyed
    HOLDING = 2  # the bus watchdog tripped: the wire is held with capped tension
    STOPPING = 4  # stop is latched and the wire is being paid out
    STOPPED = 8  # stop is latched and the wire is slack
    TENSION_CAPPED = 16  # the reference was cut to the tension limit
    TARED = 32  # tension_tare was written since power-on


class HardwareError(IntEnum):
    """Bits of the `hardware_error` register; a set bit shows as alert in every status packet."""

    OVERHEATING = 4  # as on the X series
    LOAD_CELL = 8  # reads nothing possible: the wire or its sensor is broken
    OVERLOAD = 32  # as on the X series: tension stayed above the limit
