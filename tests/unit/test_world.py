"""The world under wall time, which comes in as an argument: pace, gate, line time, comeback."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import pytest

from hardware_sim.world import (
    CLOCK_NS,
    COMEBACK_NS,
    LEAD_NS,
    PATIENCE_S,
    SAVE_NS,
    SNAPSHOT,
    TRUTH_NS,
    World,
)
from runtime import messages as m
from runtime.logic import MemoryStore
from runtime.messages import Message
from runtime.process import Launch
from runtime.settings import RobotSettings, load_robot
from runtime.wire import packet as wire
from runtime.wire.packet import InstructionPacket
from runtime.wire.registers import BY_NAME
from tests.unit.two_joint_body import two_joints

MS = 1_000_000
Kind = TypeVar("Kind", bound=Message)


class History(MemoryStore):
    """Remembers every blob that was saved."""

    def __init__(self) -> None:
        super().__init__()
        self.saved: list[dict[str, Any]] = []

    def save(self, name: str, data: bytes) -> None:
        super().save(name, data)
        self.saved.append(msgspec.msgpack.decode(data))

    @property
    def saved_ms(self) -> list[int]:
        return [state["robot"]["now_ns"] // MS for state in self.saved]


@dataclass(frozen=True)
class InMemory(Launch):
    """A launch whose store is a dict."""

    memory: History = field(default_factory=History)

    @property
    def store(self) -> History:
        return self.memory


class Live:
    """A world, the wall clock it is shown, and what it published."""

    def __init__(self, launch: InMemory) -> None:
        self.memory = launch.memory
        self.world = World(launch)
        self.wall_s = 100.0
        self.world.start(self.wall_s)
        self.out: list[Message] = []

    @property
    def now_ms(self) -> int:
        return self.world.robot.now_ns // MS

    def run(self, wall_s: float) -> None:
        """Wall time passes by half milliseconds."""
        for _ in range(round(wall_s * 2000)):
            self.wall_s += 0.0005
            self.look()

    def look(self) -> None:
        self.out += self.world.advance(self.wall_s)

    def say(
        self, chain: str, packet: InstructionPacket, sequence: int = 1, late_ns: int = 0
    ) -> None:
        data = wire.encode(packet)
        now_ns = self.world.robot.now_ns - late_ns
        self.world.receive(m.BusRequest(stamp_ns=now_ns, chain=chain, sequence=sequence, data=data))

    def master(self, chain: str, alive: bool = True) -> None:
        self.world.receive(m.Presence(process=f"driver-{chain}", alive=alive))

    def told(self, kind: type[Kind]) -> list[Kind]:
        return [message for message in self.out if isinstance(message, kind)]


@pytest.fixture
def settings(tmp_path: Path) -> RobotSettings:
    return two_joints(tmp_path)


def launch(settings: RobotSettings, speed: float = 1.0, memory: History | None = None) -> InMemory:
    return InMemory(
        process="world",
        settings=settings,
        run_dir=Path(),
        state_dir=Path(),
        endpoint="",
        speed=speed,
        memory=History() if memory is None else memory,
    )


@pytest.fixture
def live(settings: RobotSettings) -> Iterator[Live]:
    live = Live(launch(settings))
    yield live
    live.world.close()


# ── pace ──────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(("speed", "robot_ms"), [(0.5, 100), (1.0, 200), (4.0, 800)])
def test_robot_time_is_wall_time_times_speed(
    settings: RobotSettings, speed: float, robot_ms: int
) -> None:
    live = Live(launch(settings, speed))
    live.run(0.2)
    assert live.now_ms == pytest.approx(robot_ms, abs=max(speed, 1.0))
    live.world.close()


def test_it_sleeps_until_the_next_step_is_due(live: Live) -> None:
    live.run(0.01)
    assert 0.0 <= live.world.idle_s(live.wall_s) <= 0.001
    assert live.world.idle_s(live.wall_s + 5.0) == 0.0


def test_a_wall_clock_that_jumps_is_not_run_after(live: Live) -> None:
    live.run(0.05)
    before = live.now_ms
    live.wall_s += 30.0
    live.look()
    live.run(0.05)
    assert live.now_ms - before == pytest.approx(50, abs=12)


def test_clock_and_truth_come_at_their_rates(live: Live) -> None:
    live.run(0.5)
    clocks, truths = live.told(m.Clock), live.told(m.WorldTruth)
    assert len(clocks) == pytest.approx(0.5e9 / CLOCK_NS, abs=2)
    assert len(truths) == pytest.approx(0.5e9 / TRUTH_NS, abs=2)
    stamps = [clock.stamp_ns for clock in clocks]
    assert stamps == sorted(stamps)
    assert {(clock.speed, clock.incarnation) for clock in clocks} == {(1.0, 1)}


def test_the_clock_tells_the_real_time_factor_that_is_reached(settings: RobotSettings) -> None:
    live = Live(launch(settings, speed=2.0))
    assert live.world.idle_s(live.wall_s) == pytest.approx(0.0005, abs=1e-6)
    live.run(1.1)
    assert live.told(m.Clock)[-1].real_time_factor == pytest.approx(2.0, rel=0.02)
    for _ in range(250):  # too slow: 5 ms of robot time a look, where 20 are due
        live.wall_s += 0.010
        live.look()
    assert live.told(m.Clock)[-1].real_time_factor == pytest.approx(0.5, rel=0.1)
    live.world.close()


# ── gate ──────────────────────────────────────────────────────────────────────────────────────


def test_without_a_living_master_nobody_is_waited_for(live: Live) -> None:
    live.say("near", wire.ping(2))
    live.run(0.1)
    assert live.now_ms == pytest.approx(100, abs=1)


def test_a_living_master_is_waited_for_after_ten_milliseconds(live: Live) -> None:
    live.master("near")
    live.run(0.06)
    assert live.world.robot.now_ns == LEAD_NS
    assert live.world.idle_s(live.wall_s) == 0.002
    live.say("far", wire.ping(2))  # another line's bytes are no sign of life
    live.run(0.02)
    assert live.world.robot.now_ns == LEAD_NS
    live.say("near", wire.ping(2))
    live.run(0.03)
    assert live.world.robot.now_ns == 2 * LEAD_NS


def test_a_packet_counts_from_when_it_was_sent(live: Live) -> None:
    live.master("near")
    live.run(0.010)
    live.say("near", wire.ping(2), late_ns=6 * MS)
    live.run(0.05)
    assert live.now_ms == -6 + 10 + 10


def test_patience_with_a_silent_master_ends(live: Live) -> None:
    live.master("near")
    live.run(0.010 + PATIENCE_S - 0.005)
    assert live.now_ms == 10
    live.run(0.02)
    assert live.now_ms == 20
    live.run(10 * PATIENCE_S)
    assert 100 <= live.now_ms <= 120


def test_a_master_that_died_is_not_waited_for(live: Live) -> None:
    live.master("near")
    live.run(0.03)
    live.master("near", alive=False)
    live.run(0.05)
    assert live.now_ms == pytest.approx(10 + 50 + 20, abs=3)  # it was behind its pace, too
    live.world.receive(m.Presence(process="viz", alive=True))
    live.run(0.05)
    assert live.now_ms == pytest.approx(130, abs=3)


def test_a_master_that_speaks_keeps_the_pace(live: Live) -> None:
    live.master("near")
    for sequence in range(20):
        live.say("near", wire.ping(2), sequence)
        live.run(0.005)
    assert live.now_ms == pytest.approx(100, abs=1)


# ── line ──────────────────────────────────────────────────────────────────────────────────────


def test_a_reply_comes_when_the_line_has_carried_it(live: Live) -> None:
    live.say("near", wire.ping(2), sequence=5)
    live.look()
    assert [reply.sequence for reply in live.told(m.BusReply)] == [5]
    live.world.answer(m.Fault(kind="delay", target="near", amount=0.02))
    live.say("near", wire.ping(2), sequence=6)
    live.run(0.018)
    assert [reply.sequence for reply in live.told(m.BusReply)] == [5]
    live.run(0.005)
    assert [reply.sequence for reply in live.told(m.BusReply)] == [5, 6]


def test_a_slow_line_does_not_hold_up_another_nor_itself_out_of_order(live: Live) -> None:
    live.world.answer(m.Fault(kind="delay", target="near", amount=0.05))
    live.world.answer(m.Fault(kind="delay", target="far", amount=0.005))
    live.say("near", wire.ping(2), sequence=1)
    live.say("far", wire.ping(2), sequence=2)
    live.run(0.01)
    assert [reply.sequence for reply in live.told(m.BusReply)] == [2]
    live.world.answer(m.Fault(kind="delay", target="near", amount=0.0))
    live.say("near", wire.ping(3), sequence=3)
    live.run(0.06)
    assert [reply.sequence for reply in live.told(m.BusReply)] == [2, 1, 3]


def test_bytes_for_a_chain_that_is_not_there_are_ignored(live: Live) -> None:
    live.say("tail", wire.ping(2))
    live.run(0.01)
    assert live.told(m.BusReply) == []


# ── hands ─────────────────────────────────────────────────────────────────────────────────────


def test_hands_are_answered_in_words_and_heard_as_events(live: Live) -> None:
    reply = live.world.answer(m.Plug(muscle="spare"))
    assert reply.ok and reply.data["chain"] == "far"
    again = live.world.answer(m.Plug(muscle="spare"))
    assert not again.ok and again.text == "muscle 'spare' is plugged in already"
    assert live.world.answer(m.Fault(kind="drop", target="far", amount=0.5)).ok
    assert live.world.answer(m.Unplug(muscle="spare")).ok
    odd = live.world.answer(m.Reset())
    assert not odd.ok and odd.text == "the world does not know Reset"
    live.look()
    assert [event.kind for event in live.told(m.Event)] == ["plugged", "fault", "unplugged"]


def test_what_is_broken_is_listed(live: Live) -> None:
    assert live.world.answer(m.Fault(action="list")).text == "nothing is broken"
    live.world.answer(m.Fault(kind="drop", target="far", amount=0.5))
    listed = live.world.answer(m.Fault(action="list"))
    assert listed.ok and listed.data == {"drop far": "0.5 of the packets"}


# ── comeback ──────────────────────────────────────────────────────────────────────────────────


def test_state_is_saved_each_second_at_every_plug_and_after_writes(settings: RobotSettings) -> None:
    live = Live(launch(settings, speed=10.0))
    live.run(0.105)
    live.world.answer(m.Plug(muscle="spare"))
    plugged_ms = live.now_ms
    live.run(0.05)
    live.say("near", wire.write(2, BY_NAME["led"].address, b"\1"))
    written_ms = live.now_ms
    live.say("near", wire.ping(2))
    live.run(0.05)
    live.world.close()
    first, at_plug, after_write, last = live.memory.saved_ms
    assert first == pytest.approx(SAVE_NS // MS, abs=10)
    assert at_plug == plugged_ms
    assert written_ms < after_write <= written_ms + 20
    assert last == live.now_ms


def test_killed_it_comes_back_with_the_arm_where_it_was_under_a_later_time(
    settings: RobotSettings,
) -> None:
    live = Live(launch(settings, speed=10.0))
    live.run(0.02)
    live.world.answer(m.Plug(muscle="spare"))
    live.run(0.1)
    live.world.close()
    saved = live.world.robot.truth()

    back = Live(launch(settings, memory=live.memory))
    truth = back.world.robot.truth()
    assert truth.muscles == ("flexor", "extensor", "long", "spare")
    assert truth.angle_rad == saved.angle_rad
    assert truth.length_m == saved.length_m
    assert truth.peak_tension_n == saved.peak_tension_n
    assert truth.stamp_ns == saved.stamp_ns + COMEBACK_NS
    # what was told before it was killed may be younger than what it saved, by a save at most
    assert COMEBACK_NS > SAVE_NS
    back.run(0.05)
    clock = back.told(m.Clock)[0]
    assert clock.incarnation == 2
    assert clock.stamp_ns > live.told(m.Clock)[-1].stamp_ns
    back.world.close()
    third = Live(launch(settings, memory=live.memory))
    third.run(0.02)
    assert third.told(m.Clock)[0].incarnation == 3
    third.world.close()


class FullDisk(History):
    def save(self, name: str, data: bytes) -> None:
        raise OSError("no space left")


def test_a_state_that_cannot_be_saved_is_told_and_the_robot_goes_on(
    settings: RobotSettings, caplog: pytest.LogCaptureFixture
) -> None:
    live = Live(launch(settings, memory=FullDisk()))
    assert live.world.answer(m.Plug(muscle="spare")).ok
    live.run(0.02)
    live.world.close()
    assert "state was not saved: no space left" in caplog.text


def torn(data: bytes) -> bytes:
    return data[: len(data) // 2]


def without_body(data: bytes) -> bytes:
    state = msgspec.msgpack.decode(data)
    del state["robot"]["plant"]
    return msgspec.msgpack.encode(state)


def odd_modules(data: bytes) -> bytes:
    state = msgspec.msgpack.decode(data)
    state["robot"]["modules"] = ["flexor"]
    return msgspec.msgpack.encode(state)


@pytest.mark.parametrize(
    "damage",
    [
        torn,
        without_body,
        odd_modules,
        lambda data: b"",
        lambda data: msgspec.msgpack.encode([1, 2]),
        lambda data: msgspec.msgpack.encode({"incarnation": "x", "robot": {}}),
    ],
)
def test_a_damaged_snapshot_is_left_aside_and_the_robot_starts_afresh(
    settings: RobotSettings, damage: Any, caplog: pytest.LogCaptureFixture
) -> None:
    live = Live(launch(settings))
    live.world.answer(m.Plug(muscle="spare"))
    live.run(0.05)
    live.world.close()
    live.memory[SNAPSHOT] = damage(live.memory[SNAPSHOT])
    with caplog.at_level(logging.WARNING):
        back = Live(launch(settings, memory=live.memory))
    assert "does not fit this robot and is left aside" in caplog.text
    assert back.world.robot.plant.wires == ["flexor", "extensor", "long"]
    back.run(0.05)
    assert back.told(m.Clock)
    back.world.close()


def test_another_robots_snapshot_is_left_aside_but_time_does_not_run_backwards(
    settings: RobotSettings, caplog: pytest.LogCaptureFixture
) -> None:
    live = Live(launch(load_robot("elbow")))
    live.run(0.05)
    live.world.close()
    back = Live(launch(settings, memory=live.memory))
    assert "is left aside" in caplog.text
    assert back.world.robot.plant.wires == ["flexor", "extensor", "long"]
    back.run(0.05)
    clock, before = back.told(m.Clock)[0], live.told(m.Clock)[-1]
    assert clock.stamp_ns > before.stamp_ns
    assert clock.incarnation > before.incarnation
    back.world.close()


def test_time_never_runs_backwards_whatever_happens(settings: RobotSettings) -> None:
    memory, stamps = History(), []
    for _ in range(3):
        live = Live(launch(settings, memory=memory, speed=5.0))
        live.master("near")
        live.run(0.02)
        live.world.answer(m.Plug(muscle="spare"))
        live.master("near", alive=False)
        live.wall_s += 1.0
        live.run(0.03)
        live.wall_s -= 0.5
        live.run(0.01)
        stamps += [message.stamp_ns for message in live.told(m.Clock)]
        live.world.close()
    assert len(stamps) > 10
    assert all(a < b for a, b in pairwise(stamps))
