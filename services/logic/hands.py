"""What the robot's hands hold, and how much of its weight the arms count with.

A hand closes, and once it says that it holds something the weight is taken over little by little:
what stands on a table is still carried by the table. Before a hand opens the weight is given up,
so that nothing jumps.
"""

from __future__ import annotations

from collections.abc import Iterator

from runtime.messages import HandCommand, HandState
from runtime.settings import Payload
from services.logic.skeleton import Skeleton

TAKE_OVER_S = 1.0


class Hands:
    """The payloads of one robot.

    Attributes:
        holding: name of the payload that is held or being taken or given up; "" for none.
        missed: the hand closed on nothing, and opens again.
    """

    def __init__(self, payloads: tuple[Payload, ...], skeleton: Skeleton, holding: str) -> None:
        """`holding` is what a former executive held: its weight counts at once."""
        self._payloads = {payload.name: payload for payload in payloads}
        self._skeleton = skeleton
        self.holding = holding if holding in self._payloads else ""
        self.missed = False
        self._felt = bool(self.holding)  # the hand says that it holds it
        self._share = self._wanted = 1.0 if self.holding else 0.0  # of the weight that is counted
        self._told: dict[str, str] = {}  # hand -> what it was last told to hold
        self._count()

    @property
    def busy(self) -> bool:
        """Whether something is being taken or put down."""
        return self._share != self._wanted

    def grasp(self, name: str) -> None:
        """Take hold of a payload of the robot file."""
        self.holding, self._wanted = name, 1.0
        self._felt = self.missed = False

    def release(self) -> None:
        """Give up the weight, then open the hand."""
        self._wanted = 0.0

    def receive(self, state: HandState) -> None:
        """Hear what a hand holds."""
        payload = self._payloads.get(self.holding)
        if payload is None or state.hand != payload.link or state.asked != self.holding:
            return
        self._felt = state.holds == self.holding
        if not self._felt:
            self.missed, self._wanted = True, 0.0

    def tick(self, now_ns: int, dt_s: float) -> Iterator[HandCommand]:
        """Let time pass; tells the hands when to close and to open."""
        if not self._payloads:
            return
        step = dt_s / TAKE_OVER_S
        change = min(max(self._wanted - self._share, -step), step)
        if change and (self._felt or change < 0.0):
            self._share += change
            self._count()
        if self.holding and not self._share and not self._wanted:
            self.holding, self._felt = "", False
        held = self._payloads.get(self.holding)
        for hand in dict.fromkeys(payload.link for payload in self._payloads.values()):
            name = held.name if held is not None and held.link == hand else ""
            if self._told.get(hand) != name:
                self._told[hand] = name
                yield HandCommand(stamp_ns=now_ns, hand=hand, holds=name)

    def _count(self) -> None:
        payload = self._payloads.get(self.holding)
        if payload is not None:
            self._skeleton.carry(payload.link, payload.position_m, self._share * payload.mass_kg)
