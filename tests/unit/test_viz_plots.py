"""The dashboard's curves, against a canvas that only remembers what was drawn on it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from dashboard.palette import slot_color
from dashboard.stream import Stream
from dashboard.tracks import MAX_ROWS, Rows, Slots, Track
from runtime import messages as m
from runtime.settings import RobotSettings, load_robot
from tests.made_up_run import ADDED, FIRST, PLUG_S, run
from tests.unit.paper_canvas import (
    MS,
    SECOND,
    PaperCanvas,
    StickBody,
    chain_state,
    estimate,
    feed,
    last_row,
)

# ── slots and rows ──────────────────────────────────────────────────────────────────────────────


def test_slots_are_fixed_and_come_back_to_whoever_had_them() -> None:
    slots = Slots(3, ("a", "b"))
    assert slots.take(("a", "c"))
    assert not slots.take(("b",))
    assert not slots.take(("d",)), "all slots are taken"
    assert slots.index == {"a": 0, "b": 1, "c": 2}
    assert [x.tolist() for x in slots.columns(("d", "c", "a"))] == [[1, 2], [2, 0]]


def test_a_group_that_was_met_before_is_looked_at_again_once_slots_changed() -> None:
    slots = Slots(2, ("a",))
    assert slots.meet(("b",))
    assert not slots.meet(("b",))
    assert slots.columns(("b",))[1].tolist() == [1]


def test_rows_lay_values_by_name_and_leave_the_rest_nan() -> None:
    rows = Rows(Slots(3, ("a", "b")), MS, layers=2)
    rows.begin(SECOND)
    rows.put(("b", "x"), (2.0, 9.0))
    rows.put(("a",), (7.0,), layer=1)
    rows.put(("a", "b"), (1.0,))  # nobody knows which is whose
    rows.begin(2 * SECOND)
    rows.put(("a", "b"), (3.0, 4.0))
    times_s, values = rows.take()
    nan = math.nan
    assert times_s.tolist() == [1.0, 2.0]
    assert np.array_equal(values[0], [[nan, 2.0, nan], [3.0, 4.0, nan]], equal_nan=True)
    assert np.array_equal(values[1], [[7.0, nan, nan], [nan] * 3], equal_nan=True)
    assert rows.waiting == 0


def test_rows_come_at_their_rate_whoever_of_several_speaks() -> None:
    rows = Rows(Slots(1, ("a",)), 10 * MS)
    for stamp_ns in range(SECOND, SECOND + 100 * MS, 5 * MS):
        for late_ns in (0, 3 * MS):  # two chains, of which one is behind
            if rows.due(stamp_ns - late_ns):
                rows.begin(stamp_ns - late_ns)
    assert rows.waiting == 10


def test_nothing_grows_while_nobody_draws(canvas: PaperCanvas) -> None:
    track = Track("/x", Slots(1, ("a",)), 1)
    for i in range(10 * MAX_ROWS):
        track.add(i, ("a",), (0.0,))
    track.draw(canvas)
    assert len(canvas.rows["/x"]) == MAX_ROWS
    assert canvas.rows["/x"][-1][0] == pytest.approx((10 * MAX_ROWS - 1) * 1e-9)


# ── muscles ─────────────────────────────────────────────────────────────────────────────────────


def test_tension_of_a_muscle_stands_in_its_slot_whatever_the_order(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    feed(stream, [chain_state(100 * MS, ("biceps_2", "triceps"))], 100 * MS)
    row = last_row(canvas, "tension_n")
    assert len(row) == 16
    assert row[0] == 11.0
    assert math.isnan(row[1]), "biceps_1 is not there"
    assert row[2] == 10.0
    assert all(math.isnan(x) for x in row[3:])


def test_length_error_plan_and_anomaly_stand_beside_the_tension(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    plan = m.ExecutiveState(
        stamp_ns=90 * MS, stage="hold", muscles=FIRST, planned_tension_n=(8.0, 9.0, 7.0)
    )
    feed(stream, [plan, estimate(95 * MS), chain_state(100 * MS)], 100 * MS)
    assert last_row(canvas, "planned_n")[:3] == [8.0, 9.0, 7.0]
    assert last_row(canvas, "length_error_m")[:3] == [0.0, 0.002, 0.0], "felt - predicted"
    assert last_row(canvas, "anomaly")[:3] == [1.0, 4.0, 1.0]
    assert last_row(canvas, "/limit/anomaly") == [3.0]
    feed(stream, [chain_state(900 * MS)], 900 * MS)
    for kind in ("planned_n", "length_error_m", "anomaly"):
        assert np.isnan(last_row(canvas, kind)).all(), "an old one is not shown"


def test_a_muscle_that_is_left_out_has_no_length_error(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    torn = m.Event(
        process="executive", level="info", kind="shrink_started", text="", data={"muscle": FIRST[1]}
    )
    state = m.ExecutiveState(stage="collect", growing=FIRST[1], schema_version=1)
    feed(stream, [torn, state, estimate(95 * MS), chain_state(100 * MS)], 100 * MS)
    row = last_row(canvas, "length_error_m")
    assert math.isnan(row[1])
    assert (row[0], row[2]) == (0.0, 0.0)


def test_plugged_muscle_takes_the_next_slot_and_its_name_appears(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    feed(stream, [chain_state(200 * MS)], 200 * MS)
    assert canvas.names["/muscle"] == [*FIRST, *[""] * 13]
    named = canvas.named
    feed(stream, [chain_state(400 * MS, (*FIRST, ADDED))], 400 * MS)
    assert canvas.names["/muscle"][3] == canvas.names["/temperature"][3] == ADDED
    assert canvas.colors["/muscle"][3] == slot_color(3)
    assert last_row(canvas, "tension_n")[3] == 13.0
    assert canvas.named == named + 2, "both muscle vectors are named anew, once"
    feed(stream, [chain_state(600 * MS, FIRST)], 600 * MS)
    assert math.isnan(last_row(canvas, "tension_n")[3])
    assert canvas.named == named + 2


def test_two_chains_share_a_row_and_a_silent_one_reads_nan(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    arm, other = chain_state(100 * MS, ("triceps",)), chain_state(95 * MS, ("x",), "other", 50.0)
    feed(stream, [other, arm, chain_state(110 * MS, ("triceps",))], 110 * MS)
    row = last_row(canvas, "tension_n")
    assert (row[0], row[3]) == (10.0, 50.0)
    feed(stream, [chain_state(700 * MS, ("triceps",))], 700 * MS)
    row = last_row(canvas, "tension_n")
    assert row[0] == 10.0
    assert math.isnan(row[3])


def test_when_all_fall_silent_their_lines_end(settings: RobotSettings, canvas: PaperCanvas) -> None:
    stream = Stream(settings, canvas)
    feed(stream, [chain_state(SECOND)], SECOND)
    for now_ns in range(SECOND, 4 * SECOND, 100 * MS):
        feed(stream, [], now_ns)
    assert len(canvas.rows["tension_n"]) == 2
    assert np.isnan(last_row(canvas, "tension_n")).all()


def test_more_muscles_than_slots_are_left_out(settings: RobotSettings, canvas: PaperCanvas) -> None:
    stream = Stream(settings, canvas)
    for i in range(40):
        feed(stream, [chain_state((i + 1) * 200 * MS, (f"m{i}",))], (i + 1) * 200 * MS)
    assert len(canvas.names["/muscle"]) == 16
    assert all(math.isnan(x) for x in last_row(canvas, "tension_n"))


def test_limits_are_drawn(settings: RobotSettings, canvas: PaperCanvas) -> None:
    stream = Stream(settings, canvas)
    feed(stream, [chain_state(SECOND, tension_n=20.0)], SECOND)
    assert last_row(canvas, "/limit/tension") == [settings.module.tension_limit_n]
    assert last_row(canvas, "/limit/temperature") == [settings.module.temperature_limit_degc]
    assert last_row(canvas, "/temperature")[:3] == [30.0] * 3


def test_of_many_muscles_those_in_the_spares_role_are_shown_by_themselves(
    canvas: PaperCanvas,
) -> None:
    settings = load_robot("musashi_w")
    stream = Stream(settings, canvas)
    spare = settings.spare[0].name
    names = ("right_pectoralis", "right_deltoid_front", spare)
    feed(stream, [chain_state(SECOND, names, "right_shoulder")], SECOND)
    assert canvas.names["/role"] == [f"right_deltoid_front{end}" for end in ("", "_2", "_3")]
    assert last_row(canvas, "/role") == pytest.approx([11.0, math.nan, 12.0], nan_ok=True)
    slot = canvas.names["/muscle"].index(spare)
    assert canvas.colors["/role"][2] == canvas.colors["/muscle"][slot], "one colour everywhere"


# ── joints ──────────────────────────────────────────────────────────────────────────────────────


def test_angles_stay_in_radians_and_an_old_estimate_is_not_shown(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    wanted = m.ExecutiveState(stage="hold", joints=("elbow",), reference_rad=(1.5,))
    joint = m.JointState(stamp_ns=100 * MS, source="arm", joints=("elbow",), angle_rad=(0.8,))
    feed(stream, [wanted, estimate(100 * MS, 1.0, 0.02), joint], 100 * MS)
    assert last_row(canvas, "reference_rad") == [1.5]
    assert last_row(canvas, "measured_rad") == [0.8]
    assert last_row(canvas, "estimated_rad") == [1.0]
    assert last_row(canvas, "confidence_rad") == [0.02]
    later = m.JointState(stamp_ns=900 * MS, source="arm", joints=("elbow",), angle_rad=(0.0,))
    feed(stream, [later], 900 * MS)
    assert last_row(canvas, "measured_rad") == [0.0]
    assert math.isnan(last_row(canvas, "estimated_rad")[0])


def test_joints_that_others_measure_share_a_row(canvas: PaperCanvas) -> None:
    settings = load_robot("musashi_arm")
    stream = Stream(settings, canvas)
    for now_ns in (SECOND, SECOND + 300 * MS):
        for source, joint in (("shoulder", "shoulder_pitch"), ("elbow", "elbow")):
            state = m.JointState(stamp_ns=now_ns, source=source, joints=(joint,), angle_rad=(0.5,))
            feed(stream, [state], now_ns)
    feed(stream, [], 2 * SECOND)
    row = canvas.rows["measured_rad"][1][1]
    here = [settings.joints.index(joint) for joint in ("shoulder_pitch", "elbow")]
    assert row[here].tolist() == [0.5, 0.5]
    assert np.isnan(np.delete(row, here)).all()


# ── what must not happen ────────────────────────────────────────────────────────────────────────


def test_a_clock_that_is_set_back_does_not_stop_the_picture(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas, StickBody())
    feed(stream, [chain_state(100 * SECOND)], 100 * SECOND)
    rows, frames = len(canvas.rows["tension_n"]), len(canvas.frames)
    feed(stream, [chain_state(SECOND)], SECOND)
    assert len(canvas.rows["tension_n"]) == rows + 1
    assert len(canvas.frames) == frames + 1


def test_a_whole_run_is_drawn_to_its_end(settings: RobotSettings, canvas: PaperCanvas) -> None:
    stream = Stream(settings, canvas, StickBody())
    messages = [(t, message) for t, message in run(PLUG_S + 3.0) if type(message) in stream.inputs]
    before = 0
    for now_ns, message in messages:
        stream.receive(message, now_ns)
        if now_ns != before:
            list(stream.tick(now_ns))
            before = now_ns
    assert canvas.states["/executive"][-1][1] == "collect"
    assert canvas.states["/module/biceps_3"][-1][1] == "being taken in"
