"""Write docs/reference/ and ARCHITECTURE.md's tables from the code: `python -m docs.reference`."""

from __future__ import annotations

import argparse
import ast
import inspect
import re
from collections.abc import Iterator
from enum import IntEnum
from functools import partial
from itertools import groupby
from pathlib import Path

import msgspec

from docs.markdown import code, page, table, toml
from docs.source import Class, Field, classes
from experiments import __main__ as experiments
from hardware_sim import terminals
from runtime import envelope, messages, settings, topics
from runtime.cli import main as cli
from runtime.messages import Message
from runtime.settings_checks import RANGES
from runtime.wire import packet, registers
from runtime.wire.registers import BAUD_RATES, MEANINGS, TABLE, Kind, Register

ROOT = Path(__file__).parent.parent
ARCHITECTURE = ROOT / "ARCHITECTURE.md"
BEGIN, END = "<!-- topics -->", "<!-- /topics -->"
SENT = {row.message.__name__ for row in (*topics.TOPICS, *topics.REQUESTS)}
WIDTH = 96  # of a command's help


def pages() -> dict[Path, str]:
    """Every page that the code makes, and its text."""
    folder = ROOT / "docs" / "reference"
    return {
        ARCHITECTURE: with_topics(ARCHITECTURE.read_text(encoding="utf-8")),
        folder / "messages.md": page(_messages()),
        folder / "registers.md": page(_registers()),
        folder / "robot-file.md": page(_robot_file()),
        folder / "commands.md": page(_commands()),
    }


def with_topics(text: str) -> str:
    """The page with the present tables of topics and requests between its markers."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{_topics()}\n\n{_requests()}\n{END}{after}"


def _doc(thing: object) -> str:
    return inspect.cleandoc(thing.__doc__ or "")


def _first_line(kind: type) -> str:
    return _doc(kind).partition("\n")[0]


# ── keys and messages ─────────────────────────────────────────────────────────────────────────


def _topics() -> str:
    rows = ((*_named(x), _rate(x), x.keep.value, _first_line(x.message)) for x in topics.TOPICS)
    return table("key|message|rate|keep|says", rows)


def _requests() -> str:
    rows = ((*_named(x), f"{x.timeout_s:g} s", _first_line(x.message)) for x in topics.REQUESTS)
    return table("request|message|answered within|asks to", rows)


def _named(row: topics.Topic | topics.Request) -> tuple[str, str]:
    return f"`{{robot}}/{row.key}`", f"`{row.message.__name__}`"


def _rate(row: topics.Topic) -> str:
    return f"{row.rate_hz:g} Hz" if row.rate_hz else "when it happens"


def _messages() -> Iterator[str]:
    yield "Keys and messages"
    yield (
        "A payload is a MessagePack map from field names to values, under the encoding\n"
        f"`{envelope.encoding_of(messages.ChainState)}`: type and version. Quantities are in SI "
        "units\nunless the name says otherwise. A reader passes over fields that it does not know; "
        "what is malformed,\nforeign or of a newer version it counts, tells of once, and drops. "
        "Code: `runtime/messages.py`,\n`runtime/topics.py`, `runtime/envelope.py`."
    )
    yield "## Keys"
    yield _topics()
    keeps = classes(topics)["Keep"].fields
    yield "\n".join(f"- `{ast.literal_eval(keep.default)}`: {keep.meaning}" for keep in keeps)
    yield (
        f"A process is alive while the liveliness token `{{robot}}/{topics.TOKEN_KEY}` stands: "
        "`Presence`."
    )
    yield "## Requests"
    yield (
        "A Zenoh query with the request as payload, answered with a [Reply](#reply)\n"
        "by everybody who serves it: each driver stops its own chain."
    )
    yield _requests()
    found = {n: c for n, c in classes(messages).items() if c.fields or n in SENT}
    for section, group in groupby(found.values(), lambda row: row.section):
        yield f"## {section[:1].upper()}{section[1:]}" if section else "## What all have"
        for row in group:
            yield from _message(row)


def _message(row: Class) -> Iterator[str]:
    kind = getattr(messages, row.name)
    yield f"### {row.name}"
    yield _doc(kind)
    where = topics.BY_TYPE.get(kind)
    asked = topics.REQUEST_BY_TYPE.get(kind)
    if where:
        yield f"`{{robot}}/{where.key}`, {_rate(where)}, {where.keep.value}"
    if asked:
        yield f"`{{robot}}/{asked.key}`, a request"
    parent = kind.__mro__[1]
    if issubclass(kind, Message) and parent not in (Message, msgspec.Struct):
        yield f"All fields of [{parent.__name__}](#{parent.__name__.lower()}), and:"
    if row.fields:
        yield table(
            "field|type|unit|default|meaning",
            (
                (f"`{f.name}`", _linked(f.type), f.unit, code(f.default), f.meaning)
                for f in row.fields
            ),
        )


def _linked(words: str) -> str:
    """The type, with a link to what a struct is."""
    names = "|".join(name for name in classes(messages) if name not in SENT)
    return re.sub(rf"\b({names})\b", lambda found: f"[{found[1]}](#{found[1].lower()})", words)


# ── registers ─────────────────────────────────────────────────────────────────────────────────


def _registers() -> Iterator[str]:
    yield "Registers"
    yield (
        "Modules speak Dynamixel Protocol 2.0. A register is a little-endian integer; times its "
        "scale it is the\nvalue. Up to address 146 they are as on the X series, where they mean "
        "the same. Code: `runtime/wire/registers.py`,\n`runtime/wire/packet.py`."
    )
    for kind, title in ((Kind.MUSCLE, "Muscle module"), (Kind.JOINT, "Joint module")):
        yield f"## {title}"
        rows = [row for row in TABLE if kind in row.kinds]
        yield table("address|name|bytes|access|scale|default|may be|meaning", map(_register, rows))
    yield (
        "Access `eeprom` is kept when the module is switched off, and written only while torque is "
        "off; `ram` goes back\nto its default; `read only` is neither."
    )
    goals = registers.GOAL_BLOCK, registers.PRESENT_BLOCK
    names = [f"{b.address} to {b.address + b.length - 1}" for b in goals]
    yield (
        f"One sync write to {names[0]} commands a chain, one sync read of {names[1]} senses it; a "
        "joint module answers\nits first 4 bytes."
    )
    yield "## Bits"
    yield from _bits("status", registers.Status)
    yield from _bits("hardware_error", registers.HardwareError)
    yield "## Baud rates"
    yield table("index|baud", ((str(i), f"{rate}") for i, rate in enumerate(BAUD_RATES)))
    yield "## Instructions"
    yield table(
        "code|instruction|meaning",
        (
            (f"{int(row.default, 0):#04x}", row.name.lower(), row.meaning)
            for row in classes(packet)["Instruction"].fields
        ),
    )
    yield "Errors of a status packet; 128 is added while `hardware_error` is not 0:"
    yield table(
        "error|name|meaning",
        (
            (row.default, row.name.lower(), row.meaning)
            for row in classes(packet)["StatusError"].fields
        ),
    )


def _register(row: Register) -> tuple[str, ...]:
    writable = row.keep is not registers.Keep.READ_ONLY

    def value(raw: int) -> str:
        return f"{raw * row.scale:.6g}"

    largest = min(row.high, 2 ** (8 * row.size - row.signed) - 1)
    return (
        str(row.address),
        f"`{row.name}`",
        f"{row.size}{', signed' if row.signed else ''}",
        row.keep.value,
        f"{row.scale:.6g} {row.unit}".strip() if row.unit else "",
        value(row.default) if writable or row.default else "",
        f"{value(row.low)} to {value(largest)}" if writable else "",
        MEANINGS[row.name],
    )


def _bits(name: str, kind: type[IntEnum]) -> Iterator[str]:
    yield f"`{name}`"
    rows = classes(registers)[kind.__name__].fields
    yield table("bit|value|name|meaning", (_bit(row) for row in rows))


def _bit(row: Field) -> tuple[str, ...]:
    value = int(row.default)
    return str(value.bit_length() - 1), str(value), row.name.lower(), row.meaning


# ── robot file ────────────────────────────────────────────────────────────────────────────────


def _robot_file() -> Iterator[str]:
    yield "Robot file"
    yield (
        "TOML. `[[name]]` may stand several times. A key that is not here is a mistake, and told "
        "by line. Robots that are\nshipped: `deploy/robots/*.toml`. Code: `runtime/settings.py`; "
        "what goes together: `runtime/settings_checks.py`,\n`runtime/body_checks.py`."
    )
    tables = classes(settings)
    for field in tables["RobotSettings"].fields:
        kind = field.type.strip("[], .")
        if kind not in tables:
            continue  # filled in after reading
        name = f"[[{field.name}]]" if field.type.startswith("[") else f"[{field.name}]"
        needed = "" if field.default else "; there has to be one"
        yield f"## `{name}`"
        says = _doc(getattr(settings, kind)).partition(": ")[2]
        yield f"{says[:1].upper()}{says[1:].rstrip('.')}{needed}."
        yield _keys(field.name, tables[kind])
    yield "## A muscle's path"
    yield (
        "`path` of a `[[spare]]`, and a file of its own for `myograft plug --path FILE`. "
        + _doc(messages.MusclePath)
    )
    yield _keys("path", classes(messages)["MusclePath"])
    yield "A place is a point of a wire: fixed on a link, or laid around a geom that it wraps."
    yield _keys("place", classes(messages)["Place"])


def _keys(owner: str, row: Class) -> str:
    limits = {rule.key: rule.words for rule in RANGES if rule.table == owner}
    return table(
        "key|type|unit|default|limits|meaning",
        (
            (
                *(f"`{f.name}`", _plain(f.type), f.unit, toml(f.default)),
                *(limits.get(f.name, ""), f.meaning),
            )
            for f in row.fields
        ),
    )


def _plain(words: str) -> str:
    return words.replace("MusclePath", "table").replace("Place", "place")


# ── commands ──────────────────────────────────────────────────────────────────────────────────


def parsers() -> dict[str, argparse.ArgumentParser]:
    """`myograft up`, `python -m experiments elbow`, ... -> what reads its words."""
    ours = {f"myograft {name}": parser for name, parser in cli.parsers().items()}
    _, rigs = experiments.parsers()
    theirs = {f"python -m experiments {name}": parser for name, parser in rigs.items()}
    return ours | theirs | {"python -m hardware_sim.terminals": terminals.parser()}


def _commands() -> Iterator[str]:
    yield "Commands"
    yield (
        "Exit codes: 0 done, 1 refused or failed, 2 wrong usage, 3 no such robot is running, 130 "
        "interrupted."
    )
    for name, parser in parsers().items():
        parser.formatter_class = partial(parser.formatter_class, width=WIDTH)  # type: ignore[assignment]
        yield f"## {name}"
        yield f"```\n{parser.format_help().rstrip()}\n```"


def write() -> None:
    """Put every page where it belongs."""
    for path, text in pages().items():
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write()
