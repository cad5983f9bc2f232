"""The latched stop of one chain: told to the modules until they say so, and kept over restarts.

"stopped" is said only when the muscles' own readings say it: every one has latched the stop, and
its wire has been slack for a while. Wires that pay out are slack for a moment before the arm sinks.
"""

from __future__ import annotations

from collections.abc import Iterator

from runtime.messages import Reply
from runtime.wire import packet as wire
from runtime.wire.packet import InstructionPacket
from runtime.wire.registers import BY_NAME, Kind, Status
from services.logic.reference import JOIN_BIAS_N
from services.logic.roster import Module, Roster

SLACK_N = 5.0
SLACK_NS = 300_000_000  # for so long

_STOP = BY_NAME["stop"]
_LATCHED = int(Status.STOPPING | Status.STOPPED)


class Stopping:
    """Stop and reset of the muscles of one roster.

    Attributes:
        mode: "stopping", "stopped", or "" when no stop is latched.
    """

    def __init__(self, roster: Roster) -> None:
        self._roster = roster
        self._slack_since_ns: int | None = None
        self._slack = False
        self._told = False

    @property
    def mode(self) -> str:
        """What the muscles do, by their own word."""
        if not self._roster.stopped:
            return ""
        return "stopped" if self._slack else "stopping"

    def stop(self, chain: str, muscles: list[str]) -> Reply:
        """Latch. The packets go out with the next tick."""
        self._roster.stopped = True
        self._slack = self._told = False
        self._slack_since_ns = None
        self._roster.clearing.clear()
        if not muscles:
            text = f"no muscle answers on chain {chain}; whoever comes back will be stopped"
            return Reply(ok=False, text=text)
        text = f"chain {chain} is stopping: {', '.join(muscles)} pay out until slack"
        return Reply(ok=True, text=text, data={"chain": chain, "mode": "stopping"})

    def reset(self, chain: str) -> Reply:
        """Clear the latch; the muscles hold where they are, with a small tension."""
        if not self._roster.stopped:
            return Reply(ok=True, text=f"chain {chain} was not stopped")
        self._roster.stopped = self._slack = self._told = False
        # also those that do not answer now: when they are back, their latch is an old one
        self._roster.clearing = {m.serial for m in self._roster.modules if m.kind is Kind.MUSCLE}
        for muscle in self._roster.muscles():
            if muscle.reference.stiffness_n_m > 0.0:
                muscle.reference.bias_n = JOIN_BIAS_N
                muscle.reference.hold(muscle.reading, muscle.tension_n)
            else:
                muscle.reference.slacken(muscle.reading)
        return Reply(ok=True, text=f"chain {chain} holds where it is", data={"chain": chain})

    def look(self, muscles: list[Module], now_ns: int) -> Iterator[str]:
        """Compare with what the muscles say; gives the words when all have come to a stop."""
        for muscle in muscles:
            if not muscle.status & _LATCHED:
                self._roster.clearing.discard(muscle.serial)
            elif muscle.serial not in self._roster.clearing:
                self._roster.stopped = True  # latched by another hand, or before a restart
        if not self._roster.stopped:
            return
        slack = bool(muscles) and all(
            muscle.status & Status.STOPPED
            or (muscle.status & Status.STOPPING and muscle.tension_n < SLACK_N)
            for muscle in muscles
        )
        if not slack:
            self._slack_since_ns = None
        elif self._slack_since_ns is None:
            self._slack_since_ns = now_ns
        since_ns = self._slack_since_ns
        self._slack = since_ns is not None and now_ns - since_ns >= SLACK_NS
        if self._slack and not self._told:
            self._told = True
            tightest_n = max(0.0, *(muscle.tension_n for muscle in muscles))
            chain = self._roster.chain
            yield f"chain {chain} has stopped: no wire has more than {tightest_n:.1f} N"

    def packets(self, muscles: list[Module]) -> list[InstructionPacket]:
        """What has still to be written: 1 where the stop is not latched, 0 after a reset."""
        if self._roster.stopped:
            there = {module.id for module in self._roster.modules if module.polled}
            ids = [muscle.id for muscle in muscles if not muscle.status & _LATCHED]
            ids += [i for i in self._roster.expected_ids() if i not in there]
        elif not self._roster.clearing:
            return []
        else:
            ids = [muscle.id for muscle in muscles if muscle.serial in self._roster.clearing]
        if not ids:
            return []
        value = _STOP.encode(1 if self._roster.stopped else 0)
        return [wire.sync_write(_STOP.address, _STOP.size, dict.fromkeys(ids, value))]
