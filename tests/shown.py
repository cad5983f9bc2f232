"""What the documents show: commands in blocks marked `sh`, and other blocks by their language.

A command whose comment says `Ctrl-C` does not end by itself.
"""

from __future__ import annotations

import argparse
import re
import shlex
from functools import cache
from pathlib import Path
from typing import NamedTuple

from docs.reference import ROOT, parsers

TUTORIAL = ROOT / "docs" / "tutorial.md"
HOWTOS = sorted((ROOT / "docs" / "howto").glob("*.md"))
ELSEWHERE = "another host"
DOCUMENTS = [TUTORIAL, ROOT / "README.md", *HOWTOS, ROOT / "docs" / "README.md"]

# Commands of ours that are not run as they are shown, by their form, and the tests that run them.
RUN_ELSEWHERE = {
    "make demo": "tests/e2e/test_demo.py::test_the_demo_shows_what_it_promises",
    "make docs": "tests/unit/test_docs.py::test_the_reference_is_what_the_code_gives",
    "myograft up elbow musashi_arm": "tests/e2e/test_up.py::test_a_command_to_one_moves_no_other",
    "myograft up elbow --name": "tests/integration/test_runtime.py::"
    "test_up_in_the_foreground_until_ctrl_c",
    "myograft up elbow --connect": "tests/e2e/test_documents.py::test_a_robot_is_spread_over_hosts",
    "python -m experiments elbow": "tests/unit/test_comparison.py::"
    "test_the_command_goes_from_robot_to_tables",
    "python -m experiments ablate elbow": "tests/unit/test_ablate.py::"
    "test_the_command_gives_a_row_for_each_part_that_is_asked_for",
}


class Shown(NamedTuple):
    """One command that a document shows."""

    document: Path
    line: int
    words: tuple[str, ...]
    text: str  # as a shell reads it
    endless: bool
    robot: str  # whom it is about: the robot that the document has last started or made

    @property
    def ours(self) -> str:
        """`plug` of `myograft plug biceps_3`; "" for another program."""
        return self.words[1] if self.words[0] == "myograft" else ""

    @property
    def form(self) -> str:
        """The command and its options without their values: what `RUN_ELSEWHERE` goes by."""
        options = [k for k, word in enumerate(self.words) if word.startswith("-")]
        module = self.words[1] == "-m"
        first = next((k for k in options if k > module), len(self.words))
        return " ".join((*self.words[:first], *(self.words[k] for k in options if k >= first)))

    @property
    def where(self) -> str:
        """`read`: nowhere; `elsewhere`; `robot`: on one that runs; `alone`: without."""
        if any(self.text.startswith(begin) for begin in only_read()):
            return "read"
        if self.form in RUN_ELSEWHERE:
            return "elsewhere"
        if self.ours in ("up", "learn") or not self.ours or self.robot not in ("elbow", ELSEWHERE):
            return "robot"
        if self.words[1:3] == ("topic", "list"):
            return "alone"
        parser = command_parsers()[f"myograft {self.ours}"]
        asks = "--robot" in {word for action in parser._actions for word in action.option_strings}
        return "robot" if asks else "alone"

    def __str__(self) -> str:
        return f"{self.document.name}:{self.line}: {self.text}"


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
            for number, line in enumerate(lines, block.line + 1):
                text, _, comment = line.partition(" #")
                names = re.findall(r"([\w-]+)\.(?:toml|xml)\b", text)
                if names or text.startswith("myograft up"):
                    robot = names[-1] if names else "elbow"
                about = ELSEWHERE if "_ENDPOINT=" in text else robot
                words = [word for word in shlex.split(text) if not re.match(r"[A-Z_]+=", word)]
                endless = "Ctrl-C" in comment
                found.append(Shown(document, number, tuple(words), text.strip(), endless, about))
    return tuple(found)


@cache
def only_read() -> tuple[str, ...]:
    """How commands begin that no test runs, from the table in the documents' index."""
    _, _, table = (ROOT / "docs" / "README.md").read_text(encoding="utf-8").partition("| only read")
    cells = re.findall(r"^\| `([^`]+)` \|", table, re.MULTILINE)
    return tuple(cell.replace("\\|", "|") for cell in cells)


@cache
def command_parsers() -> dict[str, argparse.ArgumentParser]:
    """The real parsers: `myograft plug`, `python -m experiments elbow`, ..."""
    return parsers()


def check(command: Shown) -> None:
    """Let the program's own parser read the words.

    Raises:
        SystemExit: it does not understand them.
        AssertionError: there is no such target or file.
    """
    for length in (4, 3, 2):
        if parser := command_parsers().get(" ".join(command.words[:length])):
            parser.parse_args(command.words[length:])
            break
    else:
        if command.words[0] == "make":
            makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
            target = rf"^{command.words[1]}:"
            assert re.search(target, makefile, re.MULTILINE), f"{command}: no such target"
    for word in command.words:
        if re.match(r"(deploy|docs|tests)/", word) and not word.endswith("_serial.toml"):
            assert (ROOT / word).exists(), f"{command}: there is no {word}"
