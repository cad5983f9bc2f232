"""What one poll of a chain brought: readings into the modules, and what others are told of them.

One corrupt or missing answer costs that sample of that module: it keeps its last reading.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf
from typing import NamedTuple

from runtime import messages as m
from runtime.wire.packet import ALERT, StatusPacket
from runtime.wire.registers import BY_NAME, PRESENT_BLOCK, Kind
from services.logic.line import Exchange
from services.logic.roster import Module, Roster

LOST_CYCLES = 10  # without an answer while others answer
SILENT_CYCLES = 40  # without anything at all: the world may be away for 50 ms of robot time
REBASE_CYCLES = 5  # after so much silence the muscles may be elsewhere

Look = tuple[str, int, int, str, str, bool]  # all of a module that is told when it changes

_MUSCLE, _JOINT = Kind.MUSCLE, Kind.JOINT  # an enum's member takes 0.1 us
_ANGLE = BY_NAME["present_angle"]


@dataclass(slots=True)
class Poll:
    """One sync read on its way."""

    exchange: Exchange
    ids: tuple[int, ...]

    @property
    def complete(self) -> bool:
        """Every module has answered."""
        statuses = self.exchange.statuses
        return len(statuses) >= len(self.ids) and statuses.keys() >= {*self.ids}


class Findings(NamedTuple):
    """What a poll showed that somebody has to act on."""

    lost: Sequence[Module] = ()
    doubled: Sequence[Module] = ()
    alerts: Sequence[Module] = ()  # hardware errors that have just come
    recovered: Sequence[Module] = ()  # and that have just gone
    silent: bool = False  # nothing came back at all: no readings
    chain_silent: bool = False  # and that for so long that all are lost


FINE = Findings()


class Sensing:
    """Takes in polls in their order."""

    def __init__(self, roster: Roster) -> None:
        self._roster = roster
        self._silent = 0  # polls in a row that nothing answered

    def take(self, poll: Poll) -> Findings:
        """Take in one poll that is over."""
        polled = {module.id: module for module in self._roster.modules if module.polled}
        asked = [polled[module_id] for module_id in poll.ids if module_id in polled]
        if not poll.exchange.arrived:
            self._silent += 1
            over = self._silent >= SILENT_CYCLES
            return Findings(lost=asked if over else (), silent=True, chain_silent=over)
        rebase, self._silent = self._silent >= REBASE_CYCLES, 0
        statuses = poll.exchange.statuses
        changed, missing = [], []
        for module in asked:
            status = statuses.get(module.id)
            if status is None or not _read(module, status):
                module.missed += 1
                module.link_errors += 1
                module.garbled += poll.exchange.garbled
                missing.append(module)
                continue
            module.missed = module.garbled = 0
            alert = status.error >= ALERT
            if alert != module.alert:
                module.alert = alert
                changed.append(module)
            if rebase and module.kind is _MUSCLE:
                module.hold()
        if not changed and not missing:
            return FINE
        gone = [module for module in missing if module.missed >= LOST_CYCLES]
        # garbage for so long while others are well: two modules with one id
        least = LOST_CYCLES if len(missing) < len(asked) else inf
        return Findings(
            lost=[module for module in gone if module.garbled < least],
            doubled=[module for module in gone if module.garbled >= least],
            alerts=[module for module in changed if module.alert],
            recovered=[module for module in changed if not module.alert],
        )


def states(roster: Roster, mode: str, stamp_ns: int) -> list[m.Message]:
    """The readings as messages, of the instant at which they were asked for."""
    shown = [module for module in roster.modules if module.polled and module.zeroed]
    muscles = [module for module in shown if module.kind is _MUSCLE]
    chain_state = m.ChainState(
        stamp_ns=stamp_ns,
        chain=roster.chain,
        muscles=tuple([x.name for x in muscles]),
        length_m=tuple([x.reading for x in muscles]),
        tension_n=tuple([x.tension_n for x in muscles]),
        temperature_degc=tuple([x.temperature_degc for x in muscles]),
        target_length_m=tuple([x.reference.target_m for x in muscles]),
        mode=mode,
    )
    if len(muscles) == len(shown):
        return [chain_state]
    joints = [module for module in shown if module.kind is _JOINT]
    joint_state = m.JointState(
        stamp_ns=stamp_ns,
        source=roster.chain,
        joints=tuple([x.name for x in joints]),
        angle_rad=tuple([x.reading for x in joints]),
    )
    return [chain_state, joint_state]


class BodyTeller:
    """Tells who is on the chain: when it changes, and once a second."""

    EVERY_NS = 1_000_000_000

    def __init__(self, roster: Roster) -> None:
        self._roster = roster
        self._told: list[Look] = []
        self._told_ns = 0

    def tell(self, stopped: bool, now_ns: int) -> list[m.ChainBody]:
        """The message, when it is time for it."""
        modules = self._roster.modules
        # without the count of link errors, which may change every cycle
        look: list[Look] = [(x.name, x.id, x.serial, x.state, x.fault, stopped) for x in modules]
        if look == self._told and now_ns - self._told_ns < self.EVERY_NS:
            return []
        self._told, self._told_ns = look, now_ns
        infos = tuple(module.info(stopped) for module in modules)
        return [m.ChainBody(stamp_ns=now_ns, chain=self._roster.chain, modules=infos)]


def _read(module: Module, status: StatusPacket) -> bool:
    """Take in one module's readings; False: they are not whole."""
    params = status.params
    if module.kind is _JOINT:
        if len(params) < _ANGLE.size:
            return False
        module.reading = _ANGLE.decode(params)
        return True
    if len(params) < PRESENT_BLOCK.length:
        return False
    module.take(params)
    return True
