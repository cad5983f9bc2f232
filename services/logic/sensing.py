"""What one poll of a chain brought: readings into the modules, and what others are told of them.

One corrupt or missing answer costs that sample of that module: it keeps its last reading.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from runtime import messages as m
from runtime.wire.packet import ALERT, StatusPacket
from runtime.wire.registers import BY_NAME, PRESENT_BLOCK, Kind
from services.logic.line import Exchange
from services.logic.roster import Module, Roster

LOST_CYCLES = 10  # without an answer while others answer
SILENT_CYCLES = 40  # without anything at all: the world may be away for 50 ms of robot time
REBASE_CYCLES = 5  # after so much silence the muscles may be elsewhere

Look = tuple[str, int, int, str, str, bool]  # all of a module that is told when it changes

_ANGLE = BY_NAME["present_angle"]


@dataclass(slots=True)
class Poll:
    """One sync read on its way."""

    exchange: Exchange
    ids: tuple[int, ...]

    @property
    def complete(self) -> bool:
        """Every module has answered."""
        return len(self.exchange.statuses) >= len(self.ids) and all(
            module_id in self.exchange.statuses for module_id in self.ids
        )


@dataclass(slots=True)
class Findings:
    """What a poll showed that somebody has to act on."""

    lost: list[Module] = field(default_factory=list)
    doubled: list[Module] = field(default_factory=list)
    alerts: list[Module] = field(default_factory=list)  # hardware errors that have just come
    recovered: list[Module] = field(default_factory=list)  # and that have just gone
    silent: bool = False  # nothing came back at all: no readings
    chain_silent: bool = False  # and that for so long that all are lost


class Sensing:
    """Takes in polls in their order."""

    def __init__(self, roster: Roster) -> None:
        self._roster = roster
        self._silent = 0  # polls in a row that nothing answered

    def take(self, poll: Poll) -> Findings:
        """Take in one poll that is over."""
        found = Findings()
        polled = {module.id: module for module in self._roster.modules if module.polled}
        asked = [polled[module_id] for module_id in poll.ids if module_id in polled]
        if not poll.exchange.arrived:
            self._silent += 1
            found.silent = True
            if self._silent >= SILENT_CYCLES:
                found.chain_silent, found.lost = True, asked
            return found
        rebase, self._silent = self._silent >= REBASE_CYCLES, 0
        statuses = poll.exchange.statuses
        for module in asked:
            status = statuses.get(module.id)
            if status is None or not _read(module, status):
                module.missed += 1
                module.link_errors += 1
                module.garbled += poll.exchange.garbled
                continue
            module.missed = module.garbled = 0
            alert = status.error >= ALERT
            if alert != module.alert:
                (found.alerts if alert else found.recovered).append(module)
                module.alert = alert
            if rebase and module.kind is Kind.MUSCLE:
                module.hold()
        others_fine = any(not module.missed for module in asked)
        for module in asked:
            if module.missed >= LOST_CYCLES:
                doubled = others_fine and module.garbled >= LOST_CYCLES
                (found.doubled if doubled else found.lost).append(module)
        return found


def states(roster: Roster, mode: str, stamp_ns: int) -> Iterator[m.Message]:
    """The readings as messages, of the instant at which they were asked for."""
    shown = [module for module in roster.modules if module.polled and module.zeroed]
    muscles = [module for module in shown if module.kind is Kind.MUSCLE]
    yield m.ChainState(
        stamp_ns=stamp_ns,
        chain=roster.chain,
        muscles=tuple([x.name for x in muscles]),
        length_m=tuple([x.reading for x in muscles]),
        tension_n=tuple([x.tension_n for x in muscles]),
        temperature_degc=tuple([x.temperature_degc for x in muscles]),
        target_length_m=tuple([x.reference.target_m for x in muscles]),
        mode=mode,
    )
    if len(muscles) < len(shown):
        joints = [module for module in shown if module.kind is Kind.JOINT]
        yield m.JointState(
            stamp_ns=stamp_ns,
            source=roster.chain,
            joints=tuple([x.name for x in joints]),
            angle_rad=tuple([x.reading for x in joints]),
        )


class BodyTeller:
    """Tells who is on the chain: when it changes, and once a second."""

    EVERY_NS = 1_000_000_000

    def __init__(self, roster: Roster) -> None:
        self._roster = roster
        self._told: list[Look] = []
        self._told_ns = 0

    def tell(self, stopped: bool, now_ns: int) -> Iterator[m.ChainBody]:
        """The message, when it is time for it."""
        modules = self._roster.modules
        # without the count of link errors, which may change every cycle
        look: list[Look] = [(x.name, x.id, x.serial, x.state, x.fault, stopped) for x in modules]
        if look == self._told and now_ns - self._told_ns < self.EVERY_NS:
            return
        self._told, self._told_ns = look, now_ns
        infos = tuple(module.info(stopped) for module in modules)
        yield m.ChainBody(stamp_ns=now_ns, chain=self._roster.chain, modules=infos)


def _read(module: Module, status: StatusPacket) -> bool:
    """Take in one module's readings; False: they are not whole."""
    params = status.params
    if module.kind is Kind.JOINT:
        if len(params) < _ANGLE.size:
            return False
        module.reading = _ANGLE.decode(params)
        return True
    if len(params) < PRESENT_BLOCK.length:
        return False
    module.take(PRESENT_BLOCK.unpack(params))
    return True
