"""Joint angles as curves: wanted, measured, and estimated from the wires, with its confidence.

In radians, as everything else in the house: the canvas makes degrees of them for the eye.
"""

from __future__ import annotations

from dashboard.canvas import Angles, Canvas
from dashboard.tracks import Rows, Slots
from runtime import messages as m

EVERY_NS = 20_000_000
STALE_NS = 500_000_000  # who was silent for this long reads NaN
_REFERENCE, _MEASURED, _ESTIMATED, _SIGMA = range(4)


class JointAngles:
    """Takes the newest of every source and draws all joints as one."""

    inputs = (m.JointState, m.ExecutiveState, m.JointEstimate)

    def __init__(self, joints: tuple[str, ...], canvas: Canvas) -> None:
        self._canvas = canvas
        self._rows = Rows(Slots(len(joints), joints), EVERY_NS, layers=4)
        self._measured: dict[str, m.JointState] = {}
        self._wanted: m.ExecutiveState | None = None
        self._estimate: m.JointEstimate | None = None

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in one message of `inputs`."""
        match message:
            case m.JointState():
                self._measured[message.source] = message
                if self._rows.due(message.stamp_ns):
                    self._sample(message.stamp_ns)
            case m.ExecutiveState():
                self._wanted = message
            case m.JointEstimate():
                self._estimate = message

    def _sample(self, stamp_ns: int) -> None:
        self._rows.begin(stamp_ns)
        for state in self._measured.values():
            if stamp_ns - state.stamp_ns < STALE_NS:
                self._rows.put(state.joints, state.angle_rad, _MEASURED)
        if self._wanted:
            self._rows.put(self._wanted.joints, self._wanted.reference_rad, _REFERENCE)
        estimate = self._estimate
        if estimate and abs(stamp_ns - estimate.stamp_ns) < STALE_NS:
            self._rows.put(estimate.joints, estimate.angle_rad, _ESTIMATED)
            self._rows.put(estimate.joints, estimate.confidence_rad, _SIGMA)

    def draw(self, now_ns: int) -> None:
        """Draw the rows that wait."""
        self._rows.gap(now_ns, STALE_NS)
        if self._rows.waiting:
            times_s, rad = self._rows.take()
            self._canvas.angles(times_s, Angles(*rad))
