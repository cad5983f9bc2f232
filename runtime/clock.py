"""Robot time: scaled in simulation, the host's monotonic clock on a robot, free in a rig.

None of these objects reads a clock: wall time comes in as an argument (`time.monotonic_ns`). All
times are integer nanoseconds.
"""

from __future__ import annotations

from typing import Protocol

from runtime.messages import Clock

AHEAD_NS = 50_000_000  # at most this much robot time is invented between two words of the world
SLOWEST = 0.5  # robot seconds per wall second, unless fewer are asked for
STALLED_S = 0.005  # how long to wait before looking again at a clock that stands


class Time(Protocol):
    """Tells robot time, given wall time."""

    def now(self, wall_ns: int) -> int | None:
        """Robot time, or None while nobody has told it."""

    def wall_s_until(self, robot_ns: int, wall_ns: int) -> float:
        """About how many wall seconds until robot time reaches `robot_ns`; never negative."""


class RobotClock:
    """Follows the world's `Clock`, extrapolates between its words, never runs backwards."""

    def __init__(self) -> None:
        self._told_ns: int | None = None
        self._told_at_ns = 0  # wall
        self._rate = 1.0  # robot seconds per wall second
        self._incarnation = -1
        self._latest_ns = 0

    def update(self, clock: Clock, wall_ns: int) -> None:
        """Take the world's word. One of an earlier incarnation, or older than the last, is void."""
        if clock.incarnation < self._incarnation:
            return
        same = clock.incarnation == self._incarnation
        if same and self._told_ns is not None and clock.stamp_ns < self._told_ns:
            return
        self._told_ns = clock.stamp_ns
        self._told_at_ns = wall_ns
        self._incarnation = clock.incarnation
        # A world that is too slow reaches less than it is asked for: do not run far ahead of it.
        # Nor keep to what it reached: it waits for its masters, whose clock this is, and the two
        # would never get faster again.
        self._rate = min(clock.speed, max(2 * clock.real_time_factor, SLOWEST))

    def now(self, wall_ns: int) -> int | None:
        """Robot time: at most `AHEAD_NS` past the world's last word, never backwards."""
        if self._told_ns is None:
            return None
        ahead = int((wall_ns - self._told_at_ns) * self._rate)
        told = self._told_ns + min(max(ahead, 0), AHEAD_NS)
        self._latest_ns = max(self._latest_ns, told)
        return self._latest_ns

    def wall_s_until(self, robot_ns: int, wall_ns: int) -> float:
        """Wall seconds until then; `STALLED_S` when the clock cannot get there by itself."""
        now = self.now(wall_ns)
        if now is None or self._told_ns is None:
            return STALLED_S
        if robot_ns <= now:
            return 0.0
        if robot_ns > self._told_ns + AHEAD_NS or self._rate <= 0:
            return STALLED_S
        return (robot_ns - now) / self._rate / 1e9


class HostClock:
    """Robot time where no world runs: the host's monotonic clock, one for all its processes."""

    def now(self, wall_ns: int) -> int:
        """Wall time itself."""
        return wall_ns

    def wall_s_until(self, robot_ns: int, wall_ns: int) -> float:
        """The difference."""
        return max(0, robot_ns - wall_ns) / 1e9


class VirtualClock:
    """Robot time that goes on only when told to: for rigs and tests."""

    def __init__(self, now_ns: int = 0) -> None:
        self.now_ns = now_ns

    def advance(self, by_ns: int) -> int:
        """Go on and return the new time."""
        if by_ns < 0:
            raise ValueError(f"time does not run backwards: {by_ns} ns")
        self.now_ns += by_ns
        return self.now_ns
