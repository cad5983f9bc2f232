"""What is played back, and when."""

from __future__ import annotations

import math
import threading

import pytest

from runtime import messages as m
from runtime.journal import Entry
from runtime.messages import Message
from runtime.player import ORDERS, Played, Player, kinds_played, spread
from runtime.topics import TOPICS

MS = 1_000_000


def entry(at_ms: float, message: Message) -> Entry:
    return Entry(round(at_ms * MS), "elbow/x", message)


def play(entries: list[Entry], speed: float = math.inf) -> tuple[list[Message], Played]:
    said: list[Message] = []
    played = Player(said.append, speed, threading.Event()).play(entries, lambda _: None)
    return said, played


class Pace(threading.Event):
    """Remembers for how long it was to wait."""

    def __init__(self) -> None:
        super().__init__()
        self.asked_s: list[float] = []

    def wait(self, timeout: float | None = None) -> bool:
        assert timeout is not None
        self.asked_s.append(timeout)
        return super().wait(timeout)


def truth(stamp_ms: float) -> m.WorldTruth:
    empty: tuple[float, ...] = ()
    return m.WorldTruth(
        stamp_ns=round(stamp_ms * MS),
        joints=(),
        angle_rad=empty,
        muscles=(),
        tension_n=empty,
        length_m=empty,
        peak_tension_n=empty,
        peak_speed_m_s=empty,
        peak_target_speed_m_s=empty,
    )


def test_orders_are_played_only_by_name() -> None:
    usual = kinds_played()
    assert set(usual) == {row.message for row in TOPICS} - set(ORDERS)
    assert kinds_played(["ChainCommand", "joint/estimate"]) == (m.ChainCommand, m.JointEstimate)
    with pytest.raises(ValueError, match="topic list"):
        kinds_played(["ChainCommando"])


def test_what_was_written_together_is_spread() -> None:
    entries = [entry(1000, truth(n)) for n in range(4)] + [entry(1020, truth(n)) for n in range(2)]
    times_ms = [at_ns / MS for at_ns, _ in spread(entries)]
    assert times_ms == [985, 990, 995, 1000, 1010, 1020]


def test_it_keeps_the_pace_and_tells_it_by_the_clock() -> None:
    clock = m.Clock(stamp_ns=5, speed=2.0, real_time_factor=1.5, incarnation=3)
    said: list[Message] = []
    pace = Pace()
    entries = [entry(500, clock), entry(600, truth(1)), entry(700, truth(2))]
    played = Player(said.append, 4.0, pace).play(entries, lambda _: None)
    assert said[0] == m.Clock(stamp_ns=5, speed=8.0, real_time_factor=6.0, incarnation=3)
    assert played.messages == 3
    assert played.at_s == pytest.approx(0.2)
    assert played.wall_s > 0.04
    assert sum(pace.asked_s) <= 0.2 / 4.0, "however long it was kept waiting besides"


def test_a_robot_without_a_world_gets_a_clock_by_its_stamps() -> None:
    said, _ = play([entry(n * 5, truth(n * 5)) for n in range(1, 101)])
    clocks = [x.stamp_ns / MS for x in said if isinstance(x, m.Clock)]
    assert clocks == [10.0 * n for n in range(1, 51)]


def test_it_ends_when_told_to() -> None:
    stop = threading.Event()
    said: list[Message] = []

    def publish(message: Message) -> None:
        said.append(message)
        stop.set()

    played = Player(publish, 1.0, stop).play(
        [
            entry(500, m.Event(process="p", level="info", kind="k", text="")),
            entry(60_000, truth(1)),
        ],
        lambda _: None,
    )
    assert len(said) == played.messages == 1
    assert played.wall_s < 30.0


def test_an_address_that_is_no_more_is_not_told() -> None:
    said, _ = play([entry(0, m.Event(process="viz", level="info", kind="viewer", text="here"))])
    assert said == []
