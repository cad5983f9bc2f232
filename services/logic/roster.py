"""Who is, or was, on a chain: names and ids by serial number, kept over restarts."""

from __future__ import annotations

from dataclasses import dataclass, field

import msgspec

from runtime.logic import Store
from runtime.messages import ModuleInfo
from runtime.settings import RobotSettings
from runtime.wire.registers import PRESENT_BLOCK, PRESENTS, Kind
from services.logic.reference import Reference

FRESH_ID = 1  # as modules come from the factory; no other may keep it
FIRST_ID = {Kind.MUSCLE: 2, Kind.JOINT: 100}
LAST_ID = {Kind.MUSCLE: 99, Kind.JOINT: 252}

_MUSCLE = Kind.MUSCLE  # looked at all the time, and an enum's member takes 0.1 us
_LENGTH_M, _TENSION_N, _TEMPERATURE_DEGC = (x.scale for x in PRESENTS[:3])  # of one count


@dataclass(slots=True)
class Module:
    """One module and its last readings."""

    name: str
    kind: Kind
    id: int
    serial: int
    reference: Reference
    state: str = "joining"  # joining | up | lost | fault
    fault: str = ""
    polled: bool = False  # it is asked for its readings every cycle
    zeroed: bool = True  # its length means something to others
    link_errors: int = 0
    missed: int = 0  # cycles in a row without an answer
    garbled: int = 0  # of these, how many brought garbage instead
    rescued_ns: int = -(10**18)  # when its tripped watchdog was last cleared
    alert: bool = False
    blinking: bool = False  # its LED, for somebody who looks for it
    reading: float = 0.0  # length [m] of a muscle, angle [rad] of a joint
    tension_n: float = 0.0
    temperature_degc: float = 0.0
    status: int = 0  # bits of `registers.Status`

    @property
    def there(self) -> bool:
        """Whether it answers."""
        return self.state != "lost" and not (self.state == "fault" and not self.polled)

    def take(self, data: bytes) -> None:
        """Take in a muscle's block of present registers."""
        length, tension, temperature, self.status = PRESENT_BLOCK.unpack_raw(data)
        self.reading, self.tension_n = length * _LENGTH_M, tension * _TENSION_N
        self.temperature_degc = temperature * _TEMPERATURE_DEGC

    def hold(self) -> None:
        """Begin anew from what the muscle does; slack that is being wound in goes on being so."""
        if self.zeroed:
            self.reference.hold(self.reading, self.tension_n)
        else:
            self.reference.slacken(self.reading)

    def info(self, stopped: bool) -> ModuleInfo:
        """What others are told of it."""
        return ModuleInfo(
            name=self.name,
            kind=self.kind.name.lower(),
            module_id=self.id,
            serial=self.serial,
            state="stopped" if stopped and self.state == "up" else self.state,
            fault=self.fault,
            tension_limit_n=self.reference.limits.tension_limit_n
            if self.kind is Kind.MUSCLE
            else 0.0,
            link_errors=self.link_errors,
        )


class _Known(msgspec.Struct, frozen=True):
    name: str
    id: int
    kind: int


class _Memory(msgspec.Struct):
    known: dict[int, _Known] = {}
    stopped: bool = False


@dataclass
class Roster:
    """All modules of one chain in the order in which they hang on it, and the memory of them.

    Those that were there at the first start by their ids, then each as it came to the tail.
    """

    settings: RobotSettings
    chain: str
    store: Store
    modules: list[Module] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.clearing: set[int] = set()  # serials that have yet to let go of a cleared stop
        blob = self.store.load(f"chain-{self.chain}")
        try:
            self._memory = msgspec.json.decode(blob, type=_Memory) if blob else _Memory()
        except (msgspec.DecodeError, msgspec.ValidationError):
            self._memory = _Memory()  # names are then given as at the first meeting
        self._filed = {
            **{m.id: (m.name, Kind.MUSCLE) for m in self.settings.muscle if m.chain == self.chain},
            **{j.id: (j.name, Kind.JOINT) for j in self.settings.joint if j.chain == self.chain},
        }

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched."""
        return self._memory.stopped

    @stopped.setter
    def stopped(self, stopped: bool) -> None:
        if stopped != self._memory.stopped:
            self._memory.stopped = stopped
            self.save()

    def save(self) -> None:
        """Keep names and ids for the next start."""
        self.store.save(f"chain-{self.chain}", msgspec.json.encode(self._memory))

    def expected_ids(self) -> list[int]:
        """Where modules should answer, by the robot file and by what was seen before."""
        return sorted({*self._filed, *(known.id for known in self._memory.known.values())})

    def add_missing(self) -> list[Module]:
        """List as lost what was not met though robot file or memory name it; give these."""
        rows = [(k.name, Kind(k.kind), k.id, s) for s, k in self._memory.known.items()]
        rows += [(name, kind, module_id, 0) for module_id, (name, kind) in self._filed.items()]
        missing = []
        for name, kind, module_id, serial in rows:
            if self.by_name(name) is None:
                missing.append(self._new(name, kind, module_id, serial, "lost"))
                self.modules.append(missing[-1])
        return missing

    def known_name(self, serial: int) -> str:
        """The name that this serial number had before, or ""."""
        known = self._memory.known.get(serial)
        return known.name if known else ""

    def name_of(self, serial: int, module_id: int, kind: Kind) -> str:
        """By serial number, else by the robot file, else made up."""
        if name := self.known_name(serial):
            return name
        name, filed_kind = self._filed.get(module_id, ("", kind))
        taken = self.by_name(name)
        if name and filed_kind is kind and (taken is None or not taken.there):
            return name
        return f"{kind.name.lower()}_{serial}"

    def id_for(self, serial: int, kind: Kind) -> int | None:
        """The id it had, if that is still free, else the lowest free one; None: all are taken."""
        known = self._memory.known.get(serial)
        others = {m.id for m in self.modules if m.serial != serial}
        if known and known.id not in others and known.id != FRESH_ID:
            return known.id
        reserved = {k.id for s, k in self._memory.known.items() if s != serial}
        for taken in (others | reserved | set(self._filed), others):
            for module_id in range(FIRST_ID[kind], LAST_ID[kind] + 1):
                if module_id not in taken:
                    return module_id
        return None

    def enter(
        self, name: str, kind: Kind, module_id: int, serial: int, *, at_tail: bool = False
    ) -> Module:
        """Write a module that was met into the list; it takes the place of one gone before it.

        One that was known keeps its place on the chain, unless it was plugged in `at_tail`.
        """
        module = self.by_serial(serial)
        namesake = self.by_name(name)
        if namesake is not None and namesake is not module:
            self.modules.remove(namesake)
        if module is None:
            module = self._new(name, kind, module_id, serial, "joining")
            self.modules.append(module)
        module.name, module.id = name, module_id
        known = {s: k for s, k in self._memory.known.items() if s == serial or k.name != name}
        if at_tail:
            known.pop(serial, None)
        self._memory.known = {**known, serial: _Known(name, module_id, int(kind))}
        place = {s: i for i, s in enumerate(self._memory.known)}
        self.modules.sort(key=lambda other: place.get(other.serial, len(place)))
        self.save()
        return module

    def by_serial(self, serial: int) -> Module | None:
        """The module of that serial number."""
        return next((m for m in self.modules if m.serial == serial), None)

    def by_name(self, name: str) -> Module | None:
        """The module of that name."""
        return next((m for m in self.modules if m.name == name), None)

    def by_id(self, module_id: int) -> Module | None:
        """The module of that id."""
        return next((m for m in self.modules if m.id == module_id), None)

    def muscles(self) -> list[Module]:
        """Muscle modules that are polled."""
        return [m for m in self.modules if m.polled and m.kind is _MUSCLE]

    def _new(self, name: str, kind: Kind, module_id: int, serial: int, state: str) -> Module:
        reference = Reference(self.settings.module)
        return Module(name, kind, module_id, serial, reference, state)
