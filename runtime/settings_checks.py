"""What a robot file may say beyond its types: names that exist, free ids, limits that make sense.

Each check yields its mistakes in the order of the file; the first one is what a person is told.
"""

from __future__ import annotations

import ipaddress
import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from runtime.body_checks import body_mistakes
from runtime.messages import METHODS
from runtime.settings import Joint, Muscle, RobotSettings, Spare, TaskPath
from runtime.settings_file import Mistake
from runtime.suggestion import suggestion
from runtime.toml_lines import KeyPath
from runtime.wire.registers import BAUD_RATES, BY_NAME

FRESH_ID = BY_NAME["id"].default
LAST_ID = BY_NAME["id"].high
WATCHDOG_STEP_MS = round(1000 * BY_NAME["bus_watchdog"].scale)

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")  # safe as key segment, file name and word
_RESERVED_TASKS = ("park", "hold", "cancel")  # `Task` requests these by name, too


class _Range(NamedTuple):
    """What a number may be. The key's name carries its unit."""

    table: str
    key: str
    low: float = 0.0
    high: float = math.inf
    low_too: bool = False  # the low end itself is allowed

    @property
    def words(self) -> str:
        """What it may be: `above 0 and at most 1000`."""
        words = f"{self.low:g} or more" if self.low_too else f"above {self.low:g}"
        return words + ("" if self.high == math.inf else f" and at most {self.high:g}")

    def refusal(self, value: float) -> str:
        """Why the value is refused, or ""."""
        above = self.low <= value if self.low_too else self.low < value
        if above and value <= self.high and math.isfinite(value):
            return ""
        return f"{self.key} has to be {self.words}, found {value:g}"


def _register_max(name: str) -> float:
    """The greatest value that the register can hold: a module would refuse more."""
    return BY_NAME[name].high * BY_NAME[name].scale


RANGES = (
    _Range("chain", "rate_hz", high=1000),
    _Range("chain", "max_modules", high=LAST_ID - FRESH_ID),
    _Range("chain", "watchdog_ms", high=1000 * _register_max("bus_watchdog")),
    _Range("module", "tension_limit_n", high=_register_max("tension_limit")),
    _Range("module", "winding_speed_m_s", high=_register_max("winding_speed_limit")),
    _Range("module", "temperature_limit_degc", high=_register_max("temperature_limit")),
    _Range("module", "spool_radius_m", high=0.1),
    _Range("control", "tension_floor_n"),
    _Range("control", "tension_ceiling_n"),
    _Range("control", "stiffness_n_m", high=_register_max("stiffness")),
    _Range("control", "joint_speed_deg_s"),
    _Range("control", "settle_s"),
    _Range("growth", "n_new"),
    _Range("growth", "n_check"),
    _Range("growth", "bias_min_n"),
    _Range("growth", "bias_max_n"),
    _Range("growth", "residual_limit_mm"),
    _Range("payload", "mass_kg", high=1000),
    _Range("web", "port", high=65_535),
    _Range("simulation", "assembly_error_m", high=0.1, low_too=True),
    _Range("simulation", "tension_noise_n", low_too=True),
    _Range("simulation", "length_noise_m", low_too=True),
    _Range("simulation", "angle_noise_rad", low_too=True),
    _Range("simulation", "wire_friction", high=2, low_too=True),
    _Range("simulation", "heating_degc_n2", low_too=True),
    _Range("simulation", "thermal_time_s", low=1.0, low_too=True),
    _Range("simulation", "motor_lag_s", low_too=True),
    _Range("simulation", "stall_tension_n"),
    _Range("simulation", "ambient_degc", low=-40, high=80, low_too=True),
)


def robot_mistakes(settings: RobotSettings) -> Iterator[Mistake]:
    """Everything that cannot be, whatever the body is, and then what the body says."""
    yield from _names(settings)
    yield from _chains(settings)
    yield from _ids(settings)
    yield from _ranges(settings)
    yield from _orders(settings)
    yield from _tasks(settings)
    yield from _web(settings)
    yield from body_mistakes(settings)


def _names(settings: RobotSettings) -> Iterator[Mistake]:
    rule = "use letters, digits, '_' and '-' only: it becomes a part of every key"
    if not NAME.fullmatch(settings.robot.name):
        yield Mistake(("robot", "name"), f"robot name '{settings.robot.name}' cannot be; {rule}")
    muscles = [(("muscle", i, "name"), row.name) for i, row in enumerate(settings.muscle)]
    muscles += [(("spare", i, "name"), row.name) for i, row in enumerate(settings.spare)]
    for kind, rows in (
        ("chain", [(("chain", i, "name"), row.name) for i, row in enumerate(settings.chain)]),
        ("joint", [(("joint", i, "name"), row.name) for i, row in enumerate(settings.joint)]),
        ("muscle", muscles),
        ("task", [(("task", i, "name"), row.name) for i, row in enumerate(settings.task)]),
        ("payload", [(("payload", i, "name"), x.name) for i, x in enumerate(settings.payload)]),
    ):
        yield from _unique(kind, rows)
    for index, chain in enumerate(settings.chain):
        if not NAME.fullmatch(chain.name):
            yield Mistake(("chain", index, "name"), f"chain name '{chain.name}' cannot be; {rule}")
    for index, task in enumerate(settings.task):
        if task.name in _RESERVED_TASKS:
            yield Mistake(
                ("task", index, "name"),
                f"task name '{task.name}' is kept for the request of that name; use another",
            )
    for table, count in (("chain", settings.chain), ("joint", settings.joint)):
        if not count:
            yield Mistake((table,), f"there has to be at least one [[{table}]]")


def _unique(kind: str, rows: Sequence[tuple[KeyPath, str]]) -> Iterator[Mistake]:
    seen: set[str] = set()
    for key, name in rows:
        if not name:
            yield Mistake(key, f"a {kind}'s name is empty; give it one")
        if name in seen:
            yield Mistake(key, f"a second {kind} is named '{name}'; give it a name of its own")
        seen.add(name)


def _chains(settings: RobotSettings) -> Iterator[Mistake]:
    known = [chain.name for chain in settings.chain]
    tables: dict[str, tuple[Joint | Muscle | Spare, ...]] = {
        "joint": settings.joint,
        "muscle": settings.muscle,
        "spare": settings.spare,
    }
    for table, rows in tables.items():
        for index, row in enumerate(rows):
            if row.chain not in known:
                yield Mistake(
                    (table, index, "chain"),
                    f"{table} '{row.name}' is on chain '{row.chain}', which no [[chain]] names"
                    + suggestion(row.chain, known),
                )
    for index, chain in enumerate(settings.chain):
        if chain.baud not in BAUD_RATES:
            rates = ", ".join(f"{rate:_}" for rate in BAUD_RATES)
            yield Mistake(
                ("chain", index, "baud"),
                f"chain '{chain.name}': no module speaks at {chain.baud} baud; use one of {rates}",
            )
        if not re.match(r"sim:|serial:///\w", chain.link):
            yield Mistake(
                ("chain", index, "link"),
                f"chain '{chain.name}': link '{chain.link}' cannot be;"
                " use sim: or serial:///dev/ttyUSB0",
            )


def _ids(settings: RobotSettings) -> Iterator[Mistake]:
    taken: dict[tuple[str, int], str] = {}
    rows: list[tuple[KeyPath, str, Joint | Muscle]] = [
        (("joint", i, "id"), "joint", row) for i, row in enumerate(settings.joint)
    ]
    rows += [(("muscle", i, "id"), "muscle", row) for i, row in enumerate(settings.muscle)]
    used = {(row.chain, row.id) for *_, row in rows}
    for key, kind, row in rows:
        who = f"{kind} '{row.name}'"
        first = taken.setdefault((row.chain, row.id), who)
        free = next(n for n in range(FRESH_ID + 1, 999) if (row.chain, n) not in used)
        if row.id == FRESH_ID:
            yield Mistake(key, f"{who}: id {FRESH_ID} is kept for fresh modules; {free} is free")
        elif not FRESH_ID < row.id <= LAST_ID:
            yield Mistake(
                key, f"{who}: id {row.id} is out of range; use {FRESH_ID + 1} to {LAST_ID}"
            )
        elif first != who:
            yield Mistake(
                key,
                f"{who} has id {row.id}, which {first} on chain '{row.chain}' has already;"
                f" {free} is free",
            )
    for index, chain in enumerate(settings.chain):
        count = sum(row.chain == chain.name for *_, row in rows)
        if count > chain.max_modules:
            yield Mistake(
                ("chain", index, "max_modules"),
                f"chain '{chain.name}' has {count} modules, max_modules is {chain.max_modules}",
            )


def _ranges(settings: RobotSettings) -> Iterator[Mistake]:
    for rule in RANGES:
        part = getattr(settings, rule.table)
        rows = enumerate(part) if isinstance(part, tuple) else ((None, part),)
        for index, row in rows:
            refusal = rule.refusal(getattr(row, rule.key))
            key = (rule.table, rule.key) if index is None else (rule.table, index, rule.key)
            owner = f"[{rule.table}]" if index is None else f"{rule.table} '{row.name}'"
            if refusal:
                yield Mistake(key, f"{owner}: {refusal}")
    for index, chain in enumerate(settings.chain):
        if chain.watchdog_ms % WATCHDOG_STEP_MS:
            yield Mistake(
                ("chain", index, "watchdog_ms"),
                f"chain '{chain.name}': watchdog_ms counts in steps of {WATCHDOG_STEP_MS},"
                f" found {chain.watchdog_ms}",
            )


def _orders(settings: RobotSettings) -> Iterator[Mistake]:
    """Numbers that have to stand in an order."""
    control, growth, limit = settings.control, settings.growth, settings.module.tension_limit_n
    if control.tension_ceiling_n > limit:
        yield Mistake(
            ("control", "tension_ceiling_n"),
            f"[control]: tension_ceiling_n {control.tension_ceiling_n:g} is above the modules'"
            f" tension_limit_n {limit:g}; lower it",
        )
    if control.tension_floor_n >= control.tension_ceiling_n:
        yield Mistake(
            ("control", "tension_floor_n"),
            f"[control]: tension_floor_n {control.tension_floor_n:g} has to be below"
            f" tension_ceiling_n {control.tension_ceiling_n:g}",
        )
    if growth.bias_min_n > growth.bias_max_n or growth.bias_max_n > limit:
        yield Mistake(
            ("growth", "bias_max_n"),
            f"[growth]: bias_min_n {growth.bias_min_n:g}, bias_max_n {growth.bias_max_n:g} and"
            f" the modules' tension_limit_n {limit:g} have to stand in this order",
        )
    if growth.method not in METHODS:
        yield Mistake(
            ("growth", "method"),
            f"[growth]: no method '{growth.method}'; use one of {', '.join(METHODS)}",
        )
    elastic = settings.simulation.elastic_n_m
    if min(elastic) < 0.0 or not 0.0 < sum(elastic) < math.inf:
        yield Mistake(
            ("simulation", "elastic_n_m"),
            "[simulation]: elastic_n_m has to rise: no coefficient below 0 and one above",
        )


def _tasks(settings: RobotSettings) -> Iterator[Mistake]:
    count = len(settings.joint)
    for index, task in enumerate(settings.task):
        key: KeyPath = ("task", index, "targets_deg")
        if not task.targets_deg:
            yield Mistake(key, f"task '{task.name}' has no targets; give at least one posture")
        for step, target in enumerate(task.targets_deg):
            if len(target) != count:
                yield Mistake(
                    (*key, step),
                    f"task '{task.name}', target {step + 1} has {len(target)} angles, there are"
                    f" {count} joints: {', '.join(settings.joints)}",
                )
        names = [other.name for other in settings.task]
        if task.back and task.back not in names:
            yield Mistake(
                ("task", index, "back"),
                f"task '{task.name}' is undone by '{task.back}', which no [[task]] is"
                + suggestion(task.back, names),
            )
        yield from _carrying(settings, index, task)


def _web(settings: RobotSettings) -> Iterator[Mistake]:
    """An address to listen on. Whether its files are there, the process that reads them says."""
    web = settings.web
    try:
        ipaddress.ip_address(web.address)
    except ValueError:
        text = f"[web]: address '{web.address}' is no IP address; use 127.0.0.1 for this host only"
        yield Mistake(("web", "address"), f"{text}, 0.0.0.0 for all of its addresses")
    if bool(web.certificate) != bool(web.key):
        given = "certificate" if web.certificate else "key"
        yield Mistake(("web", given), "[web]: certificate and key go together: PEM files both")


def _carrying(settings: RobotSettings, index: int, task: TaskPath) -> Iterator[Mistake]:
    """Whether a task's grasp and release make sense."""
    known = [payload.name for payload in settings.payload]
    if task.payload and task.payload not in known:
        yield Mistake(
            ("task", index, "payload"),
            f"task '{task.name}' carries '{task.payload}', which no [[payload]] names"
            + suggestion(task.payload, known),
        )
    if not task.payload and not task.grasp_at and not task.release_at:
        return
    if not task.payload or not 1 <= task.grasp_at < task.release_at <= len(task.targets_deg):
        yield Mistake(
            ("task", index, "grasp_at" if task.grasp_at else "payload"),
            f"task '{task.name}': payload, grasp_at and release_at go together, with 1 <= grasp_at"
            f" < release_at <= {len(task.targets_deg)}, the number of its targets",
        )
