"""The arm as the executive commands it: nothing jumps, nothing outruns the motors."""

from __future__ import annotations

import numpy as np
import pytest

from runtime.messages import ChainCommand, JointState
from services.body_schema.growth import grow
from services.logic.arm import (
    CORRECT_S,
    FADE_S,
    FELT_S,
    LEASE_NS,
    NO_SCHEMA,
    STALE_NS,
    WIND_IN_M_S,
    Arm,
    MotionRecorder,
)
from services.logic.guests import GUEST_BIAS_N, GUEST_RATE_N_S, GUEST_TORQUE_S
from services.logic.wiring import Wiring, nominal_paths
from tests.unit.arm_bench import DT_S, MS, SETTINGS, SKELETON, Bench, K, shipped

REACH_M = SETTINGS.module.target_speed_m_s * DT_S


def targets(command: ChainCommand) -> dict[str, float]:
    return dict(zip(command.muscles, command.target_length_m, strict=True))


# ── sensing ───────────────────────────────────────────────────────────────────────────────────


def test_what_is_missing_is_said_in_words() -> None:
    arm, bench = Arm(SETTINGS, SKELETON), Bench()
    state, body = bench.arm._states["arm"], bench.arm._bodies["arm"]
    assert arm.silent(bench.now_ns) == "chain 'arm' is silent"
    arm.receive(state)
    assert arm.silent(bench.now_ns) == "chain 'arm' has not said who is plugged in"
    arm.receive(body)
    assert arm.silent(bench.now_ns) == "joint 'elbow' is silent"
    arm.receive(
        JointState(stamp_ns=bench.now_ns, source="arm", joints=("elbow",), angle_rad=(0.5,))
    )
    assert arm.silent(bench.now_ns) == NO_SCHEMA
    arm.use(shipped())
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


def test_a_guest_that_is_told_a_path_pulls_along_it_from_then_on() -> None:
    bench = Bench(muscles=WITH_GUEST, tension_n={"biceps_3": 20.0})
    bench.run(0.1)
    guests, before = bench.arm.guests, bench.arm.guests.torque_nm.copy()
    told = nominal_paths(SETTINGS.body_file)["triceps"]
    assert guests.paths(("biceps_3",)) == {"biceps_3": SETTINGS.spare[0].path}
    guests.told("biceps_3", told)
    assert guests.paths(("biceps_3", "wing")) == {"biceps_3": told}
    bench.step()
    wiring = Wiring(SETTINGS.body_file, SETTINGS.joints, {"triceps": told})
    _, g = wiring.lengths_and_jacobian(np.array([0.5]))
    assert guests.torque_nm == pytest.approx(-20.0 * g[0])
    assert guests.torque_nm[0] * before[0] < 0.0  # now it extends


def test_a_guest_that_left_or_was_taken_in_does_nothing_to_the_joints() -> None:
    bench = Bench(muscles=WITH_GUEST, tension_n={"biceps_3": 20.0})
    bench.step()
    guests = bench.arm.guests
    assert guests.torque_nm[0] > 0.1
    bench.muscles = SETTINGS.muscles
    bench.step()
    assert guests.torque_nm.tolist() == [0.0]
    bench.muscles = WITH_GUEST
    bench.arm.guests.bias_n["biceps_3"] = 30.0
    bench.run(0.2)
    assert guests.torque_nm[0] > 0.1 and guests.tension_n("biceps_3") > GUEST_BIAS_N
    guests.take_in(("biceps_3",))
    assert guests.torque_nm.tolist() == [0.0]
    assert (guests.bias_n, guests.tension_n("biceps_3")) == ({}, GUEST_BIAS_N)


def test_a_strangers_torque_is_found_slowly_and_only_while_all_others_are_felt() -> None:
    bench = Bench(muscles=(*SETTINGS.muscles, "stranger"))
    g = bench.schema.lengths_jacobian(np.array([0.5]), np.full(3, 12.0))[:, 0]
    whole = SKELETON.gravity_torque_nm(np.array([0.5]))[0] + np.full(3, 12.0) @ g
    bench.step()
    assert bench.arm.guests.torque_nm[0] == pytest.approx(whole * DT_S / GUEST_TORQUE_S)
    bench.run(5 * GUEST_TORQUE_S)
    assert bench.arm.guests.torque_nm[0] == pytest.approx(whole, rel=0.02)
    bench.muscles = ("triceps", "biceps_1", "stranger")
    bench.step()
    assert bench.arm.guests.torque_nm.tolist() == [0.0]


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


# ── corrected by what is felt ─────────────────────────────────────────────────────────────────


OFF = {"triceps": 0.002, "biceps_1": -0.003, "biceps_2": 0.004}


def corrected(shift_m: dict[str, float]) -> Bench:
    """An arm that has long been led by a schema that is off, and is now to follow what it feels."""
    bench = Bench(shift_m=shift_m)
    bench.run(FADE_S + 0.2)
    bench.arm.corrected = True
    return bench


def from_plan(bench: Bench, command: ChainCommand) -> dict[str, float]:
    """By how much targets differ from the plan's lengths."""
    plan = bench.arm.plan
    assert plan is not None
    rows = zip(command.muscles, command.target_length_m, plan.length_m.tolist(), strict=True)
    return {name: target - length for name, target, length in rows}


def test_targets_follow_what_the_model_is_off_by() -> None:
    bench = corrected(OFF)
    assert from_plan(bench, bench.run(CORRECT_S + 0.1)) == pytest.approx(OFF, abs=1e-6)
    bench.shift_m = {name: -shift for name, shift in OFF.items()}
    wrong = {name: -shift for name, shift in OFF.items()}
    soon = from_plan(bench, bench.run(FELT_S))
    for name, shift in OFF.items():
        assert 0.2 < soon[name] / -shift < 0.4  # of 2: 1 - 1 / e is gone by then
    assert from_plan(bench, bench.run(10 * FELT_S)) == pytest.approx(wrong, abs=1e-6)


def test_a_slack_wire_is_wound_in_and_not_followed() -> None:
    bench = corrected(OFF)
    before = from_plan(bench, bench.run(CORRECT_S + 0.1))
    bench.tension_n["biceps_2"] = 0.0
    bench.shift_m = OFF | {"biceps_2": 0.05}  # hangs
    after = from_plan(bench, bench.run(0.5))
    wound_m = {name: before[name] - after[name] for name in OFF}
    assert wound_m == pytest.approx(
        {"triceps": 0.0, "biceps_1": 0.0, "biceps_2": 0.5 * WIND_IN_M_S}, abs=1e-6
    )


def test_without_correction_targets_are_the_plans() -> None:
    bench = Bench(shift_m=OFF)
    bench.run(FADE_S + 0.2)
    assert from_plan(bench, bench.step()) == pytest.approx(dict.fromkeys(OFF, 0.0), abs=1e-12)


def test_correction_comes_and_goes_as_a_ramp() -> None:
    bench = corrected(OFF)
    half = from_plan(bench, bench.run(CORRECT_S / 2))
    assert half == pytest.approx({name: shift / 2 for name, shift in OFF.items()}, rel=0.01)
    bench.run(CORRECT_S)
    bench.arm.corrected = False
    half = from_plan(bench, bench.run(CORRECT_S / 2))
    assert half == pytest.approx({name: shift / 2 for name, shift in OFF.items()}, rel=0.01)
    bench.run(CORRECT_S / 2)
    assert from_plan(bench, bench.step()) == pytest.approx(dict.fromkeys(OFF, 0.0), abs=1e-12)


def largest_step_n(bench: Bench, seconds: float) -> float:
    """Greatest change of any commanded tension from one tick to the next."""
    before, largest = bench.reference_n(bench.step()), 0.0
    for _ in range(round(seconds / DT_S)):
        now = bench.reference_n(bench.step())
        largest = max(largest, *(abs(now[name] - before[name]) for name in now))
        before = now
    return largest


def test_nothing_jumps_when_correction_comes_or_goes() -> None:
    bench = corrected(OFF)
    usual = K * 0.004 * DT_S / CORRECT_S  # of a ramp over 4 mm
    assert 0.9 * usual < largest_step_n(bench, 1.0) < 1.1 * usual
    bench.arm.corrected = False
    assert 0.9 * usual < largest_step_n(bench, 1.0) < 1.1 * usual
    assert largest_step_n(bench, 0.2) < 1e-6


@pytest.mark.parametrize("what", ["anchor", "drop", "use"])
def test_control_that_begins_anew_while_corrected_changes_nothing_at_first(what: str) -> None:
    bench = corrected(OFF)
    bench.run(1.0)
    bench.tension_n = dict(ODD)
    bench.shift_m = {"triceps": 0.006, "biceps_1": -0.01, "biceps_2": 0.0}
    bench.feel()
    if what == "use":
        bench.arm.use(shipped())
        bench.arm._target_m.clear()  # of the way there, only its end matters here
    else:
        getattr(bench.arm, what)()
    first = K * 0.01 * DT_S / CORRECT_S  # of the ramp by which correction comes in anew
    assert bench.reference_n(bench.step()) == pytest.approx(ODD, abs=0.5 + first)
    assert largest_step_n(bench, 2.0) < 0.05 * K * 0.01
    assert from_plan(bench, bench.step()) == pytest.approx(bench.shift_m, abs=1e-4)


def test_a_muscle_that_is_silent_for_a_while_leaves_the_correction_as_it_was() -> None:
    bench = corrected(OFF)
    bench.run(1.0)
    bench.muscles = ("triceps", "biceps_1")
    left = from_plan_of(bench, bench.run(0.3))
    assert left == pytest.approx({name: OFF[name] for name in bench.muscles}, abs=1e-6)


def from_plan_of(bench: Bench, command: ChainCommand) -> dict[str, float]:
    """As `from_plan`, of the muscles that are there."""
    plan = bench.arm.plan
    assert plan is not None
    length = dict(zip(bench.schema.muscles, plan.length_m.tolist(), strict=True))
    return {
        name: target - length[name]
        for name, target in zip(command.muscles, command.target_length_m, strict=True)
    }


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
