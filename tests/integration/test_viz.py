"""The viz process and what its picture looks like to Rerun's own viewer, run without a screen."""

from __future__ import annotations

import ctypes.util
import time
import urllib.request
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from dashboard.photo import photograph
from dashboard.viewer import open_view, viewer_binary
from runtime import messages as m
from runtime.bus import Bus
from runtime.hubs import free_endpoint, free_port
from runtime.settings import load_robot
from tests.made_up_run import ADDED, PLUG_S, run
from tests.viz_process import Viz, wait_until

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient, ViewerState

pytest.importorskip("rerun", reason="needs the extra myograft[view]")

pytestmark = pytest.mark.e2e

VULKAN = bool(ctypes.util.find_library("vulkan")) and any(
    Path(folder).glob("*.json") for folder in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")
)
NEEDS_VULKAN = pytest.mark.skipif(
    not VULKAN,
    reason="the viewer draws by Vulkan: apt-get install mesa-vulkan-drivers libvulkan1",
)
SPEED = 10.0
PATIENCE_S = 60.0  # the viewer draws without a graphics card
VIEWS = {
    "Body at the measured angles, wires coloured by tension",
    "Load now: felt (bar), planned (tick)",
    "Now",
    "Angle of elbow (deg)",
    "Tension (N), limit 150",
    "Planned tension (N)",
    "Length error: felt - predicted (mm)",
    "Anomaly (x usual)",
    "Temperature (°C)",
    "Loss by epoch",
    "CPU (% of a core)",
    "Memory (MB)",
    "Real-time factor",
    "What the robot does",
    "Processes",
    "Events",
}


def headless() -> ViewerClient:
    """Rerun's own viewer without a screen; a context manager."""
    from rerun.experimental import ViewerClient

    return ViewerClient.spawn(headless=True, port=free_port(), executable_path=viewer_binary())


def contents(file: Path) -> tuple[str, Counter[str], set[str]]:
    """A recording's id, rows per entity, and all lane states and log lines."""
    from rerun.chunk import RrdReader

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # no footer: it is meant to be readable after kill -9
        reader = RrdReader(str(file))
    rows: Counter[str] = Counter()
    said: set[str] = set()
    for chunk in reader.stream():
        rows[chunk.entity_path] += chunk.num_rows
        batch = chunk.to_record_batch()
        for name in ("StateChange:state", "TextLog:text"):
            if name in batch.schema.names:
                said |= {str(x) for cell in batch.column(name).to_pylist() for x in cell or ()}
    (recording,) = reader.recordings()
    return recording.recording_id, rows, said


def without_reports(viewer: ViewerClient) -> ViewerState:
    """The viewer's state once no view complains; while data come in, some may."""
    deadline = time.monotonic() + PATIENCE_S
    while True:
        viewer.take_screenshot()
        state = viewer.get_state()
        reports = [(view.name, report) for view in state.views for report in view.reports]
        if not reports and state.recordings:
            return state
        assert time.monotonic() < deadline, reports or "no recording came"


def draw(file: Path, seconds: float) -> None:
    """A made-up run, drawn into a file at once."""
    from dashboard.stream import Stream
    from dashboard.viz import canvas_of

    settings = load_robot("elbow")
    body, canvas = canvas_of(settings, "made-up", file)
    stream = Stream(settings, canvas, body)
    for now_ns, message in run(seconds):
        if type(message) in stream.inputs:
            stream.receive(message, now_ns)
        list(stream.tick(now_ns))
    canvas.close()


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file: Path = tmp_path_factory.mktemp("run") / "elbow.rrd"
    draw(file, PLUG_S + 6.0)
    return file


def test_file_holds_the_whole_run(recording: Path) -> None:
    run_id, rows, said = contents(recording)
    assert run_id == "elbow-made-up"
    assert rows["/muscle"] > 90 * PLUG_S
    assert rows["/joint"] > 45 * PLUG_S
    assert rows["/wires"] > 12 * PLUG_S
    assert rows["/robot/frames"] == 2 * rows["/wires"], "upper arm and forearm"
    assert rows["/sharing"] > 2 * PLUG_S
    assert rows[f"/module/{ADDED}"] == 3, "how it looks, joining, up"
    assert {"join", "collect", "executive: collect begins"} <= said


@NEEDS_VULKAN
def test_viewer_shows_every_view_without_a_warning(recording: Path, tmp_path: Path) -> None:
    with headless() as viewer:
        viewer.open(str(recording))
        state = without_reports(viewer)
    assert {view.name for view in state.views} == VIEWS
    (shown,) = state.recordings
    assert shown.current_timeline == "robot time"


@NEEDS_VULKAN
def test_one_can_look_back_and_follow_again(recording: Path, tmp_path: Path) -> None:
    with headless() as viewer:
        viewer.open(str(recording))
        (start,) = viewer.get_state().recordings
        newest_ns = round((PLUG_S + 6.0) * 1e9)
        assert start.current_time == pytest.approx(newest_ns, abs=0.5e9), "it follows"
        viewer.set_time(duration=PLUG_S - 6.0, play_state="paused")
        before = viewer.take_screenshot()
        viewer.set_time(duration=PLUG_S + 4.0)
        after = viewer.take_screenshot()
        (back,) = viewer.get_state().recordings
        assert back.current_time == round((PLUG_S + 4.0) * 1e9), "paused, it stays"
        viewer.set_time(play_state="following")
        viewer.take_screenshot()
        (again,) = viewer.get_state().recordings
    assert again.current_time == start.current_time
    assert min(len(before), len(after)) > 40_000, "an empty window packs to less"
    assert before != after


@NEEDS_VULKAN
def test_view_writes_the_screen_as_a_picture(recording: Path, tmp_path: Path) -> None:
    picture = tmp_path / "picture.png"
    photograph([str(recording)], picture, PLUG_S)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 40_000


def test_page_is_served_on_loopback_and_ends_with_its_owner(recording: Path) -> None:
    with open_view(recording, window=False) as viewer:
        assert viewer.address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(viewer.address, timeout=PATIENCE_S) as page:
            assert b"Rerun" in page.read()
    assert viewer.process.poll() is not None


# ── the process ─────────────────────────────────────────────────────────────────────────────────


@pytest.fixture
def hub() -> Iterator[tuple[Bus, str]]:
    endpoint = free_endpoint()
    with Bus("elbow", "test", listen=endpoint) as bus:
        bus.subscribe(m.Event, m.Presence)
        yield bus, endpoint


def play(bus: Bus, begin_s: float, end_s: float) -> list[m.Message]:
    """Say a piece of the made-up run on the bus, faster than life. Gives what was heard."""
    heard: list[m.Message] = []
    start = time.monotonic()
    for now_ns, message in run(end_s):
        t = now_ns * 1e-9
        if t < begin_s and not isinstance(message, m.ChainBody | m.GroupState):
            continue
        if isinstance(message, m.ChainState):
            late = start + max(0.0, t - begin_s) / SPEED - time.monotonic()
            heard += [x for x in bus.wait(max(0.0, late)) if isinstance(x, m.Message)]
            bus.publish(
                m.Clock(stamp_ns=now_ns, speed=SPEED, real_time_factor=SPEED, incarnation=1)
            )
        bus.publish(message)
    return heard


def told_address(bus: Bus, heard: list[m.Message], former: str = "") -> str:
    """The address that viz told, in what was heard or soon after; a former one's may come again."""

    def is_news(message: m.Message) -> bool:
        viewer = isinstance(message, m.Event) and message.kind == "viewer"
        return viewer and message.data["url"] != former

    deadline = time.monotonic() + PATIENCE_S
    while not (told := [e for e in heard if isinstance(e, m.Event) and is_news(e)]):
        assert time.monotonic() < deadline, "viz does not tell its address"
        heard += [x for x in bus.wait(0.5) if isinstance(x, m.Message)]
    (event,) = told
    return event.data["url"]


def test_process_draws_dies_and_goes_on_in_a_new_file(hub: tuple[Bus, str], tmp_path: Path) -> None:
    bus, endpoint = hub
    with Viz(load_robot("elbow"), bus, endpoint, tmp_path) as viz:
        address = told_address(bus, play(bus, 0.0, 10.0))
        assert viz.url == address
        first = viz.run_dir / "elbow.rrd"
        wait_until(lambda: contents(first)[1]["/muscle"] > 10, "a file", PATIENCE_S, 0.25)
        viz.process.kill()
        viz.process.wait()
    with Viz(load_robot("elbow"), bus, endpoint, tmp_path) as viz:
        assert viz.url == told_address(bus, play(bus, 10.0, 20.0), address)
        assert viz.url != address, "a page has to open it anew"
        second = viz.run_dir / "elbow-2.rrd"
        wait_until(lambda: "collect" in contents(second)[2], "another", PATIENCE_S, 0.25)
        assert viz.end() == 0
    (run_id, rows, _), (run_id_2, more_rows, _) = contents(first), contents(second)
    assert run_id == run_id_2 == "elbow-run-1", "both open as one run"
    assert rows["/muscle"] > 10
    assert more_rows["/muscle"] > 10
    assert "write_footer" not in (tmp_path / "viz.log").read_text(), "it is meant to have none"


@NEEDS_VULKAN
def test_a_viewer_that_joins_late_sees_the_live_run(hub: tuple[Bus, str], tmp_path: Path) -> None:
    bus, endpoint = hub
    with Viz(load_robot("elbow"), bus, endpoint, tmp_path) as viz:
        play(bus, 0.0, 14.0)
        with headless() as viewer:
            viewer.open(viz.url)
            play(bus, 14.0, 18.0)
            state = without_reports(viewer)
        (shown,) = state.recordings
        assert shown.store_id.endswith("elbow-run-1")
        assert viz.end() == 0


def test_who_polls_the_bus_gets_every_sample_or_the_newest(hub: tuple[Bus, str]) -> None:
    bus, endpoint = hub
    with Bus("elbow", "poller", endpoint=endpoint) as poller:
        poller.subscribe(m.JointState, every=True, poll=True)
        poller.subscribe(m.ExecutiveState, poll=True)
        heard: list[m.Message] = []
        deadline = time.monotonic() + PATIENCE_S
        number = 0
        while len({*map(type, heard)}) < 2 and time.monotonic() < deadline:  # until they have met
            number += 1
            bus.publish(m.JointState(stamp_ns=number, source="x", joints=(), angle_rad=()))
            bus.publish(m.ExecutiveState(stamp_ns=number, stage="hold"))
            time.sleep(0.02)
            heard += [x for x in poller.wait(0.0) if isinstance(x, m.Message)]
        for stamp_ns in range(1000, 1100):
            bus.publish(m.JointState(stamp_ns=stamp_ns, source="x", joints=(), angle_rad=()))
            bus.publish(m.ExecutiveState(stamp_ns=stamp_ns, stage="hold"))
        heard = []
        while time.monotonic() < deadline and not any(
            isinstance(x, m.ExecutiveState) and x.stamp_ns == 1099 for x in heard
        ):
            time.sleep(0.05)
            heard += [x for x in poller.wait(0.0) if isinstance(x, m.Message)]
    states = [x.stamp_ns for x in heard if isinstance(x, m.JointState) and x.stamp_ns >= 1000]
    assert states == list(range(1000, 1100))
    assert len([x for x in heard if isinstance(x, m.ExecutiveState)]) < 100
