"""Looks for modules fresh from the factory: they answer on id 1, which no other may keep."""

from __future__ import annotations

from contextlib import suppress

from runtime.wire import packet as wire
from runtime.wire.registers import Kind
from services.logic.conversation import (
    Conversation,
    RefusedError,
    UnansweredError,
    exchange,
    read_serial,
    write,
)
from services.logic.reception import Reception
from services.logic.roster import FRESH_ID

LOOK_NS = 50_000_000  # between two pings
ANNOUNCE_NS = 500_000_000  # how long a fresh module waits to be told its muscle's name
GARBAGE_TIMES = 3  # answers in a row that are garbage: two modules talk at once


class FreshWatch:
    """Gives the one fresh module a name and an id; two at once are an error."""

    def __init__(self, desk: Reception) -> None:
        self._desk = desk
        self._chain = desk.chain
        self._collisions = 0

    def watch(self) -> Conversation[None]:
        """Look for a module on id 1, for ever."""
        while True:
            next_ns = self._desk.now_ns + LOOK_NS
            result = yield from exchange(wire.ping(FRESH_ID))
            try:
                if result.only(FRESH_ID):
                    yield from self._admit()
                    self._collisions = 0
                elif result.garbled or result.statuses:
                    self._collide()
                else:
                    self._collisions = 0
            except UnansweredError as error:
                if error.garbled:
                    self._collide()
            except RefusedError as error:
                self._desk.event("error", "module_ignored", str(error), id=FRESH_ID)
            while self._desk.now_ns < next_ns:
                yield None

    def _collide(self) -> None:
        self._collisions += 1
        if self._collisions == GARBAGE_TIMES:
            self._desk.event(
                "error",
                "two_fresh_modules",
                f"two factory-fresh modules answer on id {FRESH_ID} of chain {self._chain.name}: "
                "unplug one, wait until the other is up, plug it again",
            )

    def _admit(self) -> Conversation[None]:
        """Give the module on id 1 a name and an id of its own."""
        kind, serial = yield from self._desk.identify(FRESH_ID)
        module_id = self._desk.roster.id_for(serial, kind)
        if self._desk.is_full(serial) or module_id is None:
            return
        name = self._desk.roster.known_name(serial)
        met_ns = self._desk.now_ns
        while (
            serial not in self._desk.announced
            and not name
            and self._desk.now_ns < met_ns + ANNOUNCE_NS
        ):
            yield None
        new = not name
        announced = self._desk.announced.pop(serial, "")
        if announced and announced != name:
            name, new = self._desk.free_name(announced, serial), True
        name = name or f"{kind.name.lower()}_{serial}"
        if kind is Kind.MUSCLE:
            yield from write(FRESH_ID, "torque_enable", 0)
        self._desk.admitting = serial
        try:
            yield from self._give_id(module_id, serial)
        finally:
            self._desk.admitting = 0
        module = self._desk.roster.enter(name, kind, module_id, serial, at_tail=True)
        self._desk.event(
            "info",
            "module_found",
            f"a {kind.name.lower()} module was plugged into chain {self._chain.name}: "
            f"{name}, id {module_id}",
            muscle=name,
            id=module_id,
            serial=serial,
        )
        if kind is Kind.MUSCLE:
            self._desk.begin(self._desk.join(module, new))
        else:
            yield from self._desk.resume(module)

    def _give_id(self, module_id: int, serial: int) -> Conversation[None]:
        with suppress(UnansweredError):  # perhaps only the answer got lost: see who is there now
            yield from write(FRESH_ID, "id", module_id)
        if (yield from read_serial(module_id)) != serial:
            raise RefusedError(f"module {serial} did not take id {module_id}")
