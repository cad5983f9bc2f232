"""Which commands count: from the one author, not stale, not reordered, and only for a while."""

from __future__ import annotations

from collections import Counter
from itertools import chain
from math import isfinite
from typing import NamedTuple

from runtime.messages import ChainCommand

AUTHOR = "executive"
STALE_NS = 100_000_000  # older, or further in the future, is refused
MAX_LEASE_NS = 1_000_000_000  # nobody speaks for longer ahead
MAX_TARGET_M = 100.0
OFTEN = 100  # as many late commands are no hiccup any more: a second of them, at their usual rate
_LATE = (
    f"it is more than {STALE_NS / 1e6:.0f} ms old: the machine was too slow for a moment, or the "
    f"clocks of two hosts differ; muscles go by the command before it, then hold"
)
_EARLY = (
    f"its stamp is more than {STALE_NS / 1e6:.0f} ms in the future: the machine was too slow for "
    f"a moment, or the clocks of two hosts differ"
)

Goals = dict[str, tuple[float, float, float]]  # muscle -> bias [N], stiffness [N/m], target [m]


class Refusal(NamedTuple):
    """What is told of a command that was not taken."""

    level: str
    text: str


class CommandGate:
    """Keeps the command in force.

    Attributes:
        command: the one in force, or None.
        refused: how many were not taken.
    """

    def __init__(self, chain: str) -> None:
        self.command: ChainCommand | None = None
        self.refused = 0
        self._chain = chain
        self._last_stamp_ns = -1
        self._new = False
        self._count: Counter[tuple[str, str]] = Counter()  # refused, by author and reason

    def refusal(self, command: ChainCommand, now_ns: int) -> Refusal | None:
        """Take a command. Says why not, the first time for each author and reason; else None.

        That one came late is worth a warning only once it has happened often.
        """
        reason = self._judge(command, now_ns)
        if not reason:
            self.command, self._new = command, True
            self._last_stamp_ns = command.stamp_ns
            return None
        self.refused += 1
        self._count[command.author, reason] += 1
        times = self._count[command.author, reason]
        late = reason in (_LATE, _EARLY)
        text = f"of {command.author!r} for chain {self._chain} was refused: {reason}"
        if times == 1:
            return Refusal("info" if late else "warning", f"a command {text}")
        if times == OFTEN and late:
            return Refusal("warning", f"command number {OFTEN} {text}")
        return None

    def expire(self, now_ns: int) -> bool:
        """True when the lease of the command in force has just run out."""
        command = self.command
        if command is None:
            return False
        if now_ns <= command.stamp_ns + min(command.lease_ns, MAX_LEASE_NS):
            return False
        self.forget()
        return True

    def take(self) -> Goals | None:
        """What a command wants that came since the last call."""
        command = self.command
        if command is None or not self._new:
            return None
        self._new = False
        columns = (command.bias_n, command.stiffness_n_m, command.target_length_m)
        return dict(zip(command.muscles, zip(*columns, strict=True), strict=True))

    def forget(self) -> None:
        """No command is in force."""
        self.command, self._new = None, False

    def _judge(self, command: ChainCommand, now_ns: int) -> str:
        if command.author != AUTHOR:
            return f"only {AUTHOR!r} commands muscles"
        age_ns = now_ns - command.stamp_ns
        if age_ns > STALE_NS:
            return _LATE
        if age_ns < -STALE_NS:
            return _EARLY
        if command.stamp_ns <= self._last_stamp_ns:
            return "a newer one came before it"
        if command.lease_ns <= 0 or age_ns > command.lease_ns:
            return "its lease has run out"
        columns = (command.bias_n, command.stiffness_n_m, command.target_length_m)
        if {*map(len, columns)} != {len(command.muscles)}:
            return "it has not one value for each muscle"
        if not all(map(isfinite, chain.from_iterable(columns))):
            return "it has values that are no numbers"
        if max(map(abs, command.target_length_m), default=0.0) > MAX_TARGET_M:
            return f"a target length is beyond {MAX_TARGET_M:.0f} m"
        return ""
