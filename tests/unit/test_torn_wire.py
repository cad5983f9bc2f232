"""A wire tears, its module stays on the chain: the arm goes on without, and is at rest."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.rig import Rig
from runtime import messages as m
from runtime.messages import Message
from runtime.settings import load_robot

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]
TORN = "biceps_1"


@pytest.fixture(scope="module")
def torn() -> Rig:
    rig = Rig(load_robot("elbow"))
    rig.run(2.0)
    assert rig.ask(m.Fault(kind="rupture", target=TORN)).ok
    rig.run_until(lambda: any(e.kind == "shrink_done" for e in rig.events), 60.0, "going on")
    return rig


def length_m(rig: Rig, muscle: str) -> float:
    state = rig.last[m.ChainState]
    assert isinstance(state, m.ChainState)
    return state.length_m[state.muscles.index(muscle)]


def test_the_event_says_why(torn: Rig) -> None:
    (event,) = (event for event in torn.events if event.kind == "shrink_started")
    assert event.level == "warning"
    assert f"'{TORN}': its wire carries nothing, as a torn one" in event.text


@pytest.mark.parametrize("degrees", [15.0, 30.0, 0.0])
def test_the_arm_stands_still(torn: Rig, degrees: float) -> None:
    """What the torn wire's muscle does to the joints is nothing: no torque is read into it."""
    assert torn.ask(m.Reach(angle_rad={"elbow": float(np.radians(degrees))})).ok
    torn.run(6.0)
    angles_rad: list[float] = []

    def watch(message: Message) -> None:
        if isinstance(message, m.JointState):
            angles_rad.append(message.angle_rad[0])

    torn.watchers.append(watch)
    torn.run(1.5)
    torn.watchers.remove(watch)
    swing_deg = np.degrees(np.ptp(angles_rad))
    assert swing_deg < 1.0
    assert abs(np.degrees(np.mean(angles_rad)) - degrees) < 3.0


def test_the_torn_wire_is_not_wound_in_for_ever(torn: Rig) -> None:
    before_m = length_m(torn, TORN)
    torn.run(3.0)
    assert length_m(torn, TORN) == pytest.approx(before_m, abs=1e-3)
