"""Robot time: it follows the world, never runs far ahead of it, never backwards."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.clock import AHEAD_NS, STALLED_S, HostClock, RobotClock, VirtualClock
from runtime.messages import Clock

MS = 1_000_000


def told(
    stamp_ms: float, *, speed: float = 1.0, factor: float = 1.0, incarnation: int = 1
) -> Clock:
    return Clock(
        stamp_ns=int(stamp_ms * MS), speed=speed, real_time_factor=factor, incarnation=incarnation
    )


def test_time_is_unknown_until_the_world_has_told_it() -> None:
    clock = RobotClock()
    assert clock.now(5) is None
    assert clock.wall_s_until(10, 5) == STALLED_S


def test_extrapolates_at_the_asked_speed_and_not_beyond_the_limit() -> None:
    clock = RobotClock()
    clock.update(told(1000, speed=4.0, factor=4.0), wall_ns=0)
    assert clock.now(2 * MS) == 1008 * MS
    assert clock.now(1000 * MS) == 1000 * MS + AHEAD_NS


def test_waits_as_long_as_robot_time_needs() -> None:
    clock = RobotClock()
    clock.update(told(1000, speed=2.0, factor=2.0), wall_ns=0)
    assert clock.wall_s_until(1010 * MS, wall_ns=0) == pytest.approx(0.005)
    assert clock.wall_s_until(900 * MS, wall_ns=0) == 0.0
    assert clock.wall_s_until(1060 * MS, wall_ns=0) == STALLED_S  # only the world can get there


def test_stands_rather_than_run_backwards() -> None:
    clock = RobotClock()
    clock.update(told(1000), wall_ns=0)
    assert clock.now(40 * MS) == 1040 * MS
    clock.update(told(1010), wall_ns=40 * MS)  # the world was slower than thought
    assert clock.now(41 * MS) == 1040 * MS
    assert clock.now(75 * MS) == 1045 * MS


def test_what_is_older_than_the_last_word_is_void() -> None:
    clock = RobotClock()
    clock.update(told(1000), wall_ns=0)
    clock.update(told(990), wall_ns=1)
    assert clock.now(1) == 1000 * MS + 1


def test_a_world_that_comes_back_goes_on_and_its_ghost_is_ignored() -> None:
    clock = RobotClock()
    clock.update(told(5000), wall_ns=0)
    assert clock.now(0) == 5000 * MS
    clock.update(told(4000, incarnation=2), wall_ns=0)  # from its last save
    assert clock.now(0) == 5000 * MS
    clock.update(told(9000, incarnation=1), wall_ns=0)
    assert clock.now(0) == 5000 * MS
    clock.update(told(5100, incarnation=2), wall_ns=0)
    assert clock.now(0) == 5100 * MS


def test_a_slow_world_is_not_slowed_further_by_those_it_waits_for() -> None:
    clock = RobotClock()
    clock.update(told(0, factor=0.05), wall_ns=0)
    assert clock.wall_s_until(5 * MS, wall_ns=0) == pytest.approx(0.01)


@given(
    st.lists(
        st.tuples(st.integers(0, 200), st.floats(-50, 200), st.floats(0.01, 20), st.integers(1, 3)),
        max_size=40,
    )
)
def test_never_backwards_whatever_the_world_says(
    words: list[tuple[int, float, float, int]],
) -> None:
    clock = RobotClock()
    wall_ns = 0
    last = 0
    stamp = 100.0
    for wall_ms, step_ms, speed, incarnation in words:
        wall_ns += wall_ms * MS
        stamp += step_ms
        clock.update(told(stamp, speed=speed, factor=speed, incarnation=incarnation), wall_ns)
        now = clock.now(wall_ns)
        assert now is not None
        assert now >= last
        last = now


def test_host_time_is_wall_time() -> None:
    assert HostClock().now(7) == 7
    assert HostClock().wall_s_until(1_000_000_007, 7) == 1.0


def test_virtual_time_goes_on_when_told() -> None:
    clock = VirtualClock()
    assert clock.advance(3) == 3
    with pytest.raises(ValueError, match="backwards"):
        clock.advance(-1)
