"""How a module that answers is taken into service: who it is, and with what it begins.

A module is known by its serial number, so that it keeps name and id wherever it is plugged in. A
muscle's name comes from the person who plugged it in, by a `plugged` event.
"""

from __future__ import annotations

from collections.abc import Callable

from runtime.messages import Event
from runtime.settings import RobotSettings
from runtime.wire import packet as wire
from runtime.wire.registers import PRESENT_BLOCK, Kind, Status
from services.logic import joining
from services.logic.conversation import (
    Conversation,
    RefusedError,
    UnansweredError,
    ask,
    read,
    read_block,
    read_serial,
)
from services.logic.roster import Module, Roster


class Reception:
    """What all that look for modules share.

    Attributes:
        announced: serial number -> muscle, as the person said who plugged the module in.
        now_ns: robot time, set by the driver before it runs conversations.
        begin: starts a conversation beside the others.
        event: publishes an event: level, kind, text, data.
    """

    def __init__(
        self,
        settings: RobotSettings,
        roster: Roster,
        begin: Callable[[Conversation[None]], None],
        event: Callable[..., None],
    ) -> None:
        self.settings = settings
        self.chain = next(c for c in settings.chain if c.name == roster.chain)
        self.roster = roster
        self.announced: dict[int, str] = {}
        self.admitting = 0  # serial number of the module that is just being given an id
        self.now_ns = 0
        self.begin = begin
        self.event = event
        self._turned_away: set[int] = set()

    def hear(self, event: Event) -> None:
        """Learn from `plugged` events which muscle a serial number is."""
        if event.kind != "plugged" or event.data.get("chain") != self.chain.name:
            return
        try:
            self.announced[int(event.data["serial"], 0)] = event.data["muscle"]
        except (KeyError, ValueError):
            return  # it announces nothing that could be used

    def identify(self, module_id: int) -> Conversation[tuple[Kind, int]]:
        """Kind and serial number of what is on that id. Raises RefusedError: no module of ours."""
        status = yield from ask(wire.ping(module_id))
        model = int.from_bytes(status.params[:2], "little")
        if model not in tuple(Kind):
            raise RefusedError(
                f"module id {module_id} is of model {model:#06x}, which is neither a muscle "
                "module nor a joint module: take it off the chain"
            )
        return Kind(model), (yield from read_serial(module_id))

    def resume(self, module: Module) -> Conversation[None]:
        """Go on with a module as it is."""
        if module.kind is Kind.MUSCLE:
            stiffness = self.settings.control.stiffness_n_m
            latched = yield from joining.take_over(module, self.chain, stiffness)
            if latched and module.serial not in self.roster.clearing:
                self.roster.stopped = True
        module.state, module.fault = "up", ""
        module.polled, module.missed, module.garbled = True, 0, 0
        module.alert = False

    def join(self, module: Module, new: bool) -> Conversation[None]:
        """Tare, wind in, zero; any failure leaves the module braked and says why."""
        module.state, module.fault = "joining", ""
        module.polled, module.zeroed, module.alert = False, False, False
        module.missed, module.garbled = 0, 0
        try:
            yield from joining.prepare_slack(module, self.chain)
            module.polled = True
            wind_in = joining.WindIn(self.now_ns)
            while not wind_in.done(module, self.now_ns):
                yield None
                if module.state != "joining":
                    return  # lost meanwhile
                if self.roster.stopped or not module.status & Status.FOLLOWING:
                    wind_in = joining.WindIn(self.now_ns)
            yield from joining.zero_length(module)
            yield None
            yield None  # a reading from before the zero was set may still have been under way
        except (RefusedError, UnansweredError) as error:
            if module.state != "joining":
                return
            module.state, module.fault, module.polled = "fault", str(error), True
            self.event(
                "error", "join_failed", f"{module.name}: {error}", muscle=module.name, id=module.id
            )
            return
        module.state, module.zeroed = "up", True
        self.event(
            "info",
            "joined",
            f"{module.name} is wound in and zeroed: id {module.id} on chain {self.chain.name}",
            muscle=module.name,
            id=module.id,
            serial=module.serial,
            new="true" if new else "false",
        )

    def is_slack(self, module: Module) -> Conversation[bool]:
        """Whether its wire was attached just now: it was without power, and it holds nothing."""
        if module.kind is not Kind.MUSCLE:
            return False
        torque = yield from read(module.id, "torque_enable")
        present = yield from read_block(module.id, PRESENT_BLOCK)
        return not torque and abs(present["present_tension"]) < joining.SLACK_N

    def is_full(self, serial: int) -> bool:
        """Whether the chain has no room for that module; said once for each."""
        there = sum(module.there for module in self.roster.modules if module.serial != serial)
        if there < self.chain.max_modules:
            self._turned_away.discard(serial)
            return False
        if serial not in self._turned_away:
            self._turned_away.add(serial)
            text = (
                f"chain {self.chain.name} has its {there} modules: module {serial} is left alone "
                "with its torque off; unplug it, or raise max_modules"
            )
            self.event("error", "chain_full", text, serial=serial)
        return True

    def free_name(self, name: str, serial: int) -> str:
        """The name, or another one while a module that is there has it."""
        holder = self.roster.by_name(name)
        if holder is None or holder.serial == serial or not holder.there:
            return name
        other = f"{name}_{serial}"
        text = f"there is a {name} already; the new one is called {other}"
        self.event("warning", "name_taken", text, muscle=other, serial=serial)
        return other
