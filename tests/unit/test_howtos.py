"""The code that the how-tos show is put where they say, and does what they say."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from docs.reference import ROOT
from runtime import messages, topics
from runtime.envelope import decode, encode, encoding_of
from runtime.messages import Message
from runtime.settings import find_robot_file, load_robot
from runtime.wire.link import parse_link
from tests.shown import HOWTOS, blocks

BY_NAME = {document.stem: document for document in HOWTOS}


def code(howto: str, language: str = "python") -> Iterator[tuple[str, str]]:
    """Each block of a language: the path that stands before it, and its text."""
    for block in blocks(BY_NAME[howto]):
        if block.language == language:
            paths = re.findall(r"`([\w/]+\.\w+)`", block.before)
            yield (paths[-1] if paths else ""), block.text


@pytest.fixture
def watchman(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder beside ours with the files of the how-to, found as if they lay among ours."""
    for path, text in code("process"):
        file = tmp_path / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    monkeypatch.syspath_prepend(tmp_path / "tests" / "unit")
    for package in ("services", "services.logic"):
        module = importlib.import_module(package)
        beside = str(tmp_path / package.replace(".", "/"))
        monkeypatch.setattr(module, "__path__", [*module.__path__, beside])
    yield tmp_path
    for name in ("services.watchman", "services.logic.watchman", "test_watchman"):
        sys.modules.pop(name, None)


def test_the_process_does_what_its_own_test_says(watchman: Path) -> None:
    test: Any = importlib.import_module("test_watchman")
    test.test_a_hot_motor_is_told_of_once_each_time()


def test_the_process_runs_its_logic(watchman: Path) -> None:
    shell: Any = importlib.import_module("services.watchman")
    ran = []
    shell.main(SimpleNamespace(settings=load_robot("elbow"), run=ran.append))
    assert [type(logic).__name__ for logic in ran] == ["Watchman"]
    (row,) = (text for _, text in code("process", "toml"))
    assert row.strip() == 'watchman = "services.watchman:main"'


def test_the_message_travels() -> None:
    texts = [text for _, text in code("message")]
    space = dict(vars(messages))
    exec(compile(texts[0], "runtime/messages.py", "exec", flags=0), space)
    kind: type[Message] = space["Fatigue"]
    row = eval(texts[1], {**vars(topics), "m": SimpleNamespace(Fatigue=kind)})
    assert isinstance(row, topics.Topic)
    message = msgspec.convert({"chain": "arm", "muscles": ["triceps"], "work_j": [2.0]}, kind)
    assert decode(kind, encode(message), encoding_of(kind)) == message
    assert row.key.format(chain="arm") == "chain/arm/fatigue"


def test_the_request_is_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr("runtime.cli.client.request", lambda *words: asked.append(words) or 0)
    *_, text = (text for _, text in code("message"))
    space: dict[str, Any] = {}
    exec(text, space)
    assert asked == [("elbow", messages.Reset())]
    assert space["exit_code"] == 0


def test_the_table_of_keeps_is_whole() -> None:
    page = BY_NAME["message"].read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `([A-Z]+)` \|", page, re.MULTILINE)) == set(topics.Keep.__members__)


def test_robot_files_understand_what_is_shown(tmp_path: Path) -> None:
    shipped = find_robot_file("elbow")
    text = shipped.read_text().replace('"../', f'"{shipped.parent}/../')
    (chain,) = (text for _, text in code("serial-chain", "toml"))
    real = re.sub(r"\[\[chain\]\].*?\n\n", chain + "\n", text, flags=re.DOTALL)
    (spare,) = (text for _, text in code("body", "toml"))
    forearm = tmp_path / "forearm.toml"
    forearm.write_text(_of(tmp_path, text, spare))
    file = tmp_path / "real.toml"
    file.write_text(real)
    assert load_robot(str(file)).chain[0].link == "serial:///dev/ttyUSB0"
    assert load_robot(str(forearm)).spare[0].name == "flexor_2"


def _of(folder: Path, elbow: str, spare: str) -> str:
    """A robot file of the how-to's body with its spare."""
    ((_, body),) = code("body", "xml")
    (folder / "forearm.xml").write_text(body)
    head = re.sub(r'body = "[^"]*"\nschema = "[^"]*"', 'body = "forearm.xml"', elbow)
    head = head.partition("[[muscle]]")[0].replace('"arm"', '"main"')
    muscles = "".join(
        f'[[muscle]]\nname = "{name}"\nchain = "main"\nid = {2 + i}\n'
        for i, name in enumerate(("flexor", "extensor"))
    )
    return head + muscles + spare


def test_links_mean_what_is_shown() -> None:
    page = BY_NAME["serial-chain"].read_text(encoding="utf-8")
    links = re.findall(r"^\| `(s[^`]+)` \|", page, re.MULTILINE)
    assert [parse_link(link) for link in links] == [
        None,
        ("/dev/ttyUSB0", 3_000_000),
        ("/dev/ttyUSB0", 1_000_000),
    ]


def test_events_that_are_explained_are_told() -> None:
    page = BY_NAME["serial-chain"].read_text(encoding="utf-8")
    kinds = re.findall(r"^\| `(\w+_?\w+)` \| ", page.partition("| event")[2], re.MULTILINE)
    source = "".join(p.read_text() for p in (ROOT / "services" / "logic").glob("*.py"))
    assert len(kinds) > 3
    assert [kind for kind in kinds if f'"{kind}"' not in source] == []
