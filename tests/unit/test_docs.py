"""The documents agree with the code."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from docs.reference import BEGIN, END, ROOT, pages
from docs.source import classes
from runtime import messages, settings
from runtime.wire.registers import BY_NAME, MEANINGS

DOCUMENTS = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


def test_the_reference_is_what_the_code_gives() -> None:
    stale = [path.name for path, text in pages().items() if path.read_text("utf-8") != text]
    assert stale == [], "run `make docs`"
    architecture = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
    assert architecture.count(BEGIN) == architecture.count(END) == 1


def test_the_reference_finds_what_stands_behind_a_field() -> None:
    state = {field.name: field for field in classes(messages)["ChainState"].fields}
    assert state["length_m"].type == "[number, ...]"
    assert state["length_m"].unit == "m"
    assert state["length_m"].meaning == "wire paid out, from the module's length zero"
    assert classes(messages)["ChainState"].section == "the daisy chains"
    control = {field.name: field for field in classes(settings)["Control"].fields}
    assert control["stiffness_n_m"].unit == "N/m"
    assert control["sharing"].type == '"norm" or "peak"'
    assert control["settle_s"].default == "0.6"


def test_every_register_has_a_meaning() -> None:
    assert MEANINGS.keys() == BY_NAME.keys()


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_lead_somewhere(document: Path) -> None:
    text = re.sub(r"<!--.*?-->", "", document.read_text(encoding="utf-8"), flags=re.DOTALL)
    missing = [
        target
        for target in re.findall(r"\]\(([^)#]+)", text)
        if "://" not in target and not (document.parent / target).exists()
    ]
    assert missing == []


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_commands_that_are_shown_exist(document: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    known = set(project["entry-points"]["myograft.commands"])
    text = document.read_text(encoding="utf-8")
    code = re.findall(r"```.*?```|`[^`\n]+`", text, re.DOTALL)
    shown = re.findall(r"(?:^|`)myograft ([a-z]+)", "\n".join(code), re.MULTILINE)
    assert set(shown) <= known


def test_every_dependency_is_explained() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    wanted = {
        re.split(r"[<>=]", requirement)[0]
        for requirement in [
            *project["dependencies"],
            *(r for rows in extras.values() for r in rows),
        ]
    }
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    assert wanted <= set(re.findall(r"^\| `([\w-]+)`", page, re.MULTILINE))
