"""The arm as the executive commands it: nothing jumps, nothing outruns the motors."""

from __future__ import annotations

import numpy as np
import pytest

from runtime.messages import ChainCommand, JointState
from services.body_schema.growth import grow
from services.logic.arm import (
    FADE_S,
    LEASE_NS,
    STALE_NS,
    Arm,
    MotionRecorder,
)
from services.logic.guests import GUEST_BIAS_N, GUEST_RATE_N_S
from services.logic.wiring import Wiring
from tests.unit.arm_bench import DT_S, MS, SETTINGS, SKELETON, Bench, K, shipped

REACH_M = SETTINGS.module.target_speed_m_s * DT_S


def targets(command: ChainCommand) -> dict[str, float]:
    return dict(zip(command.muscles, command.target_length_m, strict=True))


# ── sensing ───────────────────────────────────────────────────────────────────────────────────


def test_what_is_missing_is_said_in_words() -> None:
    arm, bench = Arm(SETTINGS, SKELETON), Bench()
    state, body = bench.arm._states["arm"], bench.arm._bodies["arm"]
    assert arm.silent(bench.now_ns) == "waiting for a body schema"
    arm.use(shipped())
    assert arm.silent(bench.now_ns) == "chain 'arm' is silent"
    arm.receive(state)
    assert arm.silent(bench.now_ns) == "chain 'arm' has not said who is plugged in"
    arm.receive(body)
    assert arm.silent(bench.now_ns) == "joint 'elbow' is silent"
    arm.receive(JointState(stamp_ns=bench.now_ns, joints=("elbow",), angle_rad=(0.5,)))
    assert arm.silent(bench.now_ns) == ""
    assert arm.silent(bench.now_ns + STALE_NS) == ""
    assert arm.silent(bench.now_ns + STALE_NS + 1) == "chain 'arm' is silent"


@pytest.mark.parametrize(
    ("mode", "stopped"),
    [("follow", False), ("hold", False), ("stopping", True), ("stopped", True)],
)
def test_a_stop_on_any_chain_is_a_stop(mode: str, stopped: bool) -> None:
    assert Bench(mode=mode).arm.stopped is stopped


def test_modules_and_feelings_are_found_by_name() -> None:
    bench = Bench(tension_n={"biceps_2": 33.0})
    assert bench.arm.felt()["biceps_2"][1] == 33.0
    module = bench.arm.module("biceps_1")
    assert module is not None and module.serial == 51
    assert bench.arm.module("biceps_3") is None
    assert bench.arm.module("elbow") is None


# ── beginning ─────────────────────────────────────────────────────────────────────────────────


ODD = {"triceps": 30.0, "biceps_1": 4.0, "biceps_2": 19.0}


def test_control_begins_with_what_the_arm_does() -> None:
    bench = Bench(tension_n=ODD, shift_m={"triceps": 0.004, "biceps_2": -0.006})
    command = bench.step()
    assert bench.reference_n(command) == pytest.approx(ODD, abs=0.5)
    assert (command.author, command.lease_ns) == ("executive", LEASE_NS)
    assert command.stamp_ns == bench.now_ns
    assert command.stiffness_n_m == (K, K, K)


def test_control_fades_to_the_plan() -> None:
    bench = Bench(tension_n=ODD, shift_m={"triceps": 0.004, "biceps_2": -0.006})
    bench.run(FADE_S + DT_S)
    command = bench.step()
    plan = bench.arm.plan
    assert plan is not None
    assert command.bias_n == tuple(plan.tension_n.tolist())
    assert command.target_length_m == pytest.approx(plan.length_m, abs=1e-12)
    assert plan.residual_torque_nm == pytest.approx([0.0], abs=1e-3)
    assert bench.arm.resting_s() > 0.0


def test_after_a_silence_nothing_jumps_wherever_the_arm_has_gone() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.angle_rad = 0.3  # it was held, and it was pushed
    bench.tension_n.update(ODD)
    bench.shift_m = {"biceps_1": 0.012, "triceps": -0.02}
    bench.now_ns += 900 * MS
    bench.arm.anchor()
    assert bench.reference_n(bench.step()) == pytest.approx(ODD, abs=0.5)


def test_targets_are_never_faster_than_the_motor() -> None:
    bench = Bench(tension_n=ODD, shift_m={"triceps": 0.03, "biceps_2": -0.03})
    last = targets(bench.step())
    fastest = 0.0
    for k in range(400):
        if k == 100:
            bench.arm.go(np.array([2.0]), 30.0, 900.0)
        if k == 200:
            bench.arm.use(shipped())
        if k == 300:
            bench.shift_m = {}
        now = targets(bench.step())
        fastest = max(fastest, *(abs(now[name] - last[name]) for name in now))
        last = now
    assert fastest <= REACH_M * (1 + 1e-9)
    assert fastest > 0.5 * REACH_M  # it was asked for more


def test_going_somewhere_takes_the_time_that_the_joints_speed_allows() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.arm.go(np.array([0.5 + np.radians(60.0)]))
    assert bench.arm.resting_s() == pytest.approx(-1.875)
    bench.run(1.0)
    assert 0.5 < bench.arm.reference_rad[0] < 0.5 + np.radians(60.0)
    bench.run(1.0)
    assert bench.arm.reference_rad == pytest.approx([0.5 + np.radians(60.0)])


def test_goals_outside_the_joints_range_are_clipped() -> None:
    bench = Bench()
    bench.arm.go(np.array([9.0]))
    bench.run(10.0)
    assert np.degrees(bench.arm.reference_rad) == pytest.approx([130.0])


def test_tension_floors_are_kept_where_the_path_ends() -> None:
    bench = Bench()
    bench.arm.go(np.array([0.6]), np.array([5.0, 0.0, 12.0]))
    bench.run(1.5)
    plan = bench.arm.plan
    assert plan is not None
    floor = SETTINGS.control.tension_floor_n
    assert (plan.tension_n >= np.array([floor + 5.0, floor, floor + 12.0]) - 1e-6).all()
    assert (plan.tension_n <= SETTINGS.control.tension_ceiling_n).all()


def test_after_a_stop_the_arm_stays_where_it_is() -> None:
    bench = Bench()
    bench.arm.go(np.array([2.0]))
    bench.run(0.5)
    bench.arm.drop()
    bench.angle_rad, bench.shift_m = 0.1, {"triceps": 0.03}
    assert bench.arm.resting_s() < 0.0
    assert bench.reference_n(bench.step()) == pytest.approx(dict.fromkeys(ODD, 12.0), abs=0.5)
    assert bench.arm.reference_rad == pytest.approx([0.1])


# ── guests ────────────────────────────────────────────────────────────────────────────────────


WITH_GUEST = (*SETTINGS.muscles, "biceps_3")


def test_a_guest_follows_with_a_small_tension_and_never_holds() -> None:
    bench = Bench(muscles=WITH_GUEST, tension_n={"biceps_3": 5.0}, shift_m={"biceps_3": 0.07})
    for _ in range(100):
        command = bench.step()
        assert command.muscles[3] == "biceps_3"
        assert command.stiffness_n_m == (K, K, K, 0.0)
        assert command.bias_n[3] == GUEST_BIAS_N
        assert command.target_length_m[3] == 0.07


def test_a_guests_tension_changes_at_a_bounded_rate() -> None:
    bench = Bench(muscles=WITH_GUEST)
    bench.step()
    bench.arm.guests.bias_n["biceps_3"] = 35.0
    biases = [bench.step().bias_n[3] for _ in range(60)]
    steps = np.diff([GUEST_BIAS_N, *biases])
    assert steps.max() == pytest.approx(GUEST_RATE_N_S * DT_S)
    assert steps.min() >= 0.0
    assert biases[-1] == pytest.approx(35.0)


def test_a_guests_torque_follows_from_its_tension_and_nominal_path() -> None:
    bench = Bench(muscles=WITH_GUEST, tension_n={"biceps_3": 20.0})
    bench.run(0.1)
    spare = SETTINGS.spare[0]
    wiring = Wiring(SETTINGS.body_file, SETTINGS.joints, {spare.name: spare.path})
    _, g = wiring.lengths_and_jacobian(np.array([0.5]))
    assert bench.arm.guests.torque_nm == pytest.approx(-20.0 * g[0])


def test_old_muscles_carry_what_a_guest_of_unknown_path_does_to_the_joint() -> None:
    bench = Bench(muscles=(*SETTINGS.muscles, "stranger"))
    bench.run(2.0)
    assert bench.arm.plan is not None
    # the plan balances what is felt: gravity less the torque of the known muscles is the guest's
    f = np.full(3, 12.0)
    g = bench.schema.lengths_jacobian(np.array([0.5]), f)[:, 0]
    guest_nm = SKELETON.gravity_torque_nm(np.array([0.5])) + f @ g
    plan = bench.arm.plan
    produced = -plan.tension_n @ plan.jacobian[:, 0]
    assert produced + guest_nm == pytest.approx(
        SKELETON.gravity_torque_nm(np.array([0.5])), abs=1e-3
    )


def test_adoption_cross_fades_and_the_guest_becomes_a_muscle() -> None:
    bench = Bench(muscles=WITH_GUEST, tension_n={"biceps_3": 5.0}, shift_m={"biceps_3": 0.03})
    bench.run(1.0)
    bench.tension_n = {"triceps": 14.0, "biceps_1": 20.0, "biceps_2": 9.0, "biceps_3": 5.0}
    grown = grow(bench.schema, "biceps_3", 80.0, 0.02)
    bench.arm.use(grown)
    command = bench.step()
    assert command.stiffness_n_m == (K, K, K, K)
    assert bench.reference_n(command) == pytest.approx(bench.tension_n, abs=0.7)
    before = bench.reference_n(command)
    largest = 0.0
    for _ in range(round(FADE_S / DT_S) + 2):
        now = bench.reference_n(bench.step())
        largest = max(largest, *(abs(now[name] - before[name]) for name in now))
        before = now
    assert largest < 0.05 * K * 0.03  # of a fade over 30 mm, no step is more than a few percent
    assert bench.arm.plan is not None
    assert targets(bench.step())["biceps_3"] == pytest.approx(bench.arm.plan.length_m[3])


def test_a_muscle_that_is_not_there_is_planned_without() -> None:
    bench = Bench(muscles=("triceps", "biceps_1"))
    bench.run(2.0)
    assert bench.arm.plan is not None
    assert bench.arm.plan.tension_n[2] < 1e-9
    assert bench.arm.plan.residual_torque_nm == pytest.approx([0.0], abs=1e-3)


def test_an_excluded_muscle_is_led_like_a_guest() -> None:
    bench = Bench()
    bench.run(1.0)
    bench.arm.excluded.add("biceps_1")
    command = bench.step()
    assert command.stiffness_n_m == (K, 0.0, K)
    assert bench.arm.plan is not None and bench.arm.plan.tension_n[1] < 1e-9


# ── recording ─────────────────────────────────────────────────────────────────────────────────


def test_a_recorder_takes_rows_in_its_own_order_and_leaves_gaps_out() -> None:
    bench = Bench(tension_n={"biceps_2": 30.0, "triceps": 10.0})
    recorder = MotionRecorder(("biceps_2", "triceps"))
    assert recorder.motion().angle_rad == ()
    recorder.sample(bench.arm, settled=False)
    bench.angle_rad = 0.6
    bench.feel()
    recorder.sample(bench.arm, settled=True)
    bench.muscles = ("triceps", "biceps_1")
    bench.feel()
    recorder.sample(bench.arm, settled=True)
    motion = recorder.motion()
    assert motion.angle_rad == ((0.5,), (0.6,))
    assert motion.tension_n == ((30.0, 10.0),) * 2
    assert motion.settled == (False, True)
    assert len(motion.length_m) == 2 and len(motion.length_m[0]) == 2
