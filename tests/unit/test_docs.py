"""The documents agree with the code."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

import pytest

from docs.reference import BEGIN, END, ROOT, pages
from docs.source import classes
from runtime import messages, settings
from runtime.cli.main import DONE, main
from runtime.settings import load_robot
from runtime.wire.registers import BY_NAME, MEANINGS
from tests.shown import HOWTOS, RUN_ELSEWHERE, blocks, check, shown

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


def test_commands_that_are_shown_are_understood() -> None:
    assert len(shown()) > 50, "are the blocks no longer marked?"
    for command in shown():
        try:
            check(command)
        except SystemExit:
            pytest.fail(f"{command}: its parser does not understand it")


@pytest.mark.parametrize(("name", "test"), RUN_ELSEWHERE.items())
def test_what_is_not_run_as_it_is_shown_is_run_elsewhere(name: str, test: str) -> None:
    assert f'"{name}"' in (ROOT / test).read_text(encoding="utf-8")


def test_commands_that_need_no_robot_do_what_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each once, in the order of reading, in a folder where a document's own files lie."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tests").symlink_to(ROOT / "tests")
    for document in HOWTOS:
        for block in blocks(document):
            if block.language == "xml":
                (tmp_path / re.findall(r"`([\w.]+)`", block.before)[-1]).write_text(block.text)
    ran = []
    for command in {command.words: command for command in shown()}.values():
        if command.words[0] == "cp":
            shutil.copy(*command.words[1:])
        elif command.ours and not command.on_robot and command.ours not in RUN_ELSEWHERE:
            assert main(list(command.words[1:])) == DONE, str(command)
            ran.append(command.ours)
    assert {"doctor", "body", "new"} <= set(ran)
    assert load_robot(str(tmp_path / "my_arm.toml")).muscles
    assert load_robot(str(tmp_path / "forearm.toml")).muscles


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_commands_that_are_mentioned_exist(document: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    known = set(project["entry-points"]["myograft.commands"])
    text = document.read_text(encoding="utf-8")
    code = re.findall(r"```.*?```|`[^`\n]+`", text, re.DOTALL)
    mentioned = re.findall(r"(?:^|`)myograft ([a-z]+)", "\n".join(code), re.MULTILINE)
    assert set(mentioned) <= known


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
