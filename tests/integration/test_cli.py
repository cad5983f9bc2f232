"""Commands against a robot that is nothing but a bus: what they hear, and what they say."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
import zenoh
from rich.console import Console

from runtime import messages as m
from runtime.bus import Bus
from runtime.cli.client import connect
from runtime.cli.live_status import render
from runtime.cli.main import DONE, NOT_RUNNING, REFUSED, USAGE, main
from runtime.cli.status import Picture
from runtime.hubs import Claim, Hub, find_hub, free_endpoint
from runtime.journal import Journal
from runtime.runs import read_all, recordings
from runtime.settings import load_robot
from tests.made_up_run import run
from tests.started import started

SECOND = 1_000_000_000
PATIENCE_S = 30.0


class Robot:
    """Says over and over what a made-up run says at its end."""

    def __init__(self, bus: Bus, endpoint: str, folder: Path) -> None:
        self.bus = bus
        self.endpoint = endpoint
        self.folder = folder
        self.messages = [message for _, message in run(0.5)]


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    home = tmp_path_factory.mktemp("home")
    folder = home / "run"
    (folder / "logs").mkdir(parents=True)
    endpoint = free_endpoint()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(home))
        patch.setenv("COLUMNS", "200")
        hub = Hub(robot="elbow", pid=os.getpid(), endpoint=endpoint, run_dir=str(folder))
        claim = Claim(hub)
        over = threading.Event()
        with Bus("elbow", "test", listen=endpoint) as bus:
            made_up = Robot(bus, endpoint, folder)

            def speak() -> None:
                while not over.wait(0.05):
                    for message in made_up.messages:
                        bus.publish(message)

            speaker = threading.Thread(target=speak)
            speaker.start()
            yield made_up
            over.set()
            speaker.join()
        claim.release()


def said(capsys: pytest.CaptureFixture[str], *words: str, code: int = DONE) -> str:
    assert main(list(words)) == code
    told = capsys.readouterr()
    return told.out if code == DONE else told.err


@pytest.mark.usefixtures("robot")
@pytest.mark.parametrize(
    "words",
    [
        ["task", "nosuch", "sweep"],
        ["plug", "nosuch", "biceps_3"],
        ["unplug", "nosuch", "biceps_3"],
        ["identify", "nosuch", "biceps_1"],
        ["reach", "nosuch", "elbow=45"],
        ["status", "nosuch"],
    ],
)
def test_another_robots_name_is_not_taken_for_the_only_one(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == NOT_RUNNING
    assert "'nosuch' is not running" in capsys.readouterr().err


def test_any_key_is_echoed_and_what_is_foreign_is_told(
    robot: Robot, capsys: pytest.CaptureFixture[str]
) -> None:
    assert '"stage":"hold"' in said(capsys, "topic", "echo", "ExecutiveState", "--count", "1")
    for key in ("chain/arm/state", "elbow/chain/arm/state", "**/state", "chain/**"):
        assert '"chain":"arm"' in said(capsys, "topic", "echo", key, "--count", "1")
    assert "request" in said(capsys, "topic", "echo", "request/plug", code=USAGE)
    assert "topic list" in said(capsys, "topic", "echo", "Evnt", code=USAGE)
    assert "key expression" in said(capsys, "topic", "echo", "a//b", code=NOT_RUNNING)

    config = zenoh.Config.from_json5(
        f'{{mode: "client", connect: {{endpoints: ["{robot.endpoint}"]}}}}'
    )
    over = threading.Event()
    with zenoh.open(config) as stranger:

        def mutter() -> None:
            while not over.wait(0.02):
                stranger.put("elbow/notes/today", "grüezi", encoding="text/plain")
                stranger.put("elbow/notes/raw", b"\xff\x00", encoding="application/x-raw")
                stranger.put("elbow/event", b"\xc1", encoding="application/msgpack;type=Event;v=1")

        muttering = threading.Thread(target=mutter)
        muttering.start()
        try:
            text = said(capsys, "topic", "echo", "notes/today", "--count", "1")
            raw = said(capsys, "topic", "echo", "notes/raw", "--count", "1")
            rates = said(capsys, "topic", "bw", "notes/**", "--seconds", "0.3")
        finally:
            over.set()
            muttering.join()
    assert '"text":"grüezi"' in text and '"encoding":"text/plain"' in text
    assert '"text":"ff 00"' in raw and '"bytes":2' in raw
    assert "2 B each" in rates and "on 2 keys" in rates


def test_rates_and_bandwidth(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    assert "elbow/chain/arm/state: " in said(
        capsys, "topic", "hz", "ChainState", "--seconds", "0.3"
    )
    everything = said(capsys, "topic", "bw", "--seconds", "0.3")
    assert "elbow/joint/estimate: " in everything
    assert "/s on " in everything
    nothing = said(capsys, "topic", "bw", "hand/*/state", "--seconds", "0.05")
    assert nothing.startswith("nothing on elbow/hand/*/state")
    assert "--seconds" in said(capsys, "topic", "bw", "--seconds", "0", code=USAGE)


def test_events_of_a_robot_that_runs(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    assert "hold begins" in said(capsys, "events")
    assert '"kind":"hold"' in said(capsys, "events", "elbow", "--json")


def test_the_live_table_shows_what_matters(robot: Robot) -> None:
    with connect() as client:
        picture = Picture(client.robot)
        client.bus.subscribe(*Picture.inputs)

        def take(message: m.Message) -> bool:
            picture.take(message)
            known = (
                picture.schema,
                picture.executive,
                picture.estimate,
                picture.group,
                picture.states,
                picture.bodies,
            )
            return all(known)

        client.gather(take, PATIENCE_S)
    narrow, wide = (shown(picture, width) for width in (100, 160))
    for words in ("elbow", "hold", "schema 1 (shipped)", "biceps_1", "150", "retrainer", "silent"):
        assert words in narrow, narrow
        assert words in wide, wide
    assert "█" in narrow
    assert len(wide.splitlines()) < len(narrow.splitlines())


def shown(picture: Picture, width: int) -> str:
    console = Console(width=width, file=io.StringIO())
    with console.capture() as capture:
        console.print(render(picture, width, silent_s=4.0))
    return capture.get()


def test_a_recording_of_it_is_played_by_topics(
    robot: Robot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "messages.mcap"
    with Journal(path, "elbow") as journal:
        for now_ns, message in run(2.0):
            journal.write(message, SECOND + now_ns)
    assert "nothing is played into it" in said(capsys, "replay", str(path), code=REFUSED)
    assert "topic list" in said(capsys, "replay", str(path), "--topics", "Nope", code=USAGE)
    assert "--speed" in said(capsys, "replay", str(path), "--speed", "0", code=USAGE)
    assert "names no robot file" in said(
        capsys, "replay", str(path), "--check", "estimator", code=USAGE
    )
    command = [sys.executable, "-m", "runtime.cli.main", "replay", str(path), "--speed", "inf"]
    words = ["--robot", "other", "--no-view", "--topics", "ExecutiveState,event"]
    played = subprocess.run(
        [*command, *words], capture_output=True, text=True, timeout=2 * PATIENCE_S
    )
    assert played.returncode == DONE, played.stderr
    told = list(read_all(recordings(str(path)), (m.ExecutiveState, m.Event)))
    assert f"{len(told)} messages" in played.stdout


def test_a_replay_of_a_real_robot_has_its_picture_and_its_time(
    robot: Robot, tmp_path: Path
) -> None:
    """Nobody tells the time of a robot without a world: the picture must not take the host's."""
    shipped = load_robot("elbow")
    text = Path(shipped.file).read_text().replace('link = "sim:"', 'link = "serial:///dev/null"')
    file = tmp_path / "elbow.toml"
    file.write_text(text.replace('"../', f'"{Path(shipped.file).parent}/../'))
    begin_ns = 10**15
    path = tmp_path / "messages.mcap"
    with Journal(path, "elbow", str(file)) as journal:
        for now_ns, message in run(1.0):
            if not isinstance(message, m.Clock):
                stamped = msgspec.structs.replace(message, stamp_ns=begin_ns + now_ns)
                journal.write(stamped, SECOND + now_ns)
    words = ["replay", str(path), "--robot", "real", "--stay"]
    with started("-m", "runtime.cli.main", *words) as player:
        assert player.stdout is not None
        said = [player.stdout.readline() for _ in range(3)]
        assert "at its end, and stays" in said[-1], said
        folder = Path(find_hub("real").run_dir)
        with connect("real") as client:
            client.bus.subscribe(m.Health)
            heard = client.gather(
                lambda x: isinstance(x, m.Health) and x.process == "viz", PATIENCE_S
            )
        player.send_signal(signal.SIGINT)
        assert player.wait(PATIENCE_S) == DONE
    assert begin_ns < heard[-1].stamp_ns < begin_ns + 2 * SECOND
    assert not folder.exists(), "it leaves nothing behind"


def test_logs_are_interleaved_by_time(robot: Robot, capsys: pytest.CaptureFixture[str]) -> None:
    logs = robot.folder / "logs"
    (logs / "world.log").write_text(
        "2026-11-22 10:00:00,100 INFO first\n2026-11-22 10:00:00,300 ERROR third\nTraceback\n"
    )
    (logs / "viz.log").write_text("\x1b[2m2026-11-22T10:00:00.200015Z\x1b[0m WARN second\nhalf")
    shown = said(capsys, "logs").splitlines()
    assert [line.split()[-1] for line in shown] == ["first", "second", "third", "Traceback"]
    assert [line.split()[0] for line in shown] == ["world", "viz", "world", "world"]
    assert said(capsys, "logs", "-n", "1").split() == ["world", "Traceback"]
    assert "viz, world" in said(capsys, "logs", "nobody", code=USAGE)


def test_logs_are_followed(robot: Robot) -> None:
    log = robot.folder / "logs" / "late.log"
    log.write_text("")
    log.with_name("later.log").write_text("begun\n")
    with started("-m", "runtime.cli.main", "logs", "-f", "late", "later") as following:
        assert following.stdout is not None
        assert following.stdout.readline().split() == ["later", "begun"]
        with log.open("a") as file:
            file.write("restarted\n")
        assert following.stdout.readline().split() == ["late", "restarted"]
