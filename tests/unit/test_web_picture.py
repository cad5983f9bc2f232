"""What the page shows of what the bus says."""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest

import dashboard.web
from dashboard.web.picture import EVENTS, Picture
from runtime import messages as m
from runtime.hubs import Hub, address_file
from runtime.limits import HOT, WARM
from tests.unit.page_server import elbow

NOW_S = 1000.0
PAGE = Path(dashboard.web.__file__).parent / "static" / "index.html"


@pytest.fixture
def picture() -> Picture:
    return Picture(elbow(), simulated=True)


def sections(picture: Picture, now_s: float = NOW_S, **hubs: tuple[Hub, str]) -> dict[str, Any]:
    """By name, and as they arrive at a page: through JSON."""
    made = dict(picture.sections(now_s, hubs))
    told: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(made))
    return told


def state(mode: str = "follow", stamp_ns: int = 0) -> m.ChainState:
    return m.ChainState(
        stamp_ns=stamp_ns,
        chain="arm",
        muscles=("triceps", "biceps_1"),
        length_m=(0.1, 0.1),
        tension_n=(20.04, 133.0),
        temperature_degc=(25.0, 61.26),
        target_length_m=(0.1, 0.1),
        mode=mode,
    )


def test_before_anybody_speaks_there_is_the_robot_file(picture: Picture) -> None:
    told = sections(picture)
    assert told["robot"]["joints"] == [
        {"name": "elbow", "rest_deg": 0.0, "low_deg": -5.0, "high_deg": 130.0}
    ]
    assert told["robot"]["tasks"] == [{"name": "sweep", "targets": 16}]
    assert [x["name"] for x in told["robot"]["muscles"]] == [*elbow().muscles, "biceps_3"]
    assert {x["chain"] for x in told["robot"]["muscles"]} == {"arm"}
    assert told["robot"]["methods"] == list(m.METHODS)
    assert told["executive"]["stage"] == "waiting"
    assert told["processes"] == {"supervised": False, "run_dir": "", "rows": []}
    assert told["readings"]["time_s"] is None
    assert told["events"] == {"events": []}


def test_what_stands_still_is_not_told_again(picture: Picture) -> None:
    sections(picture)
    assert set(sections(picture, NOW_S + 0.1)) == {"readings"}
    picture.receive(m.ExecutiveState(stage="hold"), NOW_S)
    assert set(sections(picture, NOW_S + 0.2)) == {"readings", "executive"}
    assert set(sections(picture, NOW_S + 2.0)) == {"readings", "robots", "processes"}


def test_chains_have_their_modules_in_order_with_gauges(picture: Picture) -> None:
    modules = (
        m.ModuleInfo(
            name="triceps",
            kind="muscle",
            module_id=2,
            serial=0xABC,
            state="up",
            tension_limit_n=150.0,
            link_errors=3,
        ),
        m.ModuleInfo(name="elbow", kind="joint", module_id=100, serial=2, state="lost"),
    )
    picture.receive(m.ChainBody(chain="arm", modules=modules), NOW_S)
    picture.receive(state(), NOW_S)
    told = sections(picture)
    (chain,) = told["chains"]["chains"]
    assert told["chains"]["temperature_limit_degc"] == 80.0
    assert (told["chains"]["warm"], told["chains"]["hot"]) == (WARM, HOT)
    assert (chain["chain"], chain["link"]) == ("arm", "simulated")
    assert [x["name"] for x in chain["modules"]] == ["triceps", "elbow"]
    assert chain["modules"][0]["serial"] == "00000abc"
    assert chain["modules"][0]["link_errors"] == 3
    assert told["readings"]["chains"]["arm"] == {
        "silent": False,
        "mode": "follow",
        "muscles": {"triceps": [20.0, 25.0], "biceps_1": [133.0, 61.3]},
    }


def test_a_message_that_contradicts_itself_is_refused_and_harms_nothing(picture: Picture) -> None:
    picture.receive(state(), NOW_S)
    uneven = msgspec.structs.replace(state(), tension_n=(1.0,))
    with pytest.raises(ValueError, match="'arm' tells of 2 muscles, 1 tensions and 2 temperatures"):
        picture.receive(uneven, NOW_S)
    assert sections(picture)["readings"]["chains"]["arm"]["muscles"]["triceps"] == [20.0, 25.0]


def test_what_is_no_number_is_told_as_nothing(picture: Picture) -> None:
    odd = msgspec.structs.replace(
        state(), tension_n=(math.nan, 1.0), temperature_degc=(25.0, math.inf)
    )
    picture.receive(odd, NOW_S)
    picture.receive(m.Clock(speed=1.0, real_time_factor=math.nan, incarnation=1), NOW_S)
    health = m.Health(
        process="viz", pid=7, tick_hz=math.nan, cpu_percent=math.nan, memory_mb=math.inf, dropped=0
    )
    picture.receive(health, NOW_S)
    row = m.ProcessRow(process="viz", state="ready", pid=7)
    picture.receive(m.GroupState(ready=True, run_dir="/run", processes=(row,)), NOW_S)
    told = sections(picture)
    felt = told["readings"]["chains"]["arm"]["muscles"]
    assert felt == {"triceps": [None, 25.0], "biceps_1": [1.0, None]}
    (process,) = told["processes"]["rows"]
    assert (process["tick_hz"], process["cpu_percent"], process["memory_mb"]) == (None, None, None)


def test_silence_is_told(picture: Picture) -> None:
    picture.receive(state(), NOW_S)
    picture.receive(m.GroupState(ready=True, run_dir="/run", processes=()), NOW_S)
    assert sections(picture, NOW_S + 0.5)["processes"]["supervised"] is True
    assert sections(picture, NOW_S + 1.1)["readings"]["chains"]["arm"]["silent"] is True
    assert sections(picture, NOW_S + 5.0)["processes"]["supervised"] is False


def test_processes_have_their_own_health_and_not_their_predecessors(picture: Picture) -> None:
    health = m.Health(
        process="viz", pid=7, tick_hz=49.7, cpu_percent=3.21, memory_mb=180.4, dropped=1
    )
    picture.receive(health, NOW_S)
    row = m.ProcessRow(process="viz", state="ready", pid=7, restarts=1, last_exit="exit 1")
    picture.receive(m.GroupState(ready=True, run_dir="/run", processes=(row,)), NOW_S)
    (told,) = sections(picture)["processes"]["rows"]
    assert told["tick_hz"] == 50
    assert told["cpu_percent"] == 3.2
    assert told["memory_mb"] == 180
    assert (told["restarts"], told["last_exit"]) == (1, "exit 1")
    reborn = msgspec.structs.replace(row, state="starting", pid=8)
    picture.receive(m.GroupState(ready=False, run_dir="/run", processes=(reborn,)), NOW_S)
    (told,) = sections(picture)["processes"]["rows"]
    assert (told["state"], told["tick_hz"]) == ("starting", None)


def test_angles_are_in_degrees_and_what_is_not_known_is_not_there(picture: Picture) -> None:
    picture.receive(m.JointState(source="arm", joints=("elbow",), angle_rad=(math.pi / 4,)), NOW_S)
    assert sections(picture)["readings"]["joints"] == {"elbow": {"measured_deg": 45.0}}
    estimate = m.JointEstimate(
        joints=("elbow",),
        angle_rad=(0.5,),
        confidence_rad=(math.inf,),
        muscles=(),
        predicted_length_m=(),
        predicted_tension_n=(),
        anomaly=(),
    )
    picture.receive(estimate, NOW_S)
    waiting = m.ExecutiveState(stage="waiting", joints=("elbow",))  # no reference yet
    picture.receive(waiting, NOW_S)
    told = sections(picture)["readings"]["joints"]["elbow"]
    assert told == {"measured_deg": 45.0, "estimated_deg": 28.6}
    told = sections(picture, NOW_S + 0.6)["readings"]["joints"]["elbow"]
    assert told == {"measured_deg": 45.0}, "an old estimate is none"


def test_progress_of_a_task_and_of_relearning(picture: Picture) -> None:
    doing = m.ExecutiveState(stage="relearn", growing="biceps_3", step=7, steps=7)
    picture.receive(doing, NOW_S)
    picture.receive(m.TrainingProgress(job="j", stage="training", epoch=3, epochs=60), NOW_S)
    told = sections(picture)["executive"]
    assert (told["step"], told["steps"]) == (7, 7)
    assert told["training"] == {"epoch": 3, "epochs": 60}
    picture.receive(m.ExecutiveState(stage="adopt"), NOW_S)
    assert "training" not in sections(picture)["executive"]


def schema(*muscles: str) -> m.SchemaVersion:
    return m.SchemaVersion(version=1, joints=(), muscles=muscles, method="shipped", data=b"")


def test_a_muscle_that_is_lost_is_not_taken_in(picture: Picture) -> None:
    picture.receive(schema("triceps", "biceps_1"), NOW_S)
    begun = m.Event(
        process="executive",
        level="info",
        kind="shrink_started",
        text="the body goes on without 'biceps_1'",
        data={"muscle": "biceps_1"},
    )
    picture.receive(begun, NOW_S)
    state = m.ExecutiveState(stage="relearn", growing="biceps_1", schema_version=1)
    picture.receive(state, NOW_S)
    assert sections(picture)["executive"]["growth"] == "going on without biceps_1"


def test_a_muscle_outside_the_schema_is_named_so(picture: Picture) -> None:
    modules = tuple(
        m.ModuleInfo(name=name, kind=kind, module_id=i, serial=i, state="up")
        for i, (name, kind) in enumerate((("triceps", "muscle"), ("elbow", "joint")))
    )
    picture.receive(m.ChainBody(chain="arm", modules=modules), NOW_S)
    assert standings(picture) == ["", ""], "nobody has told of a schema"
    picture.receive(schema("biceps_1"), NOW_S)
    assert standings(picture) == ["not in the schema", ""]
    picture.receive(schema("triceps"), NOW_S)
    assert standings(picture) == ["", ""]


def standings(picture: Picture) -> list[str]:
    (chain,) = sections(picture)["chains"]["chains"]
    return [module["standing"] for module in chain["modules"]]


def test_a_stopped_robot_is_cleared_by_the_pages_own_button(picture: Picture) -> None:
    text = "stopped; clear with 'myograft reset'"
    picture.receive(m.ExecutiveState(stage="stopped", text=text), NOW_S)
    button = re.search(r'id="reset">([^<]+)<', PAGE.read_text())
    assert button and button[1] in sections(picture)["executive"]["text"]


def test_versions_with_their_figures_newest_first(picture: Picture) -> None:
    assert picture.versions_stale
    picture.versions_stale = False
    row = m.VersionRow(
        version=1,
        state="shipped",
        active=False,
        method="shipped",
        muscles=("triceps",),
        parent=0,
        residual_mm={},
        train_s=0.0,
        reason="",
    )
    learned = msgspec.structs.replace(
        row, version=2, state="adopted", active=True, residual_mm={"a": 0.2, "b": 0.6}, train_s=6.6
    )
    refused = msgspec.structs.replace(row, version=3, state="refused", reason="off by 5 mm")
    picture.take_versions([row, learned, refused])
    told = sections(picture)["schema"]["rows"]
    assert [(x["version"], x["usable"]) for x in told] == [(3, False), (2, True), (1, True)]
    assert (told[1]["mean_mm"], told[1]["worst_mm"], told[1]["train_s"]) == (0.4, 0.6, 6.6)
    assert told[2]["mean_mm"] is None
    assert told[2]["train_s"] is None, "it was not trained"
    picture.receive(m.SchemaVerdict(job="j", adopted=True, reason=""), NOW_S)
    assert picture.versions_stale


def test_events_newest_first_and_no_more_than_fit(picture: Picture) -> None:
    for number in range(EVENTS + 5):
        event = m.Event(
            stamp_ns=number * 10**9, process="world", level="info", kind="plugged", text=f"{number}"
        )
        picture.receive(event, NOW_S)
    told = sections(picture)["events"]["events"]
    assert len(told) == EVENTS
    assert told[0]["text"] == f"{EVENTS + 4}"
    assert told[0]["time_s"] == EVENTS + 4


def test_histories_of_several_processes_are_told_in_order(picture: Picture) -> None:
    for process, first_s in (("world", 50), ("executive", 0)):
        for number in range(first_s, first_s + 50):
            event = m.Event(
                stamp_ns=number * 10**9, process=process, level="info", kind="told", text=""
            )
            picture.receive(event, NOW_S)
    told = [event["time_s"] for event in sections(picture)["events"]["events"]]
    assert told == [float(99 - k) for k in range(EVENTS)]


def test_a_viewer_that_comes_back_is_another_one(picture: Picture) -> None:
    for number, port in enumerate((1, 2), start=1):
        event = m.Event(
            process="viz",
            level="info",
            kind="viewer",
            text="live view",
            data={"url": f"rerun+http://127.0.0.1:{port}/proxy"},
        )
        picture.receive(event, NOW_S)
        told = sections(picture)["robot"]["viewer"]
        assert told == {"there": True, "number": number, "host": ""}
    assert picture.viewer_url == "rerun+http://127.0.0.1:2/proxy"


def test_a_view_on_another_hosts_loopback_is_not_ours() -> None:
    picture = Picture(elbow(), simulated=True, host="robot")
    for host, there in (("workstation", False), ("robot", True)):
        data = {"url": "rerun+http://127.0.0.1:1/proxy", "host": host}
        event = m.Event(process="viz", level="info", kind="viewer", text="live view", data=data)
        picture.receive(event, NOW_S)
        assert bool(picture.viewer_url) is there
        told = sections(picture)["robot"]["viewer"]
        assert (told["there"], told["host"]) == (there, host)


def test_the_robots_of_this_host(picture: Picture, tmp_path: Path) -> None:
    address_file(tmp_path, "web").write_text("http://localhost:8801")
    other = Hub(robot="left", pid=1, endpoint="", run_dir=str(tmp_path), started="2026")
    told = sections(picture, left=(other, "http://localhost:8801"))["robots"]
    assert told == {
        "here": "elbow",
        "robots": [{"name": "left", "started": "2026", "address": "http://localhost:8801"}],
    }
