"""`myograft view`: what it finds, and what it says when there is nothing; the summary's picture."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from dashboard.commands import find_sources
from dashboard.photo import photograph
from dashboard.summary import draw_summary, name_width, places
from dashboard.viewer import ViewerError, has_display
from runtime.cli.main import REFUSED, USAGE, main
from runtime.hubs import Claim, Hub, HubError


def test_stream_needs_neither_rerun_nor_mujoco() -> None:
    code = (
        "import sys, dashboard.stream, dashboard.commands, dashboard.summary;"
        "heavy = {'rerun', 'mujoco', 'matplotlib.pyplot'} & set(sys.modules);"
        "sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.fixture
def no_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("MYOGRAFT_ENDPOINT", raising=False)
    return tmp_path / "myograft"


def test_view_shows_the_last_run_of_a_robot_that_does_not_run(no_robot: Path) -> None:
    for i, name in enumerate(("old/elbow.rrd", "new/elbow.rrd", "new/elbow-2.rrd")):
        file = no_robot / "elbow" / "runs" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
        os.utime(file, (i, i))
    runs = no_robot / "elbow" / "runs" / "new"
    assert find_sources("elbow") == [str(runs / "elbow.rrd"), str(runs / "elbow-2.rrd")]
    assert find_sources(str(runs / "elbow.rrd")) == [str(runs / "elbow.rrd")]
    assert find_sources(str(runs)) == find_sources("elbow"), "a run's folder"


def test_view_of_a_folder_shows_all_robots_in_the_order_of_their_pieces(tmp_path: Path) -> None:
    for name in ("right.rrd", "left-10.rrd", "left-2.rrd", "left.rrd", "messages.mcap"):
        (tmp_path / name).touch()
    names = [Path(source).name for source in find_sources(str(tmp_path))]
    assert names == ["left.rrd", "left-2.rrd", "left-10.rrd", "right.rrd"]


def test_a_robots_name_goes_before_a_folder_that_is_called_the_same(
    no_robot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = no_robot / "elbow" / "runs" / "1" / "elbow.rrd"
    here = tmp_path / "here" / "elbow" / "elbow.rrd"
    for file in (run, here):
        file.parent.mkdir(parents=True)
        file.touch()
    monkeypatch.chdir(tmp_path / "here")
    assert find_sources("elbow") == [str(run)]
    run.unlink()
    assert find_sources("elbow") == [os.path.join("elbow", "elbow.rrd")]


def test_view_says_what_is_missing(no_robot: Path) -> None:
    with pytest.raises(HubError, match="'elbow' has left no recording, and no robot is running"):
        find_sources("elbow")
    with pytest.raises(HubError, match="no robot is running"):
        find_sources()
    (no_robot / "elbow" / "runs" / "1").mkdir(parents=True)
    with pytest.raises(
        HubError, match=r"'elbo' is not running and has left no .*; did you mean 'elbow'\?$"
    ):
        find_sources("elbo")
    with pytest.raises(ViewerError, match=r"no recording nowhere\.rrd"):
        find_sources("nowhere.rrd")
    (no_robot / "empty").mkdir(parents=True)
    with pytest.raises(ViewerError, match=r"no recording \(\.rrd\) in .*empty"):
        find_sources(str(no_robot / "empty"))
    (no_robot / "messages.mcap").touch()
    with pytest.raises(ViewerError, match=r"messages\.mcap is no recording of the picture"):
        find_sources(str(no_robot / "messages.mcap"))


def test_view_tells_mistakes_in_a_sentence(
    no_robot: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["view", "elbow", "--at", "3"]) == USAGE
    assert "--at goes with --picture" in capsys.readouterr().err
    assert main(["view", "nowhere.rrd", "--picture", "x.png"]) == REFUSED
    assert capsys.readouterr().err == "myograft: there is no recording nowhere.rrd\n"
    with pytest.raises(ViewerError, match=r"there is no folder .*missing"):
        photograph(["run.rrd"], no_robot / "missing" / "x.png")


def test_view_finds_the_live_address_once_somebody_answers_there(
    no_robot: Path, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"rerun+http://127.0.0.1:{server.getsockname()[1]}/proxy"
        hub = Hub(robot="elbow", pid=os.getpid(), endpoint="tcp/x", run_dir=str(tmp_path))
        claim = Claim(hub)
        (tmp_path / "elbow.viewer").write_text(url)
        assert find_sources("elbow") == [url]
        assert find_sources() == [url]
        claim.release()


def test_window_needs_a_display() -> None:
    assert not has_display({}, "linux")
    assert has_display({"DISPLAY": ":0"}, "linux")
    assert has_display({"WAYLAND_DISPLAY": "wayland-0"}, "linux")
    assert has_display({}, "darwin")


def test_summary_is_a_picture_also_of_one_muscle_and_nothing_else(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    time_s = np.linspace(0.0, 90.0, 300)
    full, bare = tmp_path / "full.png", tmp_path / "bare.png"
    draw_summary(
        full,
        time_s=time_s,
        angle_deg={"reference": time_s, "measured": time_s, "true": time_s},
        tension_n={"triceps": time_s, "biceps_3": np.where(time_s < 40.0, np.nan, 5.0)},
        marks=[(40.0, "plug"), (41.0, "collect"), (60.0, "relearn")],
        table=[("", "before", "after"), ("mean tension", "31 N", "19 N")],
        title="A muscle is plugged in",
    )
    draw_summary(bare, time_s=time_s, angle_deg={}, tension_n={"triceps": time_s})
    for file in (full, bare):
        assert file.read_bytes().startswith(b"\x89PNG")
    assert full.stat().st_size > bare.stat().st_size


def test_names_of_marks_are_never_written_over_each_other() -> None:
    names = ("plug", "join", "collect", "relearn", "check", "adopt", "resume", "hold")
    marks = [(40.0 + 0.1 * i, name) for i, name in enumerate(names)]
    placed = [
        (middle - 50.0 * name_width(name), middle + 50.0 * name_width(name), level)
        for (_, name), (middle, level) in zip(marks, places(marks, 0.0, 100.0), strict=True)
    ]
    assert {level for _, _, level in placed} == {0, 1, 2}
    for (_, end, level), later in pairwise(sorted(placed, key=lambda x: (x[2], x[0]))):
        assert later[2] > level or later[0] >= end - 1e-9
