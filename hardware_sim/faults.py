"""The switch board of what is broken in the simulation.

Kinds, the target they name, and what their amount means:

    corrupt   chain or module  probability that a byte on the line has a flipped bit
    drop      chain or module  probability that a packet on the line is lost
    delay     chain or module  seconds that answers come late
    cable     chain            modules left, before the place where the cable was pulled
              module           the cable just before this module was pulled
    stuck     muscle or joint  1: its load cell or angle sensor gives its last reading for ever
    rupture   muscle           1: its wire is torn; a new one comes with plugging it in anew
    overheat  muscle           degC that its motor is hotter than its load makes it

Lines are deterministic: each fault draws from its own generator, seeded by seed, kind and target.
"""

from __future__ import annotations

import math
import random
from collections.abc import Iterable
from typing import NamedTuple

KINDS = ("corrupt", "drop", "delay", "cable", "stuck", "rupture", "overheat")
LONGEST_DELAY_S = 1.0  # the line is in order: what was delayed goes before all that comes later
UNITS = {  # of amounts; the other kinds' are all or nothing
    "corrupt": "of the bytes",
    "drop": "of the packets",
    "delay": "s late",
    "overheat": "degC hotter",
}
_MOST = {"corrupt": 1.0, "drop": 1.0, "delay": LONGEST_DELAY_S}


class ActiveFault(NamedTuple):
    """One thing that is broken."""

    kind: str
    target: str  # name of a chain, muscle or joint
    amount: float


class Faults:
    """What is broken now.

    Attributes:
        active: all faults, in the order in which they were set.
    """

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed
        self.active: list[ActiveFault] = []
        self._active: dict[tuple[str, str], ActiveFault] = {}
        self._random: dict[tuple[str, str], random.Random] = {}

    def set(self, kind: str, target: str, amount: float = 0.0) -> None:
        """Break something; a corrupt, drop, delay, stuck or overheat of amount 0 is mended.

        Raises:
            ValueError: no such kind, or an amount that it cannot have.
        """
        if kind not in KINDS:
            raise ValueError(f"no fault {kind!r}; there are {', '.join(KINDS)}")
        most = _MOST.get(kind, math.inf)
        if not (0.0 <= amount <= most and math.isfinite(amount)):
            bound = f" to {most:g}" if math.isfinite(most) else " on"
            raise ValueError(f"{kind} cannot have the amount {amount:g}, but any from 0{bound}")
        if amount == 0.0 and kind == "rupture":
            amount = 1.0
        if amount == 0.0 and kind != "cable":
            self.clear(kind, target)
            return
        key = (kind, target)
        self._active[key] = ActiveFault(kind, target, amount)
        self.active = list(self._active.values())
        self._random.setdefault(key, random.Random(f"{self.seed}:{kind}:{target}"))

    def matching(self, kind: str = "", target: str = "") -> list[ActiveFault]:
        """Faults of this kind and target; "" is any."""
        return [
            fault
            for fault in self.active
            if kind in ("", fault.kind) and target in ("", fault.target)
        ]

    def clear(self, kind: str = "", target: str = "") -> None:
        """Mend what has this kind and target; "" is any."""
        for fault in self.matching(kind, target):
            del self._active[fault.kind, fault.target]
        self.active = list(self._active.values())

    def amount(self, kind: str, target: str) -> float | None:
        """The amount of a fault; None while that is whole."""
        fault = self._active.get((kind, target))
        return fault.amount if fault else None

    def on_line(self, data: bytes, targets: Iterable[str]) -> bytes:
        """What becomes of a packet's bytes on their way past these targets; b"" when lost."""
        if not data or not self.active:
            return data
        for target in targets:
            drop = self.amount("drop", target)
            if drop is not None and self._random["drop", target].random() < drop:
                return b""
            corrupt = self.amount("corrupt", target)
            if corrupt is not None:
                data = _flip(data, corrupt, self._random["corrupt", target])
        return data


def _flip(data: bytes, probability: float, rng: random.Random) -> bytes:
    return bytes(
        byte ^ (1 << rng.randrange(8)) if rng.random() < probability else byte for byte in data
    )
