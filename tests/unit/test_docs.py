"""The documents agree with the code."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest

from docs import results
from docs.reference import BEGIN, END, ROOT, pages
from docs.source import classes
from runtime import messages, settings
from runtime.cli.main import DONE, main
from runtime.wire.registers import BY_NAME, MEANINGS
from tests.shown import RUN_ELSEWHERE, check, only_read, shown

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


@pytest.mark.parametrize("test", sorted(set(RUN_ELSEWHERE.values())))
def test_what_is_not_run_as_it_is_shown_is_run_elsewhere(
    test: str, request: pytest.FixtureRequest
) -> None:
    """By a test of `make test`, that pytest finds."""
    file, _, name = test.partition("::")
    assert file.startswith(("tests/unit/", "tests/integration/", "tests/e2e/"))
    module = pytest.Module.from_parent(request.session, path=ROOT / file)
    assert name in {getattr(item, "originalname", item.name) for item in module.collect()}


def test_nothing_is_excused_that_is_not_shown() -> None:
    assert {x.form for x in shown() if x.where == "elsewhere"} == set(RUN_ELSEWHERE)
    for begin in only_read():
        assert any(x.text.startswith(begin) for x in shown()), begin


def test_commands_that_need_no_robot_do_what_is_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each once; those about a robot are run by tests/e2e/test_documents.py."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    alone = {command.words: command for command in shown() if command.where == "alone"}
    for command in alone.values():
        assert command.ours and main(list(command.words[1:])) == DONE, str(command)
    assert ("myograft", "doctor") in alone


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_commands_that_are_mentioned_exist(document: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    known = set(project["entry-points"]["myograft.commands"])
    text = document.read_text(encoding="utf-8")
    code = re.findall(r"```.*?```|`[^`\n]+`", text, re.DOTALL)
    mentioned = re.findall(r"(?:^|`)myograft ([a-z]+)", "\n".join(code), re.MULTILINE)
    assert set(mentioned) <= known


def test_every_picture_is_made_by_a_command() -> None:
    """`make pictures`: each is named by the Makefile, or drawn by `docs.results`."""
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    named = set(re.findall(r"docs/pictures/([\w.-]+)", makefile))
    drawn = {f"{name}{suffix}" for name in results.pictures() for suffix in (".png", ".svg")}
    kept = {file.name for file in (ROOT / "docs" / "pictures").iterdir()}
    assert kept <= named | drawn
    assert named - {f"{name}.json" for name in results.DEMOS} <= kept


def test_what_demos_wrote_names_no_place_on_a_machine() -> None:
    for name in results.DEMOS:
        told = json.loads((ROOT / "docs" / "pictures" / f"{name}.json").read_text())
        assert told["report"] and not {*told} & {*results.PLACES}
        assert " /" not in "".join(told["report"])


def test_the_readme_shows_what_experiments_and_demos_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (ROOT / "README.md").read_text(encoding="utf-8")
    assert results.with_findings(page) == page, "run `python -m docs.results`"
    (tmp_path / "pictures").mkdir()
    for name in results.DEMOS:
        told = json.dumps({"report": [f"what {name} said", "in two lines"]})
        (tmp_path / "pictures" / f"{name}.json").write_text(told)
    monkeypatch.setattr(results, "HERE", tmp_path)
    monkeypatch.setattr(results, "summary", lambda: "| a table |")
    again = results.with_findings(page)
    for name in results.DEMOS:
        assert f"<!-- {name} output -->\n```\nwhat {name} said\nin two lines\n```\n<!-- /" in again
    assert "<!-- results -->\n| a table |\n<!-- /results -->" in again
    assert len(again) < len(page)


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
