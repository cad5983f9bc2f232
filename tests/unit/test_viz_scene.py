"""The dashboard's body: links, wires, payloads, and how joints are shown."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dashboard.body import Body
from dashboard.canvas import Floats
from dashboard.palette import slot_color, tension_colors
from dashboard.stream import Stream
from runtime import messages as m
from runtime.settings import RobotSettings, load_robot
from tests.made_up_run import ADDED, FIRST
from tests.many_muscles import JOINTS, MUSCLES, STEP_NS, many_muscles, say
from tests.unit.paper_canvas import (
    MS,
    SECOND,
    PaperCanvas,
    StickBody,
    chain_state,
    feed,
)


def test_body_follows_the_measured_angle_and_marks_the_added_muscle(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    body = StickBody()
    stream = Stream(settings, canvas, body)
    joint = m.JointState(stamp_ns=SECOND, source="arm", joints=("elbow",), angle_rad=(0.7,))
    feed(stream, [joint, chain_state(SECOND, (*FIRST, ADDED, "nowhere"))], SECOND)
    assert set(canvas.links) == {"world", "stick"}
    assert body.angle_rad == {"elbow": 0.7}
    (_, wires), *rest = canvas.frames
    assert not rest
    assert len(wires.counts) == 4, "no path, no picture"
    assert wires.labels == ("", "", "", f"added: {ADDED}")
    assert tuple(wires.module_colors[3].tolist()) == slot_color(3)
    assert wires.radius_m[3] > wires.radius_m[0], "more tension, thicker wire"


def test_who_has_no_path_is_asked_for_it_once(settings: RobotSettings, canvas: PaperCanvas) -> None:
    body = StickBody()
    stream = Stream(settings, canvas, body)
    for i in range(10):
        feed(stream, [chain_state((i + 1) * SECOND, ("nowhere",))], (i + 1) * SECOND)
    assert body.asked == ["nowhere"]


def test_frames_stay_below_their_rate_and_gone_muscles_lose_their_wire(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas, StickBody())
    for now_ns in range(SECOND, 2 * SECOND, 5 * MS):
        feed(stream, [chain_state(now_ns)], now_ns)
    assert 13 <= len(canvas.frames) <= 16
    feed(stream, [], 2 * SECOND + 100 * MS)
    assert 5 <= canvas.sends["tension_n"] <= 10, "columns go out some times a second"
    assert 95 <= len(canvas.rows["tension_n"]) <= 101, "with a hundred rows"
    feed(stream, [], 3 * SECOND)
    assert len(canvas.frames[-1][1].counts) == 0


def pose(body: Body, link: str) -> tuple[Floats, Floats]:
    """Position and quaternion of one link."""
    poses, index = body.poses(), body.links.index(link)
    return poses.position_m[index], poses.quaternion_wxyz[index]


def test_a_payload_goes_with_the_hand_that_holds_it(canvas: PaperCanvas) -> None:
    settings = load_robot("musashi_w")
    payload = settings.payload[0]
    body = Body(settings)
    stream = Stream(settings, canvas, body)
    postures = np.radians(settings.task[0].targets_deg)[[1, 2, 4]]
    stood_m = pose(body, payload.name)[0]

    def at(seconds: int, posture: Floats, *said: m.Message) -> tuple[Floats, Floats, Floats]:
        now_ns = seconds * SECOND
        angle_rad = tuple(posture.tolist())
        joints = m.JointState(
            stamp_ns=now_ns, source="arm", joints=settings.joints, angle_rad=angle_rad
        )
        feed(stream, [joints, *said], now_ns)
        hand_m, hand_turn = pose(body, payload.link)
        in_hand_m = np.empty(3)
        mujoco.mju_rotVecQuat(in_hand_m, np.array(payload.position_m), hand_turn)
        return *pose(body, payload.name), hand_m + in_hand_m

    def hand(holds: str) -> m.HandState:
        return m.HandState(hand=payload.link, asked=holds, holds=holds)

    place_m, _, _ = at(1, postures[0])
    assert place_m == pytest.approx(stood_m), "nobody holds it"
    place_m, turn, in_hand_m = at(2, postures[0], hand(payload.name))
    assert place_m == pytest.approx(in_hand_m)
    assert np.linalg.norm(place_m - stood_m) < 0.02, "it is taken where it stood"
    assert turn == pytest.approx([1.0, 0.0, 0.0, 0.0]), "and as it stood"
    place_m, turn, in_hand_m = at(3, postures[1])
    assert place_m == pytest.approx(in_hand_m)
    assert place_m[2] > stood_m[2] + 0.2
    left_m, _, in_hand_m = at(4, postures[2], hand(""))
    assert left_m == pytest.approx(place_m), "it stays where the hand opened"
    assert left_m != pytest.approx(in_hand_m)


def test_wires_of_a_real_body_run_from_module_to_insertion(settings: RobotSettings) -> None:
    body = Body(settings)
    points_m, counts = body.wires(("biceps_2", "triceps"))
    assert len(points_m) == counts.sum()
    assert (counts >= 2).all()
    alone_m, count = body.wires(("triceps",))
    assert count.tolist() == counts[1:].tolist()
    assert alone_m == pytest.approx(points_m[counts[0] :])
    assert body.wires(())[0].shape == (0, 3)


def test_joints_are_shown_in_degrees_and_slides_in_millimetres(tmp_path: Path) -> None:
    settings = many_muscles(tmp_path)
    xml = Path(settings.body_file)
    text = xml.read_text().replace('name="neck_2" axis', 'name="neck_2" type="slide" axis')
    xml.write_text(text)
    turning, sliding = Body(load_robot(settings.file)).axes(("neck_1", "neck_2"))
    assert (turning.unit, turning.scale) == ("deg", pytest.approx(180.0 / math.pi))
    assert turning.shown == pytest.approx((-60.0, 60.0))
    assert (sliding.unit, sliding.scale) == ("mm", 1000.0)


def test_a_body_of_many_muscles_is_drawn_whole(tmp_path: Path, canvas: PaperCanvas) -> None:
    settings = many_muscles(tmp_path)
    stream = Stream(settings, canvas, Body(settings))
    for now_ns in (SECOND, SECOND + STEP_NS):
        said = [x for x in say(settings, now_ns) if type(x) in stream.inputs]
        feed(stream, said, now_ns)
    assert len(canvas.frames[0][1].counts) == MUSCLES
    row = canvas.rows["tension_n"][0][1]
    assert row.shape == (MUSCLES + 12,)
    assert canvas.rows["measured_rad"][0][1].shape == (JOINTS,)


def test_colours_are_distinct_and_tension_reddens() -> None:
    assert len({slot_color(i) for i in range(60)}) == 60
    slack, tight, more = tension_colors(np.array([0.0, 1.0, 2.0]))
    assert tight.tolist() == more.tolist()
    assert tight[0] > slack[0]
