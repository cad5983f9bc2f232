"""Who is on the chain? Asked at the start, and ever after while the robot moves.

`start` meets the modules that should be there. Then `FreshWatch` looks for one fresh from the
factory, and `watch_gone` for lost ones and for strangers that brought an id of their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import cycle

from runtime.wire import packet as wire
from services.logic.conversation import Conversation, RefusedError, UnansweredError, exchange
from services.logic.fresh import FreshWatch
from services.logic.reception import Reception
from services.logic.roster import FIRST_ID, FRESH_ID, Module

LOOK_NS = 50_000_000  # between two rounds
GONE_NS = 200_000_000  # between two pings of a lost module
GARBAGE_TIMES = 3  # answers in a row that are garbage: two modules talk at once


class Enumerator:
    """Keeps the roster true.

    Attributes:
        ready: the modules that should be there have been asked.
    """

    def __init__(self, desk: Reception) -> None:
        self.ready = False
        self._desk = desk
        self._roster = desk.roster
        self._chain = desk.chain

    def start(self) -> Conversation[None]:
        """Meet everyone that should be there; wait for the chain while nobody answers at all."""
        expected = self._roster.expected_ids()
        present = yield from self._who(expected)
        if not present and expected:
            self._desk.event(
                "error", "chain_silent", f"no module answers on chain {self._chain.name}"
            )
            while not (yield from self._who([*expected, FRESH_ID])):
                pass
            present = yield from self._who(expected)  # it may have come while they were asked
        for module_id in present:
            yield from self._meet(module_id)
        for module in self._roster.add_missing():
            self._desk.event(
                "warning",
                "lost",
                f"{module.name} does not answer on chain {self._chain.name}, id {module.id}",
                muscle=module.name,
                id=module.id,
            )
        self.ready = True
        self._desk.begin(FreshWatch(self._desk).watch())
        self._desk.begin(self.watch_gone())

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
            kind, serial = yield from self._desk.identify(module_id)
            name = self._desk.announced.get(serial) or self._roster.name_of(serial, module_id, kind)
            module = self._roster.enter(name, kind, module_id, serial)
            yield from self._desk.resume(module)
        except (RefusedError, UnansweredError) as error:
            self._desk.event("error", "module_ignored", str(error), id=module_id)

    def watch_gone(self) -> Conversation[None]:
        """Look for lost modules, and one by one on ids where nobody should be, for ever."""
        others = self._other_ids()
        looked_ns: dict[int, int] = {}
        while True:
            next_ns = self._desk.now_ns + LOOK_NS
            for module in [m for m in self._roster.modules if not m.there]:
                if self._desk.now_ns >= looked_ns.get(module.id, 0) + GONE_NS:
                    looked_ns[module.id] = self._desk.now_ns
                    yield from self._look_for(module)
            module_id = next(others)
            if self._roster.by_id(module_id) is None:
                result = yield from exchange(wire.ping(module_id))
                if result.only(module_id):
                    yield from self._meet_stranger(module_id)
            while self._desk.now_ns < next_ns:
                yield None

    def _other_ids(self) -> Iterator[int]:
        """Ids that a module may bring along: as many as the chain takes, of each kind."""
        count = self._chain.max_modules
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
            kind, serial = yield from self._desk.identify(module.id)
            if serial != module.serial or kind is not module.kind:
                yield from self._meet_stranger(module.id)
                return
            self._desk.event(
                "info", "returned", f"{module.name} is back", muscle=module.name, serial=serial
            )
            if (yield from self._desk.is_slack(module)):
                name = self._desk.announced.pop(serial, module.name)
                new = name != module.name
                module = self._roster.enter(
                    self._desk.free_name(name, serial), kind, module.id, serial
                )
                self._desk.begin(self._desk.join(module, new=new))
            else:
                yield from self._desk.resume(module)
        except (RefusedError, UnansweredError):
            return  # it went again: it will be looked for again

    def _meet_stranger(self, module_id: int) -> Conversation[None]:
        """A module that brought an id of its own, with a wire that may be slack or not."""
        try:
            kind, serial = yield from self._desk.identify(module_id)
            known = self._roster.by_id(module_id)
            admitted = known is not None and known.serial == serial and known.there
            if admitted or serial == self._desk.admitting or self._desk.is_full(serial):
                return  # not by us: on a slow line it has got that id while it was asked who it is
            name = self._desk.announced.pop(serial, "") or self._roster.name_of(
                serial, module_id, kind
            )
            new = name != self._roster.known_name(serial)
            module = self._roster.enter(self._desk.free_name(name, serial), kind, module_id, serial)
            if (yield from self._desk.is_slack(module)):
                self._desk.begin(self._desk.join(module, new))
            else:
                yield from self._desk.resume(module)
        except (RefusedError, UnansweredError):
            return

    def report_duplicate(self, module: Module) -> None:
        """Say that two modules answer on one id; the module is out of service."""
        module.state, module.polled = "fault", False
        module.fault = f"two modules answer on id {module.id}"
        self._desk.event(
            "error",
            "duplicate_id",
            f"two modules answer on id {module.id} of chain {self._chain.name}, which belongs to "
            f"{module.name}: unplug the one that was plugged last and reset it to id {FRESH_ID}",
            muscle=module.name,
            id=module.id,
        )
