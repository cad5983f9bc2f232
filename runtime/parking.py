"""Whether an arm that was asked to park may be left alone. Wall time comes in as an argument."""

from __future__ import annotations

from runtime.messages import ExecutiveState

SETTLE_S = 1.0  # a park that is over before it was ever seen under way counts after this

AT_REST = ("hold", "stopped", "waiting")


class Parking:
    """Follows the executive's state from the moment `Task("park")` was asked for."""

    def __init__(self, asked_at_s: float, patience_s: float) -> None:
        self._asked_at_s = asked_at_s
        self._deadline_s = asked_at_s + patience_s
        self._under_way = False
        self._parked = False

    def see(self, state: ExecutiveState, wall_s: float) -> None:
        """Take in what the executive says of itself."""
        if state.stage not in AT_REST:
            self._under_way = True
        elif self._under_way or wall_s > self._asked_at_s + SETTLE_S:
            self._parked = True

    def give_up(self) -> None:
        """It was refused: there is nothing to wait for."""
        self._parked = True

    @property
    def parked(self) -> bool:
        """The arm is at rest."""
        return self._parked

    def over(self, wall_s: float) -> bool:
        """Parked, or waited long enough."""
        return self._parked or wall_s > self._deadline_s
