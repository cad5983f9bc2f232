"""`myograft completion`, and the words with which commands complete their arguments.

The words come from the registry of hubs, from robot files and from what runs leave on this host
alone, so that a key press asks no robot anything.
"""

from __future__ import annotations

import argparse
import contextlib
import tomllib
from collections.abc import Callable, Iterable
from pathlib import Path

from runtime.cli.main import DISTRIBUTION, DONE
from runtime.hubs import living_hubs, robot_home, state_home
from runtime.settings import ROBOTS

LOGS = "logs/*.log"
SHELLS = ("bash", "zsh", "fish")


class Completion:
    """Print what a shell needs to complete commands, robots, tasks and muscles.

    Examples:
      eval "$(myograft completion bash)"                     in ~/.bashrc
      eval "$(myograft completion zsh)"                      in ~/.zshrc, after compinit
      myograft completion fish > ~/.config/fish/completions/myograft.fish
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        parser.add_argument("shell", choices=SHELLS)

    def run(self, args: argparse.Namespace) -> int:
        """Print the shell's code."""
        from argcomplete.shell_integration import shellcode

        print(shellcode([DISTRIBUTION], shell=args.shell))
        return DONE


def completed_by(action: argparse.Action, words: Callable[[], Iterable[str]]) -> None:
    """Let an argument be completed by these words."""
    action.completer = lambda **_: sorted(words())  # type: ignore[attr-defined]


def robots() -> set[str]:
    """Robots that run, that have run here, and that ship."""
    ran = {path.parent.parent.name for path in state_home().glob("*/runs/latest")}
    return (
        {hub.robot for hub in living_hubs()} | ran | {file.stem for file in ROBOTS.glob("*.toml")}
    )


def named(*tables: str) -> Callable[[], set[str]]:
    """The names in these tables (`muscle`, `task`, ...) of the robots that run; else of all."""

    def words() -> set[str]:
        files = [Path(hub.file) for hub in living_hubs() if hub.file]
        return {name for file in files or ROBOTS.glob("*.toml") for name in _names(file, tables)}

    return words


def robot_or(words: Callable[[], Iterable[str]]) -> Callable[[], set[str]]:
    """For arguments `[ROBOT] WORD`: the words, and where several robots run those, too."""

    def both() -> set[str]:
        running = {hub.robot for hub in living_hubs()}
        return {*words(), *(running if len(running) > 1 else ())}

    return both


def versions() -> set[str]:
    """Numbers of the body schemas that robots that run here have stored."""
    homes = [robot_home(hub.robot) / "state" / "retrainer" for hub in living_hubs()]
    return {str(int(file.name[1:])) for home in homes for file in home.glob("v[0-9]*")}


def logged() -> set[str]:
    """Processes that have a log in the run that `myograft logs` would show."""
    from runtime.runs import RunError, find_run  # reads recordings: too much for every command

    with contextlib.suppress(RunError):
        return {log.stem for log in find_run("", LOGS).glob(LOGS)}
    return set()


def _names(file: Path, tables: tuple[str, ...]) -> Iterable[str]:
    try:
        text = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # whoever loads it will be told
        return []
    return [row["name"] for table in tables for row in text.get(table, ()) if "name" in row]
