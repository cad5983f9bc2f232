"""The command line: what it offers, and what it says when things are not as they should be."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from pathlib import Path

import pytest

from runtime.cli.main import DONE, NOT_RUNNING, REFUSED, USAGE, _entries, _load, main
from runtime.hubs import Claim, Hub
from runtime.settings import load_robot


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))


def test_every_command_of_the_table_is_there_and_teaches_with_examples(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main([]) == DONE
    listed = capsys.readouterr().out
    assert "(not installed)" not in listed
    for name, entry in _entries().items():
        command = _load(entry)
        assert f"  {name} " in listed
        assert command.__doc__
        assert f"myograft {name}" in command.__doc__, f"{name} --help shows no example"
        command.configure(argparse.ArgumentParser())


def test_the_list_imports_no_floor() -> None:
    script = (
        "import sys\nfrom runtime.cli.main import main\nmain(['--help'])\n"
        "heavy = {'zenoh', 'numpy', 'msgspec', 'mujoco', 'rerun', 'services.commands'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    ran = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr


def test_a_slip_of_the_finger_gets_a_hint(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["statsu"]) == USAGE
    assert "'status'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        ["status"],
        ["down"],
        ["reach", "elbow=45"],
        ["task", "sweep"],
        ["plug", "biceps_3"],
        ["topic", "echo", "Event"],
        ["estop"],
        ["fault", "list"],
        ["fault", "rupture", "biceps_1"],
        ["events", "-f"],
        ["status", "--watch"],
        ["identify", "biceps_1"],
    ],
)
def test_without_a_robot_they_say_how_to_start_one(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == NOT_RUNNING
    assert "myograft up" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "remedy"),
    [
        (["reach", "elbow"], "elbow=45"),
        (["reach", "elbow=up"], "elbow=45"),
        (["topic", "hz", "Nonsense"], "topic list"),
        (["schema", "rollback"], "schema list"),
        (["up", "elbow", "--speed", "0"], "--speed"),
        (["up", "elbow", "--only", "nobody"], "estimator"),
        (["up", "no_such_robot"], "no_such_robot"),
        (["plug", "new", "--path", "/nowhere.toml"], "/nowhere.toml"),
        (["fault", "rupture", "biceps_1", "biceps_2"], "fault rupture TARGET"),
        (["up", "elbwo"], "did you mean 'elbow'?"),
        (["up", "elbow", "--only", "estimtor"], "did you mean 'estimator'?"),
        (["topic", "hz", "ChianState"], "did you mean 'ChainState'?"),
        (["taks"], "did you mean 'task'?"),
        (["fault", "mend", "drop", "arm", "leg"], "mend [KIND] [TARGET]"),
        (["topic", "echo"], "topic list"),
        (["topic", "echo", "Plug"], "events"),
        (["replay", "--speed", "nan"], "--speed"),
        (["replay", "--robot", "a/b"], "letters"),
    ],
)
def test_wrong_usage_is_told_with_the_remedy(
    words: list[str], remedy: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == USAGE
    assert remedy in capsys.readouterr().err


def test_topic_list_is_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["topic", "list"]) == DONE
    assert "chain/{chain}/state" in capsys.readouterr().out


@pytest.mark.parametrize("words", [["replay"], ["events"], ["logs"], ["replay", "elbow"]])
def test_without_a_run_they_say_what_to_give(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == REFUSED
    assert "give a robot's name, a run's folder or a recording" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("myograft sta", {"status"}),
        ("myograft fault ru", {"rupture"}),
        ("myograft plug biceps_", {"biceps_1", "biceps_2", "biceps_3"}),
        ("myograft task sw", {"sweep"}),
        ("myograft reach forearm", {"forearm_rotation="}),
        ("myograft up musashi_a", {"musashi_arm"}),
        ("myograft replay --check ", {"estimator"}),
        ("myograft identify tric", {"triceps"}),
    ],
)
def test_a_line_is_completed(line: str, words: set[str], tmp_path: Path) -> None:
    assert completed(line, tmp_path) == words


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("myograft logs ", {"driver-arm", "world"}),
        ("myograft schema rollback ", {"1", "12"}),
        ("myograft task ", {"left", "right", "sweep", "park", "hold", "cancel"}),
        ("myograft identify le", {"left"}),
    ],
)
def test_a_line_is_completed_by_what_runs(line: str, words: set[str], tmp_path: Path) -> None:
    """Two elbows run, as far as the registry says, and one has learned."""
    file = load_robot("elbow").file
    hubs = [Hub(robot=name, pid=1, endpoint="", file=file) for name in ("left", "right")]
    claims = [Claim(hub) for hub in hubs]
    run = "runs/20261122T000000.000000Z/logs"
    state = "state/retrainer"
    for name in (f"{state}/v0001", f"{state}/v0012", f"{state}/active", f"{run}/world.log"):
        path = tmp_path / "myograft" / "left" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
        path.with_name("driver-arm.log").touch()
    try:
        assert completed(line, tmp_path) == words
    finally:
        for claim in claims:
            claim.release()


def completed(line: str, folder: Path) -> set[str]:
    """How a shell is told that the line could go on."""
    answer = folder / "answer"
    environment = {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    subprocess.run(
        [sys.executable, "-m", "runtime.cli.main"], env={**os.environ, **environment}, check=False
    )
    return {word.strip() for word in answer.read_text().split("\n") if word}


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_gets_its_code(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == DONE
    assert "myograft" in capsys.readouterr().out


def test_doctor_finds_this_host_sound(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == DONE
    assert "core" in capsys.readouterr().out
