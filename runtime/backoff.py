"""When a process that died is started again. Wall time comes in as an argument."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum


class Restart(Enum):
    """Which deaths call for a restart."""

    NEVER = "never"
    ON_FAILURE = "on-failure"
    ALWAYS = "always"


@dataclass(frozen=True, slots=True)
class BackoffPolicy:
    """How long to wait, and how often to try before giving up."""

    first_s: float = 0.05
    longest_s: float = 5.0
    budget: int = 10  # restarts within the window
    window_s: float = 60.0


class Backoff:
    """Doubles the wait with each death in the window; a process that lives on starts afresh."""

    def __init__(self, restart: Restart, policy: BackoffPolicy | None = None) -> None:
        self._restart = restart
        self._policy = policy or BackoffPolicy()
        self._deaths_s: deque[float] = deque()

    def died(self, exit_code: int, wall_s: float) -> float | None:
        """Seconds until the restart; None: it stays dead, by policy or because the budget is out.

        Args:
            exit_code: as `subprocess` gives it: negative for a signal.
        """
        if self._restart is Restart.NEVER:
            return None
        if self._restart is Restart.ON_FAILURE and exit_code == 0:
            return None
        while self._deaths_s and self._deaths_s[0] < wall_s - self._policy.window_s:
            self._deaths_s.popleft()
        self._deaths_s.append(wall_s)
        if len(self._deaths_s) > self._policy.budget:
            return None
        doublings = len(self._deaths_s) - 1
        return min(self._policy.first_s * 2.0**doublings, self._policy.longest_s)
