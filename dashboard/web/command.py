"""`myograft results`: what experiments found, in the terminal."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from typing import Any

from dashboard.web.results import find, folders_of, read
from runtime.cli.completion import completed_by, robots
from runtime.cli.main import DONE, REFUSED, UsageError
from runtime.hubs import living_hubs
from runtime.settings import SettingsError, load_robot
from runtime.suggestion import suggestion


class Results:
    """Show what an experiment found, as tables; without NAME, list the results.

    The same as the page's /results: of experiments' own folder, of the repository's documents, and
    of the folders that `[web] results` of a robot's file names.

    Examples:
      myograft results
      myograft results lift
      myograft results lift --json | jq '.tables[0].rows'
      myograft results mine --robot my_arm.toml
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        name = parser.add_argument("name", nargs="?", default="", help="of the results")
        completed_by(name, lambda: find(folders_of()))
        robot = parser.add_argument(
            "--robot", default="", help="whose file is asked, too; default: of all that run"
        )
        completed_by(robot, robots)
        parser.add_argument("--json", action="store_true", help="for programs")

    def run(self, args: argparse.Namespace) -> int:
        """Find, and print."""
        files = [args.robot] if args.robot else [hub.file for hub in living_hubs() if hub.file]
        try:
            found = find(folders_of(*map(load_robot, files)))
        except SettingsError as error:
            raise UsageError(str(error)) from error
        if not args.name:
            print(json.dumps(list(found)) if args.json else "\n".join(found))
            return DONE
        if args.name not in found:
            hint = suggestion(args.name, found)
            print(f"myograft: there are no results {args.name!r}{hint}", file=sys.stderr)
            return REFUSED
        one = found[args.name]
        told = read(one)
        told["pictures"] = [str(file) for file in one.pictures.values()]
        print(json.dumps(told) if args.json else _text(told))
        if problem := told.get("problem"):
            print(f"myograft: {problem}", file=sys.stderr)
        return REFUSED if problem else DONE


def _text(told: dict[str, Any]) -> str:
    parts = ["\n".join(_table([table["title"]], table)) for table in told["tables"]]
    return "\n\n".join([*parts, *(f"picture: {file}" for file in told["pictures"])])


def _table(lines: list[str], table: dict[str, Any]) -> list[str]:
    """Its lines, columns below each other, behind those that are there."""
    rows: Sequence[Sequence[str]] = [table["head"], *table["rows"]]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
        lines.append(("  " + "  ".join(cells)).rstrip())
    return lines
