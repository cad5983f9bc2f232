"""The dashboard's stream against a canvas that only remembers what was drawn on it."""

from __future__ import annotations

import math
import os
import socket
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dashboard.body import Body
from dashboard.canvas import Floats, Shape, Wire
from dashboard.commands import find_sources
from dashboard.palette import Rgb, slot_color, tension_color
from dashboard.stream import Stream
from dashboard.summary import draw_summary
from dashboard.tracks import MAX_ROWS, Slots, Track
from dashboard.viewer import ViewerError, has_display
from runtime import messages as m
from runtime.hubs import Claim, Hub, HubError
from runtime.settings import RobotSettings, load_robot
from tests.made_up_run import ADDED, FIRST, PLUG_S, run

MS = 1_000_000
SECOND = 1_000_000_000


class PaperCanvas:
    """A `Canvas` that keeps what is drawn on it."""

    def __init__(self) -> None:
        self.names: dict[str, list[str]] = {}
        self.named = 0
        self.rows: dict[str, list[tuple[float, Floats]]] = defaultdict(list)
        self.sends: dict[str, int] = defaultdict(int)
        self.states: dict[str, list[tuple[float, str]]] = defaultdict(list)
        self.texts: list[tuple[float, str, str]] = []
        self.said: list[str] = []
        self.links: dict[str, list[Shape]] = {}
        self.poses: list[tuple[float, str]] = []
        self.frames: list[tuple[float, list[Wire]]] = []

    def lines(
        self, path: str, names: Sequence[str], colors: Sequence[Rgb], widths: Sequence[float]
    ) -> None:
        assert len(names) == len(colors) == len(widths)
        self.names[path] = list(names)
        self.named += 1

    def columns(self, path: str, times_s: Floats, values: Floats) -> None:
        assert times_s.shape == values.shape[:1]
        self.sends[path] += 1
        self.rows[path] += list(zip(times_s.tolist(), values, strict=True))

    def lane(self, path: str, colors: dict[str, Rgb]) -> None:
        assert path not in self.states, "a lane is described once, before its first state"

    def state(self, path: str, time_s: float, state: str) -> None:
        self.states[path].append((time_s, state))

    def text(self, time_s: float, text: str, level: str) -> None:
        self.texts.append((time_s, text, level))

    def status(self, time_s: float, markdown: str) -> None:
        self.said.append(markdown)

    def shapes(self, link: str, shapes: Sequence[Shape]) -> None:
        self.links[link] = list(shapes)

    def pose(self, time_s: float, link: str, position_m: Floats, quaternion_wxyz: Floats) -> None:
        self.poses.append((time_s, link))

    def wires(self, time_s: float, wires: Sequence[Wire]) -> None:
        self.frames.append((time_s, list(wires)))


class StickBody:
    """A body of one link whose wires are straight."""

    links: tuple[str, ...] = ("stick",)

    def __init__(self, spares: tuple[str, ...] = (ADDED,)) -> None:
        self.muscles: tuple[str, ...] = FIRST
        self.spares = spares
        self.angle_rad: dict[str, float] = {}

    def plug(self, muscle: str) -> bool:
        if muscle not in self.spares:
            return False
        self.muscles = (*self.muscles, muscle)
        return True

    def move(self, angle_rad: dict[str, float]) -> None:
        self.angle_rad = angle_rad

    def hold(self, link: str, thing: str) -> None:
        pass

    def pose(self, link: str) -> tuple[Floats, Floats]:
        return np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])

    def wire(self, muscle: str) -> Floats:
        return np.zeros((2, 3)) + self.muscles.index(muscle)

    def shapes(self, link: str) -> list[Shape]:
        return []


@pytest.fixture
def settings() -> RobotSettings:
    return load_robot("elbow")


@pytest.fixture
def canvas() -> PaperCanvas:
    return PaperCanvas()


def chain_state(
    stamp_ns: int,
    muscles: Sequence[str] = FIRST,
    chain: str = "arm",
    tension_n: float = 10.0,
) -> m.ChainState:
    count = len(muscles)
    return m.ChainState(
        stamp_ns=stamp_ns,
        chain=chain,
        muscles=tuple(muscles),
        length_m=(0.200,) * count,
        tension_n=tuple(tension_n + i for i in range(count)),
        temperature_degc=(30.0,) * count,
        target_length_m=(0.203,) * count,
        mode="hold",
    )


def feed(stream: Stream, messages: Sequence[m.Message], now_ns: int) -> list[m.Message]:
    for message in messages:
        stream.receive(message, now_ns)
    return list(stream.tick(now_ns))


def last_row(canvas: PaperCanvas, path: str) -> list[float]:
    return [float(x) for x in canvas.rows[path][-1][1]]


# ── slots ───────────────────────────────────────────────────────────────────────────────────────


def test_slots_are_fixed_and_come_back_to_whoever_had_them() -> None:
    slots = Slots(3, ("a", "b"))
    assert slots.take(("a", "c"))
    assert not slots.take(("b",))
    assert not slots.take(("d",)), "all slots are taken"
    assert slots.index == {"a": 0, "b": 1, "c": 2}
    row = slots.empty()
    slots.fill(row, ("c", "d"), (0.5, 9.0), 10.0)
    assert row[2] == 5.0
    assert np.isnan(row[:2]).all()


def test_tension_of_a_muscle_stands_in_its_slot_whatever_the_order(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    feed(stream, [chain_state(100 * MS, ("biceps_2", "triceps"))], 100 * MS)
    row = last_row(canvas, "/tension")
    assert len(row) == 16
    assert row[0] == 11.0
    assert math.isnan(row[1]), "biceps_1 is not there"
    assert row[2] == 10.0
    assert all(math.isnan(x) for x in row[3:])
    assert last_row(canvas, "/length_error")[0] == pytest.approx(3.0), "mm, target - measured"


def test_plugged_muscle_takes_the_next_slot_and_its_name_appears(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    feed(stream, [chain_state(100 * MS)], 100 * MS)
    assert canvas.names["/tension"] == [*FIRST, *[""] * 13]
    named = canvas.named
    feed(stream, [chain_state(200 * MS, (*FIRST, ADDED))], 200 * MS)
    assert canvas.names["/tension"][3] == ADDED
    assert canvas.names["/anomaly"][3] == ADDED
    assert last_row(canvas, "/tension")[3] == 13.0
    assert canvas.named == named + 5, "five muscle vectors are named anew, once"
    feed(stream, [chain_state(300 * MS, FIRST)], 300 * MS)
    assert math.isnan(last_row(canvas, "/tension")[3])
    assert canvas.named == named + 5


def test_two_chains_share_a_row_and_a_silent_one_reads_nan(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    arm, other = chain_state(100 * MS, ("triceps",)), chain_state(100 * MS, ("x",), "other", 50.0)
    feed(stream, [arm, other], 100 * MS)
    row = last_row(canvas, "/tension")
    assert (row[0], row[3]) == (10.0, 50.0)
    feed(stream, [chain_state(700 * MS, ("triceps",))], 700 * MS)
    row = last_row(canvas, "/tension")
    assert row[0] == 10.0
    assert math.isnan(row[3])


def test_more_muscles_than_slots_are_left_out(settings: RobotSettings, canvas: PaperCanvas) -> None:
    stream = Stream(settings, canvas)
    for i in range(40):
        feed(stream, [chain_state((i + 1) * 100 * MS, (f"m{i}",))], (i + 1) * 100 * MS)
    assert len(canvas.names["/tension"]) == 16
    assert all(math.isnan(x) for x in last_row(canvas, "/tension"))


def test_limit_line_shows_only_near_the_limit(settings: RobotSettings, canvas: PaperCanvas) -> None:
    stream = Stream(settings, canvas)
    feed(stream, [chain_state(100 * MS, tension_n=20.0)], 100 * MS)
    assert math.isnan(last_row(canvas, "/limit/tension")[0])
    feed(stream, [chain_state(200 * MS, tension_n=90.0)], 200 * MS)
    assert last_row(canvas, "/limit/tension") == [settings.module.tension_limit_n]


# ── angles, training, story ─────────────────────────────────────────────────────────────────────


def test_angles_are_in_degrees_and_an_old_estimate_is_not_shown(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    estimate = m.JointEstimate(
        stamp_ns=100 * MS,
        joints=("elbow",),
        angle_rad=(math.pi / 3,),
        confidence_rad=(math.pi / 180,),
        muscles=FIRST,
        predicted_length_m=(0.0,) * 3,
        predicted_tension_n=(0.0,) * 3,
        anomaly=(1.0, 4.0, 1.0),
    )
    wanted = m.ExecutiveState(stage="hold", joints=("elbow",), reference_rad=(math.pi / 2,))
    joint = m.JointState(
        stamp_ns=100 * MS, source="arm", joints=("elbow",), angle_rad=(math.pi / 4,)
    )
    feed(stream, [wanted, estimate, joint], 100 * MS)
    assert last_row(canvas, "/angle/elbow") == pytest.approx([90.0, 45.0, 60.0, 61.0, 59.0])
    assert last_row(canvas, "/anomaly")[1] == 4.0
    later = m.JointState(stamp_ns=900 * MS, source="arm", joints=("elbow",), angle_rad=(0.0,))
    feed(stream, [later], 900 * MS)
    assert last_row(canvas, "/angle/elbow")[1] == 0.0
    assert math.isnan(last_row(canvas, "/angle/elbow")[2])


def test_who_measures_other_joints_leaves_no_gap(canvas: PaperCanvas) -> None:
    stream = Stream(load_robot("musashi_arm"), canvas)
    states = [
        m.JointState(stamp_ns=SECOND, source=source, joints=(joint,), angle_rad=(0.5,))
        for source, joint in (("shoulder", "shoulder_pitch"), ("elbow", "elbow"))
    ]
    feed(stream, states, SECOND)
    for joint in ("shoulder_pitch", "elbow"):
        measured = [row[1] for _, row in canvas.rows[f"/angle/{joint}"]]
        assert measured == pytest.approx([math.degrees(0.5)])


def test_of_many_muscles_those_in_the_spares_role_are_shown_by_themselves(
    canvas: PaperCanvas,
) -> None:
    settings = load_robot("musashi_w")
    stream = Stream(settings, canvas)
    names = ("right_pectoralis", "right_deltoid_front", settings.spare[0].name)
    feed(stream, [chain_state(SECOND, names, "right_shoulder")], SECOND)
    assert canvas.names["/role"] == [f"right_deltoid_front{end}" for end in ("", "_2", "_3")]
    assert last_row(canvas, "/role") == pytest.approx([11.0, math.nan, 12.0], nan_ok=True)


def test_every_epoch_is_drawn_and_jobs_do_not_join(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    for epoch in range(3):
        progress = m.TrainingProgress(
            stamp_ns=SECOND + epoch, job="a", stage="training", epoch=epoch, loss=0.01
        )
        stream.receive(progress, SECOND)
    stream.receive(m.TrainingProgress(stamp_ns=2 * SECOND, job="a", stage="done"), 2 * SECOND)
    list(stream.tick(2 * SECOND))
    losses = [row[0] for _, row in canvas.rows["/training"]]
    assert losses[:3] == pytest.approx([-2.0] * 3)
    assert math.isnan(losses[3])


def test_lanes_change_only_when_states_do(settings: RobotSettings, canvas: PaperCanvas) -> None:
    stream = Stream(settings, canvas)
    module = m.ModuleInfo(name="triceps", kind="muscle", module_id=2, serial=1, state="joining")
    up = m.ModuleInfo(name="triceps", kind="muscle", module_id=2, serial=1, state="up")
    row = m.ProcessRow(process="world", state="ready")
    for now_s, message in enumerate(
        (
            m.ChainBody(chain="arm", modules=(module,)),
            m.ChainBody(chain="arm", modules=(up,)),
            m.ChainBody(chain="arm", modules=(up,)),
            m.ChainBody(chain="other", modules=()),
            m.ChainBody(chain="arm", modules=()),
            m.GroupState(ready=True, run_dir="", processes=(row,)),
            m.GroupState(ready=True, run_dir="", processes=(row,)),
        )
    ):
        feed(stream, [message], now_s * SECOND)
    assert canvas.states["/lane/module/triceps"] == [
        (0.0, "joining"),
        (1.0, "up"),
        (4.0, "unplugged"),
    ]
    assert canvas.states["/lane/process/world"] == [(5.0, "ready")]


def test_events_are_logged_with_their_own_time_and_level(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    event = m.Event(
        stamp_ns=3 * SECOND, process="executive", level="warning", kind="held", text="holds"
    )
    feed(stream, [event], 4 * SECOND)
    feed(stream, [], 5 * SECOND)
    assert canvas.texts == [(3.0, "executive: holds", "WARN")]


def test_url_is_announced_once(settings: RobotSettings, canvas: PaperCanvas) -> None:
    stream = Stream(settings, canvas, url="rerun+http://127.0.0.1:1/proxy")
    (event,) = stream.tick(SECOND)
    assert isinstance(event, m.Event)
    assert event.kind == "viewer"
    assert event.data == {"url": "rerun+http://127.0.0.1:1/proxy"}
    assert list(stream.tick(2 * SECOND)) == []


# ── the body ────────────────────────────────────────────────────────────────────────────────────


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
    assert [wire.muscle for wire in wires] == [*FIRST, ADDED], "no path, no picture"
    assert [wire.label for wire in wires] == ["", "", "", f"added: {ADDED}"]
    assert wires[3].module_color == slot_color(3)
    assert wires[3].radius_m > wires[0].radius_m, "more tension, thicker wire"


def test_frames_stay_below_their_rate_and_gone_muscles_lose_their_wire(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas, StickBody())
    for now_ns in range(SECOND, 2 * SECOND, 5 * MS):
        feed(stream, [chain_state(now_ns)], now_ns)
    assert 13 <= len(canvas.frames) <= 16
    feed(stream, [], 2 * SECOND)
    assert 9 <= canvas.sends["/tension"] <= 12
    assert 95 <= len(canvas.rows["/tension"]) <= 101
    feed(stream, [], 3 * SECOND)
    assert canvas.frames[-1][1] == []


def test_a_payload_goes_with_the_hand_that_holds_it(canvas: PaperCanvas) -> None:
    settings = load_robot("musashi_w")
    payload = settings.payload[0]
    body = Body(settings)
    stream = Stream(settings, canvas, body)
    postures = np.radians(settings.task[0].targets_deg)[[1, 2, 4]]
    stood_m = body.pose(payload.name)[0]

    def at(seconds: int, posture: Floats, *said: m.Message) -> tuple[Floats, Floats, Floats]:
        now_ns = seconds * SECOND
        angle_rad = tuple(posture.tolist())
        joints = m.JointState(
            stamp_ns=now_ns, source="arm", joints=settings.joints, angle_rad=angle_rad
        )
        feed(stream, [joints, *said], now_ns)
        hand_m, hand_turn = body.pose(payload.link)
        in_hand_m = np.empty(3)
        mujoco.mju_rotVecQuat(in_hand_m, np.array(payload.position_m), hand_turn)
        return *body.pose(payload.name), hand_m + in_hand_m

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


# ── what must not happen ────────────────────────────────────────────────────────────────────────


def test_nothing_grows_while_nobody_draws(settings: RobotSettings, canvas: PaperCanvas) -> None:
    track = Track("/x", 1)
    for i in range(10 * MAX_ROWS):
        track.add(i, np.zeros(1))
    track.draw(canvas)
    assert len(canvas.rows["/x"]) == MAX_ROWS
    assert canvas.rows["/x"][-1][0] == pytest.approx((10 * MAX_ROWS - 1) * 1e-9)
    stream = Stream(settings, canvas)
    for i in range(2000):
        stream.receive(m.Event(process="p", level="info", kind="k", text=str(i)), SECOND)
        row = m.ProcessRow(process=f"p{i}", state="ready")
        stream.receive(m.GroupState(ready=True, run_dir="", processes=(row,)), SECOND)
    list(stream.tick(SECOND))
    assert 200 < len(canvas.texts) < 300
    assert canvas.texts[-1][1] == "p: 1999"
    assert len(canvas.states) < 200


def test_a_clock_that_is_set_back_does_not_stop_the_picture(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas, StickBody())
    feed(stream, [chain_state(100 * SECOND)], 100 * SECOND)
    rows, frames = len(canvas.rows["/tension"]), len(canvas.frames)
    feed(stream, [chain_state(SECOND)], SECOND)
    assert len(canvas.rows["/tension"]) == rows + 1
    assert len(canvas.frames) == frames + 1


def test_a_whole_run_costs_little(settings: RobotSettings, canvas: PaperCanvas) -> None:
    stream = Stream(settings, canvas, StickBody())
    messages = list(run(PLUG_S + 3.0))
    begin = time.process_time()
    before = 0
    for now_ns, message in messages:
        stream.receive(message, now_ns)
        if now_ns != before:
            list(stream.tick(now_ns))
            before = now_ns
    spent_s = time.process_time() - begin
    assert canvas.states["/lane/executive"][-1][1] == "collect"
    assert canvas.states["/lane/module/biceps_3"][-1][1] == "up"
    assert spent_s < 0.05 * (PLUG_S + 3.0), "a fifth of it is usual"


def test_colours_are_distinct_and_tension_reddens() -> None:
    assert len({slot_color(i) for i in range(60)}) == 60
    assert tension_color(-1.0) == tension_color(0.0)
    assert tension_color(2.0) == tension_color(1.0)
    assert tension_color(1.0)[0] > tension_color(0.0)[0]


def test_stream_needs_neither_rerun_nor_mujoco() -> None:
    import subprocess

    code = (
        "import sys, dashboard.stream, dashboard.commands, dashboard.summary;"
        "heavy = {'rerun', 'mujoco', 'matplotlib.pyplot', 'torch'} & set(sys.modules);"
        "sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    root = Path(__file__).parents[2]
    done = subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


# ── myograft view, and the summary ──────────────────────────────────────────────────────────────


@pytest.fixture
def no_robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    monkeypatch.delenv("MYOGRAFT_ENDPOINT", raising=False)
    return tmp_path / "myograft"


def test_view_shows_the_last_run_of_a_robot_that_does_not_run(no_robot: Path) -> None:
    for i, name in enumerate(("old/elbow.rrd", "new/elbow.rrd", "new/elbow-2.rrd")):
        file = no_robot / "elbow" / "runs" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
        os.utime(file, (i, i))
    runs = no_robot / "elbow" / "runs" / "new"
    assert find_sources("elbow") == [str(runs / "elbow.rrd"), str(runs / "elbow-2.rrd")]
    assert find_sources(str(runs / "elbow.rrd")) == [str(runs / "elbow.rrd")]


def test_view_says_what_is_missing(no_robot: Path) -> None:
    with pytest.raises(HubError, match="no robot is running"):
        find_sources("elbow")
    with pytest.raises(HubError, match="no robot is running"):
        find_sources()
    with pytest.raises(ViewerError, match=r"no recording nowhere\.rrd"):
        find_sources("nowhere.rrd")


def test_view_finds_the_live_address_once_somebody_answers_there(
    no_robot: Path, tmp_path: Path
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        url = f"rerun+http://127.0.0.1:{server.getsockname()[1]}/proxy"
        hub = Hub(robot="elbow", pid=os.getpid(), endpoint="tcp/x", run_dir=str(tmp_path))
        claim = Claim(hub)
        (tmp_path / "elbow.viewer").write_text(url)
        assert find_sources("elbow") == [url]
        assert find_sources() == [url]
        claim.release()


def test_window_needs_a_display() -> None:
    assert not has_display({}, "linux")
    assert has_display({"DISPLAY": ":0"}, "linux")
    assert has_display({"WAYLAND_DISPLAY": "wayland-0"}, "linux")
    assert has_display({}, "darwin")


def test_summary_is_a_picture_also_of_one_muscle_and_nothing_else(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    time_s = np.linspace(0.0, 90.0, 300)
    full, bare = tmp_path / "full.png", tmp_path / "bare.png"
    draw_summary(
        full,
        time_s=time_s,
        angle_deg={"reference": time_s, "measured": time_s, "true": time_s},
        tension_n={"triceps": time_s, "biceps_3": np.where(time_s < 40.0, np.nan, 5.0)},
        marks=[(40.0, "plug"), (41.0, "collect"), (60.0, "relearn")],
        table=[("", "before", "after"), ("mean tension", "31 N", "19 N")],
        title="A muscle is plugged in",
    )
    draw_summary(bare, time_s=time_s, angle_deg={}, tension_n={"triceps": time_s})
    for file in (full, bare):
        assert file.read_bytes().startswith(b"\x89PNG")
    assert full.stat().st_size > bare.stat().st_size
