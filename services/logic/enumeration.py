"""Who is on the chain? Asked at the start and ever after, while the robot moves.

Four conversations: `start` meets the modules that should be there, `watch_fresh` looks for one
fresh from the factory (id 1), `watch_gone` looks for lost ones and for strangers, and each new
muscle is taken in by a conversation of its own. A module is known by its serial number.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import cycle

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
    exchange,
    read,
    read_block,
    read_serial,
    write,
)
from services.logic.roster import FIRST_ID, FRESH_ID, Module, Roster

LOOK_NS = 50_000_000  # between two pings of id 1
GONE_NS = 200_000_000  # between two pings of a lost module
ANNOUNCE_NS = 500_000_000  # how long a fresh module waits to be told its muscle's name
GARBAGE_TIMES = 3  # answers in a row that are garbage: two modules talk at once


class Enumerator:
    """Keeps the roster true.

    Attributes:
        ready: the modules that should be there have been asked.
        announced: serial number -> muscle, as the person said who plugged the module in.
        now_ns: robot time, set by the driver before it runs conversations.
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
        self.ready = False
        self.announced: dict[int, str] = {}
        self.now_ns = 0
        self._begin = begin
        self._event = event
        self._collisions = 0
        self._turned_away = 0  # serial number of a fresh module that found the chain full

    def hear(self, event: Event) -> None:
        """Learn from `plugged` events which muscle a serial number is."""
        if event.kind != "plugged" or event.data.get("chain") != self.chain.name:
            return
        try:
            self.announced[int(event.data["serial"], 0)] = event.data["muscle"]
        except (KeyError, ValueError):
            return  # it announces nothing that could be used

    # ── start ─────────────────────────────────────────────────────────────────────────────────

    def start(self) -> Conversation[None]:
        """Meet everyone that should be there; wait for the chain while nobody answers at all."""
        expected = self.roster.expected_ids()
        present = yield from self._who(expected)
        if not present and expected:
            self._event("error", "chain_silent", f"no module answers on chain {self.chain.name}")
            while not (yield from self._who([*expected, FRESH_ID])):
                pass
            present = yield from self._who(expected)  # it may have come while they were asked
        for module_id in present:
            yield from self._meet(module_id)
        for module in self.roster.add_missing():
            self._event(
                "warning",
                "lost",
                f"{module.name} does not answer on chain {self.chain.name}, id {module.id}",
                muscle=module.name,
                id=module.id,
            )
        self.ready = True
        self._begin(self.watch_fresh())
        self._begin(self.watch_gone())

    def _who(self, ids: list[int]) -> Conversation[list[int]]:
        present = []
        for module_id in ids:
            for _ in range(2):
                result = yield from exchange(wire.ping(module_id))
                if result.statuses or result.garbled:
                    present.append(module_id)
                    break
            yield None
        return present

    def _meet(self, module_id: int) -> Conversation[None]:
        """Take a module into service that answers on an id of its own."""
        try:
            kind, serial = yield from self._identify(module_id)
            name = self.announced.get(serial) or self.roster.name_of(serial, module_id, kind)
            module = self.roster.enter(name, kind, module_id, serial)
            yield from self._resume(module)
        except (RefusedError, UnansweredError) as error:
            self._event("error", "module_ignored", str(error), id=module_id)

    def _identify(self, module_id: int) -> Conversation[tuple[Kind, int]]:
        status = yield from ask(wire.ping(module_id))
        model = int.from_bytes(status.params[:2], "little")
        if model not in tuple(Kind):
            raise RefusedError(
                f"module id {module_id} is of model {model:#06x}, which is neither a muscle "
                "module nor a joint module: take it off the chain"
            )
        return Kind(model), (yield from read_serial(module_id))

    def _resume(self, module: Module) -> Conversation[None]:
        """Go on with a module as it is."""
        if module.kind is Kind.MUSCLE:
            stiffness = self.settings.control.stiffness_n_m
            if (yield from joining.take_over(module, self.chain, stiffness)):
                self.roster.stopped = True
        module.state, module.fault = "up", ""
        module.polled, module.missed, module.garbled = True, 0, 0
        module.alert = False

    # ── fresh modules ─────────────────────────────────────────────────────────────────────────

    def watch_fresh(self) -> Conversation[None]:
        """Look for a module on id 1, for ever."""
        while True:
            next_ns = self.now_ns + LOOK_NS
            result = yield from exchange(wire.ping(FRESH_ID))
            try:
                if result.only(FRESH_ID):
                    yield from self._admit()
                    self._collisions = 0
                elif result.garbled or result.statuses:
                    self._collide()
                else:
                    self._collisions, self._turned_away = 0, 0
            except UnansweredError as error:
                if error.garbled:
                    self._collide()
            except RefusedError as error:
                self._event("error", "module_ignored", str(error), id=FRESH_ID)
            while self.now_ns < next_ns:
                yield None

    def _collide(self) -> None:
        self._collisions += 1
        if self._collisions == GARBAGE_TIMES:
            self._event(
                "error",
                "two_fresh_modules",
                f"two factory-fresh modules answer on id {FRESH_ID} of chain {self.chain.name}: "
                "unplug one, wait until the other is up, plug it again",
            )

    def _admit(self) -> Conversation[None]:
        """Give the module on id 1 a name and an id of its own."""
        kind, serial = yield from self._identify(FRESH_ID)
        module_id = self.roster.id_for(serial, kind)
        there = sum(module.there for module in self.roster.modules if module.serial != serial)
        if there >= self.chain.max_modules or module_id is None:
            if self._turned_away != serial:
                self._turned_away = serial
                self._event(
                    "error",
                    "chain_full",
                    f"chain {self.chain.name} has its {there} modules: module {serial} stays on "
                    f"id {FRESH_ID} with its torque off; unplug it, or raise max_modules",
                    serial=serial,
                )
            return
        name = self.roster.known_name(serial)
        met_ns = self.now_ns
        while serial not in self.announced and not name and self.now_ns < met_ns + ANNOUNCE_NS:
            yield None
        new = not name
        announced = self.announced.pop(serial, "")
        if announced and announced != name:
            name, new = self._free_name(announced, serial), True
        name = name or f"{kind.name.lower()}_{serial}"
        if kind is Kind.MUSCLE:
            yield from write(FRESH_ID, "torque_enable", 0)
        yield from self._give_id(module_id, serial)
        module = self.roster.enter(name, kind, module_id, serial)
        self._event(
            "info",
            "module_found",
            f"a {kind.name.lower()} module was plugged into chain {self.chain.name}: "
            f"{name}, id {module_id}",
            muscle=name,
            id=module_id,
            serial=serial,
        )
        if kind is Kind.MUSCLE:
            self._begin(self._join(module, new))
        else:
            yield from self._resume(module)

    def _give_id(self, module_id: int, serial: int) -> Conversation[None]:
        with suppress(UnansweredError):  # perhaps only the answer got lost: see who is there now
            yield from write(FRESH_ID, "id", module_id)
        if (yield from read_serial(module_id)) != serial:
            raise RefusedError(f"module {serial} did not take id {module_id}")

    def _free_name(self, name: str, serial: int) -> str:
        holder = self.roster.by_name(name)
        if holder is None or holder.serial == serial or not holder.there:
            return name
        other = f"{name}_{serial}"
        text = f"there is a {name} already; the new one is called {other}"
        self._event("warning", "name_taken", text, muscle=other, serial=serial)
        return other

    def _join(self, module: Module, new: bool) -> Conversation[None]:
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
            self._event(
                "error", "join_failed", f"{module.name}: {error}", muscle=module.name, id=module.id
            )
            return
        module.state, module.zeroed = "up", True
        self._event(
            "info",
            "joined",
            f"{module.name} is wound in and zeroed: id {module.id} on chain {self.chain.name}",
            muscle=module.name,
            id=module.id,
            serial=module.serial,
            new="true" if new else "false",
        )

    # ── modules that went, and strangers ──────────────────────────────────────────────────────

    def watch_gone(self) -> Conversation[None]:
        """Look for lost modules, and one by one on ids where nobody should be, for ever."""
        others = self._other_ids()
        looked_ns: dict[int, int] = {}
        while True:
            next_ns = self.now_ns + LOOK_NS
            for module in [m for m in self.roster.modules if not m.there]:
                if self.now_ns >= looked_ns.get(module.id, 0) + GONE_NS:
                    looked_ns[module.id] = self.now_ns
                    yield from self._look_for(module)
            module_id = next(others)
            if self.roster.by_id(module_id) is None:
                result = yield from exchange(wire.ping(module_id))
                if result.only(module_id):
                    yield from self._meet_stranger(module_id)
            while self.now_ns < next_ns:
                yield None

    def _other_ids(self) -> Iterator[int]:
        """Ids that a module may bring along: as many as the chain takes, of each kind."""
        count = self.chain.max_modules
        return cycle([first + n for first in FIRST_ID.values() for n in range(count)])

    def _look_for(self, module: Module) -> Conversation[None]:
        result = yield from exchange(wire.ping(module.id))
        if not result.only(module.id):
            if result.garbled:
                module.garbled += 1
                if module.garbled == GARBAGE_TIMES and module.state == "lost":
                    self.report_duplicate(module)
            return
        try:
            kind, serial = yield from self._identify(module.id)
            if serial != module.serial or kind is not module.kind:
                yield from self._meet_stranger(module.id)
                return
            self._event(
                "info", "returned", f"{module.name} is back", muscle=module.name, serial=serial
            )
            if (yield from self._slack(module)):
                name = self.announced.pop(serial, module.name)
                new = name != module.name
                module = self.roster.enter(self._free_name(name, serial), kind, module.id, serial)
                self._begin(self._join(module, new=new))
            else:
                yield from self._resume(module)
        except (RefusedError, UnansweredError):
            return  # it went again: it will be looked for again

    def _meet_stranger(self, module_id: int) -> Conversation[None]:
        """A module that brought an id of its own, with a wire that may be slack or not."""
        try:
            kind, serial = yield from self._identify(module_id)
            there = sum(module.there for module in self.roster.modules)
            if there >= self.chain.max_modules:
                return
            name = self.announced.pop(serial, "") or self.roster.name_of(serial, module_id, kind)
            new = name != self.roster.known_name(serial)
            module = self.roster.enter(self._free_name(name, serial), kind, module_id, serial)
            if (yield from self._slack(module)):
                self._begin(self._join(module, new))
            else:
                yield from self._resume(module)
        except (RefusedError, UnansweredError):
            return

    def _slack(self, module: Module) -> Conversation[bool]:
        """Whether its wire was attached just now: it was without power, and it holds nothing."""
        if module.kind is not Kind.MUSCLE:
            return False
        torque = yield from read(module.id, "torque_enable")
        present = yield from read_block(module.id, PRESENT_BLOCK)
        return not torque and abs(present["present_tension"]) < joining.SLACK_N

    def report_duplicate(self, module: Module) -> None:
        """Say that two modules answer on one id; the module is out of service."""
        module.state, module.polled = "fault", False
        module.fault = f"two modules answer on id {module.id}"
        self._event(
            "error",
            "duplicate_id",
            f"two modules answer on id {module.id} of chain {self.chain.name}, where {module.name} "
            "should be alone: unplug the one that was plugged last and give it id "
            f"{FRESH_ID} (factory reset)",
            muscle=module.name,
            id=module.id,
        )
