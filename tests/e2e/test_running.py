"""A running robot: it is stopped and reset, told nonsense, and given a broken memory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
import zenoh

from runtime import messages as m
from runtime.envelope import encode, encoding_of
from runtime.store import FileStore
from runtime.topics import REQUESTS, TOPICS, key_of, key_pattern
from services.logic.versions import Versions
from tests.e2e.conftest import PATIENCE_S, Robot, elbow, running

pytestmark = pytest.mark.e2e

SPEED = 2.0
SLACK_N = 5.0  # as the driver has it
NOISE_N = 1.0


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    folder = tmp_path_factory.mktemp("told")
    settings = elbow(folder, "told", steps=4)
    shipped = settings.schema_file
    assert shipped is not None
    tear(FileStore(folder / "state" / "retrainer"), shipped.read_bytes())
    with running(settings, folder, speed=SPEED) as robot:
        yield robot


def tear(store: FileStore, shipped: bytes) -> None:
    """Leave a schema in a store as a broken disk would: half of it is there."""
    versions = Versions(store, shipped)
    schema = versions.schema(1)
    versions.activate(versions.add(schema, "iii", "candidate", job="old", parent=1, train_s=1.0))
    path = store.folder / "v0002"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def test_a_torn_schema_is_told_and_the_shipped_one_used(robot: Robot) -> None:
    torn = robot.watch.wait_for(m.Event, lambda x: x.kind == "schema_corrupt", since=0)[1]
    assert "version 2 cannot be read" in torn.text
    assert robot.watch.last(m.SchemaVersion).method == "shipped"


def sweep(robot: Robot) -> int:
    """Start the sweep and see the arm move; the place in the watch where that was."""
    since = robot.watch.mark()
    robot.ask(m.Task(name="sweep"))
    robot.watch.wait_for(
        m.ExecutiveState,
        lambda x: x.stage == "move" and x.step == 3 and not x.settled,
        since=since,
    )
    return since


def test_estop_while_moving_lets_tension_go_and_latches(robot: Robot) -> None:
    watch = robot.watch
    sweep(robot)
    _, pulls = watch.wait_for(
        m.WorldTruth, lambda x: max(x.tension_n) > 4 * SLACK_N, since=watch.mark()
    )
    since = watch.mark()
    robot.ask(m.Estop(reason="a test"))
    _, said = watch.wait_for(m.Event, lambda x: x.kind == "stopped", since=since)
    watch.wait_for(m.WorldTruth, lambda x: x.stamp_ns >= said.stamp_ns, since=since)
    latest = [x for x in watch.of(m.WorldTruth, since) if x.stamp_ns <= said.stamp_ns][-1]
    assert max(latest.tension_n) < SLACK_N + NOISE_N, "it said so before it was so"
    print(f"estop: {max(pulls.tension_n):.0f} N became {max(latest.tension_n):.1f} N")

    watch.wait_for(m.ExecutiveState, lambda x: x.stage == "stopped", since=since)
    refused = robot.group.request(m.Task(name="sweep"))
    assert [reply.ok for reply in refused] == [False]
    assert "reset" in refused[0].text


def test_a_stop_outlives_its_driver(robot: Robot) -> None:
    since = robot.watch.mark()
    robot.kill("driver-arm")
    robot.watch.wait_for(
        m.Event,
        lambda x: x.kind == "process_restarted" and x.data["process"] == "driver-arm",
        since=since,
    )
    back = robot.watch.mark()
    _, state = robot.watch.wait_for(m.ChainState, since=back)
    assert state.mode in ("stopping", "stopped")


def test_reset_holds_where_the_arm_is(robot: Robot) -> None:
    watch = robot.watch
    sunk_rad = watch.last(m.WorldTruth).angle_rad[0]
    since = watch.mark()
    robot.ask(m.Reset())
    _, held = watch.wait_for(
        m.ExecutiveState, lambda x: x.stage == "hold" and x.settled, since=since
    )
    angles = [x.angle_rad[0] for x in watch.of(m.WorldTruth, since)]
    assert np.degrees(np.ptp(angles)) < 15.0
    assert held.reference_rad[0] == pytest.approx(sunk_rad, abs=np.radians(15.0))
    again = watch.mark()
    robot.ask(m.Task(name="sweep"))
    watch.wait_event("task_done", since=again, timeout_s=2 * PATIENCE_S)


def test_nonsense_on_every_topic_ends_nothing(robot: Robot) -> None:
    """What is no message at all, and what only says that it is one."""
    watch, name = robot.watch, robot.group.settings.name
    pids = {row.process: (row.pid, row.restarts) for row in robot.group.rows}
    since = sweep(robot)
    config = zenoh.Config.from_json5(
        f'{{mode: "client", connect: {{endpoints: ["{robot.group.endpoint}"]}}, '
        "scouting: {multicast: {enabled: false}}}"
    )
    with zenoh.open(config) as stranger:
        kinds = [row.message for row in TOPICS]
        for kind in kinds:
            key = key_pattern(name, kind).replace("*", "arm")
            right = encoding_of(kind)
            odd = [(b"\xc1", right), (b"{}", "application/json"), (b"", right), (b"\x80", right)]
            odd += [(b"\x81\xa8stamp_ns\xa1x", right), (b"\x80", right.replace("v=", "v=9"))]
            for payload, encoding in odd * 5:
                stranger.put(key, payload, encoding=encoding)
        for row in REQUESTS:
            key = key_pattern(name, row.message)
            answers = stranger.get(key, payload=b"\xc1", encoding=encoding_of(row.message))
            assert all(answer.ok is not None for answer in answers)
        # well-formed, but for things that are not there
        for strange in (
            m.ChainState(
                chain="leg",
                muscles=("calf",),
                length_m=(float("nan"),),
                tension_n=(1e9,),
                temperature_degc=(0.0,),
                target_length_m=(0.0,),
                mode="?",
            ),
            m.ChainCommand(
                chain="arm",
                author="nobody",
                lease_ns=10**18,
                muscles=("triceps",),
                bias_n=(1e6,),
                stiffness_n_m=(1e6,),
                target_length_m=(-1.0,),
            ),
            m.BusReply(chain="arm", sequence=1, data=b"\xff\xff\xfd\x00"),
            m.BusRequest(chain="arm", sequence=1, data=b"\xff\xff\xfd\x00"),
            m.SchemaVerdict(job="none", adopted=True, reason=""),
            m.Event(process="nobody", level="?", kind="plugged", text=""),
        ):
            stranger.put(
                key_of(name, strange), encode(strange), encoding=encoding_of(type(strange))
            )
    watch.wait_for(m.Event, lambda x: x.kind == "message_dropped", since=since)
    watch.wait_event("task_done", since=since, timeout_s=2 * PATIENCE_S)
    watch.wait_for(m.Health, lambda x: x.process == "executive", since=watch.mark())
    assert {row.process: (row.pid, row.restarts) for row in robot.group.rows} == pids
    ended = [x.text for x in watch.events(since) if x.kind in ("process_died", "tick_failed")]
    assert not ended
