"""The `myograft` command: finds the floors' commands by entry points, imports only the one asked.

A command is a class or a module named in the table `myograft.commands` of pyproject.toml. Its
docstring is its help, the first line that of the list; `configure(parser)` adds its arguments and
`run(args)` returns the exit code. The list is read from the source text, so that
`myograft --help` imports no floor.
"""

from __future__ import annotations

import argparse
import ast
import functools
import importlib.util
import inspect
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

DISTRIBUTION = "myograft"
GROUP = "myograft.commands"

DONE, REFUSED, USAGE, NOT_RUNNING = 0, 1, 2, 3

_EPILOG = """\
start here:
  myograft up elbow                start the simulated one-joint arm
  myograft task sweep              (another terminal) run a task
  myograft plug biceps_3           plug in a fourth muscle and watch the arm take it in
  myograft status --watch          who runs, who is plugged in, how they feel

exit codes: 0 done, 1 refused or failed, 2 wrong usage, 3 no such robot is running
"""


class UsageError(ValueError):
    """Words that make no sense together; the text says which and what to write."""


class Command(Protocol):
    """What an entry point of the table names."""

    __doc__: str | None

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the command's arguments."""

    def run(self, args: argparse.Namespace) -> int:
        """Do it; the exit code."""


class Entry(NamedTuple):
    """One row of the table."""

    name: str
    module: str
    attribute: str  # "": the module itself is the command


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code."""
    words = sys.argv[1:] if argv is None else argv
    entries = _entries()
    if "_ARGCOMPLETE" in os.environ:  # the shell asks how the line could go on
        _complete(entries)
    if not words or words[0] in ("-h", "--help", "help"):
        print(_list_of_commands(entries))
        return DONE
    if words[0] == "--version":
        from importlib.metadata import version

        print(f"{DISTRIBUTION} {version(DISTRIBUTION)}")
        return DONE
    entry = entries.get(words[0])
    if entry is None:
        print(_unknown(words[0], list(entries)), file=sys.stderr)
        return USAGE
    try:
        command = _load(entry)
    except ModuleNotFoundError as error:
        print(
            f"myograft {entry.name} needs {error.name!r}, which is not installed. "
            f"`myograft doctor` says what to install.",
            file=sys.stderr,
        )
        return REFUSED
    return _run(entry.name, command, words[1:])


def parsers() -> dict[str, argparse.ArgumentParser]:
    """Every command's parser, by its name. Imports them all: for documents and their tests."""
    return {name: _parser(name, _load(entry)) for name, entry in _entries().items()}


def _parser(name: str, command: Command) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"myograft {name}",
        description=inspect.cleandoc(command.__doc__ or ""),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    command.configure(parser)
    return parser


def _run(name: str, command: Command, words: list[str]) -> int:
    args = _parser(name, command).parse_args(words)
    try:
        return command.run(args)
    except UsageError as error:
        print(f"myograft: {error}", file=sys.stderr)
        return USAGE
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:  # the reader of a pipe has had enough
        sys.stderr.close()
        return DONE


def _complete(entries: dict[str, Entry]) -> None:
    """Tell the shell, and exit: only the command that stands on the line is imported."""
    import argcomplete

    line = os.environ.get("COMP_LINE", "").split()
    parser = argparse.ArgumentParser(prog=DISTRIBUTION)
    commands = parser.add_subparsers()
    for name, entry in entries.items():
        command = commands.add_parser(name, help=_first_line(entry))
        if name in line[1:2]:
            _load(entry).configure(command)
    argcomplete.autocomplete(parser, always_complete_options=False)


def _load(entry: Entry) -> Command:
    module = importlib.import_module(entry.module)
    loaded = getattr(module, entry.attribute) if entry.attribute else module
    command: Command = loaded() if isinstance(loaded, type) else loaded
    return command


def _entries() -> dict[str, Entry]:
    # Read straight from our own entry_points.txt: importlib.metadata takes 40 ms to import.
    return {entry.name: entry for path in _tables() for entry in _rows(path)}


def _tables() -> Iterator[Path]:
    for folder in reversed(sys.path):  # who comes first in the path has the last word
        yield from Path(folder or ".").glob(f"{DISTRIBUTION}-*.dist-info/entry_points.txt")


def _rows(path: Path) -> Iterator[Entry]:
    section = ""
    for line in path.read_text().splitlines():
        if line.startswith("["):
            section = line.strip("[] ")
        elif section == GROUP and "=" in line:
            name, value = (word.strip() for word in line.split("=", 1))
            module, _, attribute = value.partition(":")
            yield Entry(name, module, attribute)


def _list_of_commands(entries: dict[str, Entry]) -> str:
    width = max(map(len, entries), default=0) + 2
    lines = ["usage: myograft COMMAND ...", "", "commands (each has its own --help):"]
    lines += [f"  {name:<{width}}{_first_line(entry)}" for name, entry in entries.items()]
    return "\n".join([*lines, "", _EPILOG])


def _first_line(entry: Entry) -> str:
    """The first line of a command's docstring, from the source text."""
    return _docstrings(entry.module).get(entry.attribute, "(not installed)").partition("\n")[0]


@functools.cache
def _docstrings(module: str) -> dict[str, str]:
    try:
        spec = importlib.util.find_spec(module)
    except ModuleNotFoundError:
        spec = None
    if spec is None or spec.origin is None:
        return {}
    tree = ast.parse(Path(spec.origin).read_bytes())
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    nodes: dict[str, ast.Module | ast.ClassDef] = {"": tree, **classes}
    return {name: ast.get_docstring(node) or "" for name, node in nodes.items()}


def _unknown(word: str, names: list[str]) -> str:
    from runtime.suggestion import meant

    return f"myograft: no command {word!r}{meant(word, names) or '.'} `myograft --help` lists them."


if __name__ == "__main__":  # by its own name: commands raise the UsageError of that module
    from runtime.cli.main import main as main_by_name

    sys.exit(main_by_name())
