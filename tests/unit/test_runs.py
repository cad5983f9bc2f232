"""Which run is meant, and what it has left."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer
from msgspec.structs import replace

from runtime.cli.main import DONE, REFUSED, USAGE, main
from runtime.hubs import Claim, Hub, new_run_dir
from runtime.journal import Journal
from runtime.messages import Event, ExecutiveState
from runtime.runs import RunError, about_all, find_run, read_all, recordings

SECOND = 1_000_000_000


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path


def a_run(robot: str, files: int = 1) -> Path:
    """A run of a robot whose recorder was restarted so often."""
    folder = new_run_dir(robot)
    for n in range(1, files + 1):
        name = "messages.mcap" if n == 1 else f"messages-{n}.mcap"
        with Journal(folder / name, robot, f"{robot}.toml") as journal:
            journal.write(ExecutiveState(stage="hold", step=n), wall_ns=n * SECOND)
    return folder


def test_a_robots_last_run_with_something_in_it() -> None:
    left = a_run("left")
    right = a_run("right")
    new_run_dir("left")  # has left nothing: it was refused
    assert recordings("left") == [left / "messages.mcap"]
    assert recordings() == [right / "messages.mcap"]
    assert find_run(str(left)) == left
    assert find_run(str(left / "messages.mcap")) == left
    assert recordings(str(left / "messages.mcap")) == [left / "messages.mcap"]


def test_the_run_that_goes_on_comes_first(tmp_path: Path) -> None:
    a_run("left")
    here = tmp_path / "here"
    here.mkdir()
    claim = Claim(Hub(robot="left", pid=1, endpoint="tcp/x", run_dir=str(here)))
    try:
        assert find_run("left") == find_run("left", "messages*.mcap") or not any(here.iterdir())
        with Journal(here / "messages.mcap", "left"):
            pass
        assert find_run("left", "messages*.mcap") == here
    finally:
        claim.release()


def test_older_runs_are_removed_and_nothing_else(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lefts = [a_run("left") for _ in range(4)]
    right = a_run("right")
    (learned := home / "myograft" / "left" / "state" / "retrainer").mkdir(parents=True)
    (lefts[1] / "elbow.rrd").write_bytes(bytes(2_500_000))
    claim = Claim(Hub(robot="left", pid=1, endpoint="tcp/x", run_dir=str(lefts[0])))
    try:
        assert main(["runs", "left"]) == DONE
        rows = capsys.readouterr().out.splitlines()
        assert [row.split()[1] for row in rows[:-1]] == [run.name for run in lefts]
        assert rows[0].endswith("goes on") and "2.5 MB" in rows[1] and "2.5 MB in " in rows[4]
        assert all(run.exists() for run in lefts)
        assert main(["runs", "left", "--keep", "1"]) == DONE
        assert [run.exists() for run in lefts] == [True, False, False, True]
        assert main(["runs", "--keep", "0"]) == DONE
    finally:
        claim.release()
    assert [run.exists() for run in (*lefts, right)] == [True, False, False, False, False]
    assert learned.is_dir()
    assert not (right.parent / "latest").is_symlink()
    assert main(["runs", "--keep", "-1"]) == USAGE
    assert main(["runs", "lefft"]) == REFUSED
    assert "did you mean 'left'?" in capsys.readouterr().err


def test_files_of_one_run_are_read_in_the_order_written() -> None:
    files = recordings(str(a_run("left", files=11)))
    steps = [entry.message.step for entry in read_all(files)]  # type: ignore[attr-defined]
    assert steps == list(range(1, 12))
    assert about_all(files) == ("left", "left.toml", SECOND, 11 * SECOND)


def test_what_a_restarted_recorder_is_told_again_is_left_out() -> None:
    folder = new_run_dir("left")
    event = Event(stamp_ns=1, process="world", level="info", kind="plugged", text="a")
    state = ExecutiveState(stamp_ns=1, stage="hold")
    for name in ("messages.mcap", "messages-2.mcap"):
        with Journal(folder / name, "left") as journal:
            for message in (event, event, state):
                journal.write(message, wall_ns=SECOND)
            journal.write(replace(event, text=name), wall_ns=SECOND)
    told = [entry.message for entry in read_all(recordings(str(folder)))]
    assert told.count(event) == 2, "said twice"
    assert told.count(state) == 2
    assert len(told) == 6


def test_what_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="no run of any robot"):
        recordings()
    with pytest.raises(RunError, match="no run of 'elbow'"):
        find_run("elbow")
    new_run_dir("elbow")
    with pytest.raises(RunError, match=r"no run of 'elbo' .*; did you mean 'elbow'\?$"):
        recordings("elbo")
    for odd in (str(tmp_path / "nope"), "a**b"):
        with pytest.raises(RunError, match="no run of"):
            find_run(odd)
    with pytest.raises(RunError, match=r"messages\.mcap"):
        recordings("run/elbow.rrd")
    with pytest.raises(RunError, match="no messages were recorded"):
        recordings(str(new_run_dir("left")))
    empty = tmp_path / "messages.mcap"
    with Journal(empty, "left"):
        pass
    with pytest.raises(RunError, match="holds no messages"):
        about_all([empty])


def test_a_recording_of_somebody_else_is_told(tmp_path: Path) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/scan", "json", 0)
        writer.add_message(channel, log_time=5, data=b"{}", publish_time=5)
        writer.finish()
    with pytest.raises(RunError, match="holds no messages of myograft"):
        about_all([path])
