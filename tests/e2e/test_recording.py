"""Everything is killed in mid-run: what is left on disk opens, is complete, and plays."""

from __future__ import annotations

import os
import re
import signal
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from dashboard.blueprint import TIMELINE
from runtime import messages as m
from runtime.bus import Bus
from runtime.cli.main import DONE, REFUSED, main
from runtime.hubs import find_hub
from runtime.runs import read_all, recordings
from runtime.settings import RobotSettings
from tests.e2e.conftest import Command, Watch, elbow, within

pytestmark = pytest.mark.e2e

NAME = "kept"
RUN_S = 5.0
LOST_S = 1.0  # of robot time, which runs no faster than wall time here
STRONGEST_N = 150.0
# Of wall time, from the second Ctrl-C until all is over: half a second for each of eight processes
# that is killed because it does not go, and for the supervisor itself. Parking has twenty.
AT_ONCE_S = 7.0


class Killed(NamedTuple):
    """A run of which everything was killed."""

    folder: Path
    last_s: float  # robot time, the last that the world told


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> RobotSettings:
    return elbow(tmp_path_factory.mktemp("kept"), NAME)


@contextmanager
def up(robot: RobotSettings) -> Iterator[tuple[Command, Bus, Watch]]:
    """`myograft up`, ready, and someone who watches."""
    command = Command("up", robot.file)
    try:
        command.wait_line("ready after")
        with (
            Bus(NAME, "test", endpoint=find_hub(NAME).endpoint) as bus,
            Watch(bus) as watch,
        ):
            yield command, bus, watch
    finally:
        command.end()


def sweep(bus: Bus, watch: Watch) -> None:
    """Start the sweep and see the arm move."""
    watch.wait_for(m.ExecutiveState, lambda x: x.stage == "hold" and x.settled, since=0)
    since = watch.mark()
    (reply,) = bus.request(m.Task(name="sweep"))
    assert reply.ok, reply.text
    watch.wait_for(m.ExecutiveState, lambda x: x.stage == "move" and not x.settled, since=since)


@pytest.fixture(scope="module")
def killed(robot: RobotSettings) -> Killed:
    with up(robot) as (command, bus, watch):
        sweep(bus, watch)
        watch.wait_for(m.Clock, lambda x: x.stamp_ns > RUN_S * 1e9, since=0)
        group = watch.last(m.GroupState)
        for pid in (command.process.pid, *(row.pid for row in group.processes)):
            os.kill(pid, signal.SIGKILL)
        command.process.wait()
        gone = {row.process for row in group.processes}
        for process in gone:
            watch.wait_for(
                m.Presence, lambda x, name=process: x.process == name and not x.alive, since=0
            )
        return Killed(Path(group.run_dir), watch.last(m.Clock).stamp_ns * 1e-9)


def last_drawn_s(file: Path) -> float:
    """Robot time of the last thing that a picture shows."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no footer: its writer was killed
        chunks = RrdReader(str(file)).stream()
    columns = [
        batch.column(TIMELINE)
        for chunk in chunks
        if TIMELINE in (batch := chunk.to_record_batch()).schema.names and batch.num_rows
    ]
    return max(column[-1].value for column in columns) * 1e-9


def test_what_was_killed_lacks_at_most_its_last_second(killed: Killed) -> None:
    told = [
        entry.message.stamp_ns for entry in read_all(recordings(str(killed.folder)), (m.Clock,))
    ]
    lost_s = killed.last_s - told[-1] * 1e-9
    drawn_lost_s = killed.last_s - last_drawn_s(killed.folder / f"{NAME}.rrd")
    print(
        f"killed at {killed.last_s:.2f} s of robot time: the messages lack {lost_s:.2f} s, "
        f"the picture {drawn_lost_s:.2f} s"
    )
    assert lost_s < LOST_S
    assert drawn_lost_s < LOST_S


def test_the_estimator_gives_its_recorded_outputs(
    killed: Killed, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(killed.folder), "--check", "estimator"]) == DONE
    said = capsys.readouterr().out
    print(said)
    recorded = list(read_all(recordings(str(killed.folder)), (m.JointEstimate,)))
    assert len(recorded) > 50 * RUN_S / 2
    assert "differs" not in said
    assert "messages it took in" not in said


def test_a_run_that_is_over_is_read_without_a_robot(
    killed: Killed, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["events", NAME]) == DONE
    assert "schema version 1 (shipped) controls" in capsys.readouterr().out
    assert main(["logs", "--run", NAME, "estimator", "world"]) == DONE
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines} == {"estimator", "world"}


def test_it_plays_under_another_name_and_gives_no_orders(killed: Killed) -> None:
    words = ("--robot", "again", "--speed", "2", "--no-view", "--stay")
    player = Command("replay", str(killed.folder), *words)
    player.wait_line("Ctrl-C ends it")
    with Bus("again", "test", endpoint=find_hub("again").endpoint) as bus, Watch(bus) as watch:
        bus.subscribe(m.ChainCommand, every=True)
        since = watch.mark()
        _, first = watch.wait_for(m.Clock, since=since)
        player.wait_line("stays")
        assert main(["replay", str(killed.folder), "--robot", "again"]) == REFUSED
        _, last = watch.wait_for(
            m.Clock, lambda x: x.stamp_ns > (killed.last_s - 1.0) * 1e9, since=since
        )
        assert player.end() == DONE
        played = watch.of(m.WorldTruth, since)
    assert last.speed == 2.0
    said = re.search(r"(\S+) times as fast as it was", "".join(player.lines))
    assert said is not None
    print(f"played {said[0]}, {len(played)} truths")
    assert float(said[1]) < 2.1, "on a busy machine it may be slower"
    assert len(played) > 0.9 * 200 * (last.stamp_ns - first.stamp_ns) * 1e-9
    assert not watch.of(m.ChainCommand)


@pytest.fixture(scope="module")
def risen(robot: RobotSettings, killed: Killed) -> Iterator[tuple[Command, Watch]]:
    """The same robot, started again."""
    with up(robot) as (command, _, watch):
        yield command, watch


def test_it_goes_on_with_what_it_was_about(risen: tuple[Command, Watch], killed: Killed) -> None:
    _, watch = risen
    _, state = watch.wait_for(m.ExecutiveState, lambda x: x.stage == "move", since=0)
    assert state.task == "sweep"
    watch.wait_for(m.Clock, lambda x: x.stamp_ns > killed.last_s * 1e9, since=0)


def test_a_cable_pulled_in_mid_chain_silences_what_is_behind_it(
    risen: tuple[Command, Watch], capsys: pytest.CaptureFixture[str]
) -> None:
    _, watch = risen
    since = watch.mark()
    assert main(["fault", "cable", "biceps_2"]) == DONE
    watch.wait_for(m.ChainBody, lambda x: states(x)["elbow"] == "lost", since=since)
    seen = states(watch.last(m.ChainBody))
    assert seen == {"triceps": "up", "biceps_1": "up", "biceps_2": "lost", "elbow": "lost"}
    assert main(["fault", "list"]) == DONE
    assert capsys.readouterr().out.splitlines()[-1].split() == ["cable", "biceps_2"]
    since = watch.mark()
    assert main(["fault", "mend", "biceps_2"]) == DONE
    watch.wait_for(m.ChainBody, lambda x: set(states(x).values()) == {"up"}, since=since)
    assert main(["fault", "mend"]) == REFUSED


def states(body: m.ChainBody) -> dict[str, str]:
    return {module.name: module.state for module in body.modules}


def test_ctrl_c_twice_lets_the_wires_go_at_once(risen: tuple[Command, Watch]) -> None:
    command, watch = risen
    since = watch.mark()
    command.process.send_signal(signal.SIGINT)
    command.wait_line("parking")
    asked_s = time.monotonic()
    assert command.end() == DONE
    took_s = time.monotonic() - asked_s
    modes = {state.mode for state in watch.of(m.ChainState, since)}
    strongest_n = max(watch.last(m.WorldTruth).peak_tension_n)
    print(f"over {took_s:.2f} s after the second Ctrl-C, {strongest_n:.0f} N at most")
    assert f"{NAME}: stopping the arm\n" in command.lines
    assert f"{NAME}: stopped\n" in command.lines
    assert modes & {"stopping", "stopped"}, "the wires were not let go"
    assert within(took_s, AT_ONCE_S)
    assert strongest_n < STRONGEST_N
