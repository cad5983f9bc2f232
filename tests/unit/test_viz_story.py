"""The dashboard's lanes, its log, and the few words on now."""

from __future__ import annotations

from dashboard.stream import Stream
from runtime import messages as m
from runtime.settings import RobotSettings
from tests.unit.paper_canvas import SECOND, PaperCanvas, feed


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
    assert canvas.states["/module/triceps"] == [
        (0.0, "joining"),
        (1.0, "up"),
        (4.0, "unplugged"),
    ]
    assert canvas.states["/process/world"] == [(5.0, "ready")]


def test_a_lane_says_that_a_muscle_is_in_no_schema(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    up = m.ModuleInfo(name="biceps_1", kind="muscle", module_id=2, serial=1, state="up")
    schema = m.SchemaVersion(version=1, joints=(), muscles=("triceps",), method="iv", data=b"")
    for now_s, message in enumerate((m.ChainBody(chain="arm", modules=(up,)), schema)):
        feed(stream, [message], now_s * SECOND)
    assert canvas.states["/module/biceps_1"] == [(0.0, "up"), (1.0, "not in the schema")]


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
    stream = Stream(settings, canvas, url="rerun+http://127.0.0.1:1/proxy", host="here")
    (event,) = stream.tick(SECOND)
    assert isinstance(event, m.Event)
    assert event.kind == "viewer"
    assert event.data == {"url": "rerun+http://127.0.0.1:1/proxy", "host": "here"}
    assert list(stream.tick(2 * SECOND)) == []


def test_a_storm_of_events_and_processes_is_bounded(
    settings: RobotSettings, canvas: PaperCanvas
) -> None:
    stream = Stream(settings, canvas)
    for i in range(2000):
        stream.receive(m.Event(process="p", level="info", kind="k", text=str(i)), SECOND)
        row = m.ProcessRow(process=f"p{i}", state="ready")
        stream.receive(m.GroupState(ready=True, run_dir="", processes=(row,)), SECOND)
    list(stream.tick(SECOND))
    assert 200 < len(canvas.texts) < 300
    assert canvas.texts[-1][1] == "p: 1999"
    assert len(canvas.states) < 200
