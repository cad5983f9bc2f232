"""Who does not hear whom, told by who says whom he hears.

Peers look for each other when one comes to their hub, and never again: a link between two that is
lost while both keep theirs to the hub, as on a machine where one gets no processor for longer than
a lease, stays lost. Neither can tell that from the other's death; the hub, which hears both, can.
"""

from __future__ import annotations

from collections.abc import Set

from runtime.messages import Health


class Hearing:
    """Compares each process's own report with what the hub hears."""

    def __init__(self) -> None:
        self._missed: dict[str, frozenset[str]] = {}  # process -> whom it missed in its last report
        self._told: set[tuple[str, str]] = set()

    def lost(self, health: Health, there: Set[str]) -> tuple[list[str], list[str]]:
        """Take one report in.

        Args:
            health: what one process says.
            there: the processes that the hub hears.

        Returns:
            Whom it has not heard in two reports on end, sorted; one may have come only just now.
            And those among them that no report has given before.
        """
        missed = frozenset(there - {*health.hears, health.process})
        lost = missed & self._missed.get(health.process, frozenset())
        self._missed[health.process] = missed
        pairs = {(health.process, other) for other in lost}
        news = pairs - self._told
        self._told = {pair for pair in self._told if pair[0] != health.process} | pairs
        return sorted(lost), sorted(other for _, other in news)
