"""`myograft up` as its user has it: two robots at once on one network, ended by Ctrl-C."""

from __future__ import annotations

import json
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

from runtime import messages as m
from runtime.bus import Bus
from runtime.cli.main import DONE, USAGE, main
from runtime.hubs import find_hub, living_hubs
from runtime.messages import Message, Reply
from tests.e2e.conftest import PATIENCE_S, Command, Watch, elbow

pytestmark = pytest.mark.e2e

NAMES = ("castor", "pollux")
STILL_RAD = np.radians(3.0)


class Fleet:
    def __init__(self, up: Command, buses: dict[str, Bus], watches: dict[str, Watch]) -> None:
        self.up = up
        self.watches = watches
        self._buses = buses

    def ask(self, robot: str, request: Message) -> list[Reply]:
        return self._buses[robot].request(request)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    folder = tmp_path_factory.mktemp("fleet")
    files = [elbow(folder, name).file for name in NAMES]
    up = Command("up", *files)
    try:
        for process in ("viz", "web"):
            up.wait_line(f"{process} ready", count=2)
        with ExitStack() as stack:
            buses, watches = {}, {}
            for name in NAMES:
                endpoint = find_hub(name).endpoint
                buses[name] = stack.enter_context(Bus(name, "test", endpoint=endpoint))
                watches[name] = stack.enter_context(Watch(buses[name]))
            for watch in watches.values():  # who comes late is linked with one after the other
                for kind in (m.WorldTruth, m.ChainState, m.GroupState, m.ExecutiveState):
                    watch.wait_for(kind, since=0)
            yield Fleet(up, buses, watches)
    finally:
        up.end()


def angle_rad(watch: Watch) -> float:
    return watch.last(m.WorldTruth).angle_rad[0]


def hold(watch: Watch) -> None:
    watch.wait_for(m.ExecutiveState, lambda x: x.stage == "hold" and x.settled, since=watch.mark())


def by(process: str) -> Callable[[m.Health], bool]:
    return lambda health: health.process == process


def test_a_command_to_one_moves_no_other(fleet: Fleet) -> None:
    castor, pollux = (fleet.watches[name] for name in NAMES)
    hold(castor)
    hold(pollux)
    still_rad = angle_rad(pollux)
    before = castor.mark(), pollux.mark()
    goal_rad = float(np.radians(50.0))
    replies = fleet.ask("castor", m.Reach(angle_rad={"elbow": goal_rad}))
    assert len(replies) == 1, "one robot answers"
    assert replies[0].ok, replies[0].text
    castor.wait_for(
        m.ExecutiveState,
        lambda x: x.settled and abs(x.reference_rad[0] - goal_rad) < 1e-3,
        since=before[0],
    )
    assert abs(angle_rad(castor) - goal_rad) < STILL_RAD
    angles = [x.angle_rad[0] for x in pollux.of(m.WorldTruth, before[1])]
    assert angles
    assert np.ptp(angles) < STILL_RAD
    assert angles[-1] == pytest.approx(still_rad, abs=STILL_RAD)
    assert "move" not in {x.stage for x in pollux.of(m.ExecutiveState, before[1])}


def test_neither_hears_the_other(fleet: Fleet) -> None:
    """All that comes on one robot's keys is from that robot's processes, and from one world."""
    pids = {}
    for name, watch in fleet.watches.items():
        table = watch.last(m.GroupState).processes
        pids[name] = {row.process: row.pid for row in table}
        for process in pids[name]:  # the retrainer is nice, and comes late
            watch.wait_for(m.Health, by(process), since=0)
        told = {(x.process, x.pid) for x in watch.of(m.Health) if x.process != "supervisor"}
        assert told == set(pids[name].items())
        stamps = [x.stamp_ns for x in watch.of(m.WorldTruth)]
        assert stamps == sorted(set(stamps)), "two worlds tell the truth"
    assert not set(pids["castor"].values()) & set(pids["pollux"].values())
    with (
        Bus("castor", "stranger", endpoint=find_hub("pollux").endpoint) as bus,
        Watch(bus) as watch,
    ):
        watch.wait_for(m.WorldTruth, since=0, what="castor over pollux's hub: they share a network")


def state_of(address: str) -> Any:
    """What a script is told at a page's address."""
    with urllib.request.urlopen(f"{address}/api/state", timeout=PATIENCE_S) as answer:
        return json.load(answer)


def known_to(address: str) -> dict[str, str]:
    """The robots that a page knows, and where theirs are."""
    robots = state_of(address)["robots"]["robots"]
    return {row["name"]: row["address"] for row in robots}


def test_each_has_a_page_that_knows_the_other(fleet: Fleet) -> None:
    lines = [line.split() for line in fleet.up.lines if "web ready" in line]
    pages = {line[0].rstrip(":"): line[-1] for line in lines}
    assert set(pages) == set(NAMES)
    assert len(set(pages.values())) == 2
    for name, address in pages.items():
        assert state_of(address)["robot"]["name"] == name
        deadline_s = time.monotonic() + PATIENCE_S
        while known_to(address) != pages:  # it looks for others every other second
            assert time.monotonic() < deadline_s, known_to(address)
            time.sleep(0.1)


def test_both_sweep_at_once(fleet: Fleet) -> None:
    since = {name: watch.mark() for name, watch in fleet.watches.items()}
    for name in NAMES:
        (reply,) = fleet.ask(name, m.Task(name="sweep"))
        assert reply.ok, reply.text
    for name, watch in fleet.watches.items():
        watch.wait_for(
            m.ExecutiveState,
            lambda x: x.task == "sweep" and x.step >= 2,
            since=since[name],
            what=f"the second step of {name}'s sweep",
        )


def test_one_word_stops_both(fleet: Fleet, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["estop"]) == USAGE
    told = capsys.readouterr().err
    for command in ("estop --all", "estop castor", "estop pollux"):
        assert f"myograft {command}" in told
    assert all(watch.last(m.ChainState).mode == "follow" for watch in fleet.watches.values())
    assert main(["estop", "--all"]) == DONE
    told = capsys.readouterr().out
    for name, watch in fleet.watches.items():
        assert f"{name}: stopped: all wires are slack" in told
        watch.wait_for(m.ExecutiveState, lambda x: x.stage == "stopped", since=0)
        assert all(reply.ok for reply in fleet.ask(name, m.Reset()))
        hold(watch)


def test_ctrl_c_parks_both_and_exits_0(fleet: Fleet) -> None:
    since = {name: watch.mark() for name, watch in fleet.watches.items()}
    assert fleet.up.end() == 0
    for name, watch in fleet.watches.items():
        stages = {x.stage for x in watch.of(m.ExecutiveState, since[name])}
        assert "park" in stages, f"{name} was not parked, but went through {stages}"
        rest_rad = np.radians(0.0)
        assert angle_rad(watch) == pytest.approx(rest_rad, abs=STILL_RAD)
        assert f"{name}: parked\n" in fleet.up.lines
        assert f"{name}: stopped\n" in fleet.up.lines
    assert living_hubs() == []
