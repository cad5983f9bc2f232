"""What the documents show: commands in blocks marked `sh`, and other blocks by their language.

A command whose comment says `Ctrl-C` does not end by itself.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import shlex
from functools import cache
from pathlib import Path
from typing import NamedTuple

from docs.reference import ROOT, parsers

TUTORIAL = ROOT / "docs" / "tutorial.md"
HOWTOS = sorted((ROOT / "docs" / "howto").glob("*.md"))
DOCUMENTS = [TUTORIAL, ROOT / "README.md", *HOWTOS, ROOT / "docs" / "README.md"]

# Programs that are not ours: how they are called is theirs to check, the files that they get ours.
FOREIGN = {".", "cp", "docker", "echo", "pip", "sed", "sudo", "tee", "zenohd"}

# Commands of ours that are too long to be run as they are shown, and the tests that run them.
RUN_ELSEWHERE = {
    "up": "tests/e2e/test_up.py",
    "demo": "tests/e2e/test_demo.py",
    "learn": "tests/bench/test_learning.py",
}


class Shown(NamedTuple):
    """One command that a document shows."""

    document: Path
    line: int
    words: tuple[str, ...]
    endless: bool
    robot: str  # the robot that the document has last started

    @property
    def ours(self) -> str:
        """`plug` of `myograft plug biceps_3`; "" for another program."""
        return self.words[1] if self.words[0] == "myograft" else ""

    @property
    def on_robot(self) -> bool:
        """It asks a robot that runs, as it has `--robot`, and is not run elsewhere."""
        if not self.ours or self.ours in RUN_ELSEWHERE or self.words[1:3] == ("topic", "list"):
            return False
        parser = command_parsers()[f"myograft {self.ours}"]
        return "--robot" in {word for action in parser._actions for word in action.option_strings}

    def __str__(self) -> str:
        return f"{self.document.name}:{self.line}: {' '.join(self.words)}"


class Block(NamedTuple):
    """One fenced block, with the line of prose before it."""

    line: int
    language: str
    before: str
    text: str


def blocks(document: Path) -> list[Block]:
    """Every fenced block of a document."""
    text = document.read_text(encoding="utf-8")
    return [
        Block(
            text.count("\n", 0, found.start(2)) + 1,
            found[2],
            text[: found.start()].rstrip().rpartition("\n")[2],
            re.sub(rf"^{found[1]}", "", found[3], flags=re.MULTILINE),
        )
        for found in re.finditer(r"^( *)```(\w*)\n(.*?)^ *```$", text, re.DOTALL | re.MULTILINE)
    ]


@cache
def shown() -> tuple[Shown, ...]:
    """Every command of every document, in the order of reading."""
    found = []
    for document in DOCUMENTS:
        robot = "elbow"
        for block in blocks(document):
            lines = block.text.splitlines() if block.language == "sh" else []
            for number, text in enumerate(lines, block.line + 1):
                command, _, comment = text.partition(" #")
                for part in re.split(r" && | \| | > ", command):
                    words = [w for w in shlex.split(part) if not re.match(r"[A-Z_]+=", w)]
                    if not words or words[0].endswith((".toml", ".xml")):  # a file written to
                        continue
                    if words[:2] == ["myograft", "up"]:
                        robot = next(iter(words[2:]), "elbow")
                    elsewhere = "another host" if "ENDPOINT=" in part else robot
                    endless = "Ctrl-C" in comment
                    found.append(Shown(document, number, tuple(words), endless, elsewhere))
    return tuple(found)


@cache
def command_parsers() -> dict[str, argparse.ArgumentParser]:
    """The real parsers: `myograft plug`, `python -m experiments elbow`, ..."""
    return parsers()


def check(command: Shown) -> None:
    """Let the program's own parser read the words.

    Raises:
        SystemExit: it does not understand them.
        AssertionError: there is no such program, target or file.
    """
    for length in (4, 3, 2):
        if parser := command_parsers().get(" ".join(command.words[:length])):
            parser.parse_args(command.words[length:])
            break
    else:
        _check_foreign(command)
    for word in command.words:
        if re.match(r"(deploy|docs|tests)/", word) and not word.endswith("_serial.toml"):
            assert (ROOT / word).exists(), f"{command}: there is no {word}"


def _check_foreign(command: Shown) -> None:
    program, *words = command.words
    if program == "python":
        spec = importlib.util.find_spec(words[1]) if words[0] == "-m" else None
        assert spec is not None and spec.origin is not None, f"{command}: no such module"
        source = Path(spec.origin).read_text(encoding="utf-8")
        unknown = [word for word in words if word.startswith("--") and f'"{word}"' not in source]
        assert unknown == [], f"{command}: no such options"
    elif program == "make":
        makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
        assert re.search(rf"^{words[0]}:", makefile, re.MULTILINE), f"{command}: no such target"
    else:
        assert program in FOREIGN, f"{command}: what is {program}?"
