"""`myograft status --watch` on a terminal: the robot as a table that changes in place."""

from __future__ import annotations

import math
import time

from rich import box
from rich.console import Console, ConsoleRenderable, Group
from rich.live import Live
from rich.segment import SegmentLines
from rich.table import Table
from rich.text import Text

from runtime.cli.client import Client
from runtime.cli.main import DONE, NOT_RUNNING
from runtime.cli.status import Picture
from runtime.limits import HOT, WARM

PERIOD_S = 0.25
SILENT_S = 2.5  # the supervisor and every process speak once a second
BAR = 12  # characters
WIDE = 150  # characters: then processes stand beside modules
NARROW = 100  # and with fewer than these there is no room for bars and link errors
_LEVELS = {"info": "", "warning": "yellow", "error": "bold red"}
_MODES = {"silent": "bold red", "stopping": "bold red", "stopped": "bold red"}
_STATES = {"ready": "green", "up": "green", "starting": "yellow", "joining": "yellow"}


def watch(client: Client, picture: Picture) -> int:
    """Show the robot until Ctrl-C or until it stops."""
    heard_s = time.monotonic()

    def take(message: object) -> bool:
        nonlocal heard_s
        heard_s = time.monotonic()
        picture.take(message)  # type: ignore[arg-type]
        return False

    with Live(screen=True, auto_refresh=False) as live:
        try:
            while client.alive:
                client.gather(take, PERIOD_S)
                screen = render(picture, live.console.width, time.monotonic() - heard_s)
                live.update(fitted(screen, live.console), refresh=True)
        except KeyboardInterrupt:
            return DONE
    Console(stderr=True).print(f"{client.robot} has stopped", highlight=False)
    return NOT_RUNNING


def render(picture: Picture, width: int = WIDE - 1, silent_s: float = 0.0) -> ConsoleRenderable:
    """The whole picture for so many characters; `silent_s` since anything was heard."""
    modules = _modules(picture, room=width >= NARROW)
    rest = _apart(_joints(picture), _processes(picture))
    body: ConsoleRenderable = _apart(modules, rest)
    if width >= WIDE:
        body = Table.grid(padding=(0, 4))
        body.add_row(modules, rest)
    return _apart(_headline(picture, silent_s), body, _events(picture))


def fitted(screen: ConsoleRenderable, console: Console) -> ConsoleRenderable:
    """As much of it as there are lines, and how many more there would be."""
    lines = console.render_lines(screen, pad=False)
    more = len(lines) - console.height
    if more <= 0:
        return screen
    shown = SegmentLines(lines[: console.height - 1], new_lines=True)
    return Group(shown, Text(f"{more + 1} more lines: they want a taller terminal", "dim"))


def _apart(first: ConsoleRenderable, *others: ConsoleRenderable) -> Group:
    """One below the other, with a line between."""
    return Group(first, *(part for other in others for part in (Text(), other)))


def _headline(picture: Picture, silent_s: float) -> ConsoleRenderable:
    line = Text()
    ready = picture.group is not None and picture.group.ready
    line.append(f" {picture.robot} ", "bold reverse")
    line.append("  ready" if ready else "  not ready", "green" if ready else "bold yellow")
    if executive := picture.executive:
        stopped = executive.stage == "stopped"
        line.append(f"   {executive.stage}", "bold red" if stopped else "bold cyan")
        line.append(f" {executive.task}".rstrip())
        if executive.steps:
            line.append(f" {executive.step}/{executive.steps}")
        if words := picture.growing.words:
            line.append(f" {words}", "cyan")
        if executive.text:
            line.append(f": {executive.text}")
    if picture.schema:
        line.append(f"   schema {picture.schema.version} ({picture.schema.method})")
    training = picture.training
    if training and training.stage == "training" and training.epochs:
        line.append(f"   epoch {training.epoch}/{training.epochs}", "cyan")
    if clock := picture.clock:
        slow = clock.real_time_factor < 0.9 * clock.speed
        line.append(f"   {clock.stamp_ns * 1e-9:.1f} s")
        line.append(f"  x{clock.real_time_factor:.2f}", "yellow" if slow else "")
    if silent_s > SILENT_S:
        line.append(f"   silent for {silent_s:.0f} s", "bold red")
    return line


def _modules(picture: Picture, room: bool) -> Table:
    loads, errors = (("of limit", ""), ("errors>",)) if room else ((), ())
    table = _table("chain", "does", "id>", "module", "N>", *loads, "°C>", *errors, "state")
    modes = {row["chain"]: str(row["mode"]) for row in picture.chains()}
    for row in picture.modules():
        limit = row["limit_N"]
        tension = row["N"]
        load, most = Text(), ""
        if isinstance(tension, float) and isinstance(limit, float) and limit > 0:
            load, most = _bar(tension / limit), f"{limit:.0f}"
        standing, state = str(row["standing"]), str(row["state"])
        mode = modes.pop(row["chain"], None)  # said beside the first of its modules
        table.add_row(
            "" if mode is None else str(row["chain"]),
            Text(mode or "", _MODES.get(mode or "", "")),
            str(row["id"]),
            Text(str(row["module"]), "bold" if row["kind"] == "muscle" else ""),
            _number(tension),
            *((load, Text(most, "dim")) if room else ()),
            _number(row["degC"]),
            *((str(row["link_errors"] or ""),) if room else ()),
            Text(standing or state, "yellow" if standing else _STATES.get(state, "bold red")),
        )
    return table


def _joints(picture: Picture) -> Table:
    table = _table("joint", "wanted>", "measured>", "estimated>", "±>", "off>")
    for row in picture.joints():
        wanted, measured = row["wanted_rad"], row["measured_rad"]
        known = isinstance(wanted, float) and isinstance(measured, float)
        table.add_row(
            Text(str(row["joint"]), "bold"),
            _degrees(wanted),
            _degrees(measured),
            _degrees(row["estimated_rad"]),
            _degrees(row["confidence_rad"]),
            _degrees(measured - wanted if known else None),  # type: ignore[operator]
        )
    return table


def _processes(picture: Picture) -> Table:
    table = _table("process", "state", "restarts>", "pid>", "Hz>", "CPU %>", "MB>", "dropped>")
    for row in picture.processes():
        state = str(row["state"])
        table.add_row(
            str(row["process"]),
            Text(state, _STATES.get(state, "bold red")),
            Text(str(row["restarts"] or ""), "yellow"),
            str(row["pid"] or ""),
            _number(row["tick_hz"]),
            _number(row["cpu_%"]),
            _number(row["MB"], 0),
            str(row["dropped"] or ""),
        )
    return table


def _events(picture: Picture) -> Table:
    table = _table("s>", "event", "by", "says")
    table.columns[-1].ratio = 1
    table.expand = True
    for event in sorted(picture.events, key=lambda event: event.stamp_ns):
        style = _LEVELS.get(event.level, "")
        table.add_row(
            f"{event.stamp_ns * 1e-9:.1f}",
            event.kind,
            event.process,
            Text(event.text),  # as it is: square brackets in a str are markup
            style=style,
        )
    return table


def _table(*columns: str) -> Table:
    """Column titles; those that end in > are numbers."""
    table = Table(box=box.SIMPLE_HEAD, header_style="dim", pad_edge=False, show_edge=False)
    for title in columns:
        number = title.endswith(">")
        table.add_column(
            title.rstrip(">"),
            justify="right" if number else "left",
            no_wrap=True,
            overflow="ellipsis",
        )
    return table


def _bar(share: float) -> Text:
    """How much of a limit is used."""
    share = min(max(share, 0.0), 1.0)
    style = "red" if share > HOT else "yellow" if share > WARM else "green"
    full = round(share * BAR)
    return Text("█" * full, style).append("░" * (BAR - full), "dim")


def _number(value: object, digits: int = 1) -> str:
    return f"{value:.{digits}f}" if isinstance(value, int | float) else "-"


def _degrees(angle_rad: object) -> str:
    known = isinstance(angle_rad, float) and not math.isnan(angle_rad)
    return f"{math.degrees(angle_rad):.1f}°" if known else "-"  # type: ignore[arg-type]
