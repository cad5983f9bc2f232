"""What `myograft status --watch` shows of what the bus says."""

from __future__ import annotations

import io
import json
import time

import pytest

pytest.importorskip("rich", reason="needs the extra myograft[view]")
from rich.console import Console

from runtime import messages as m
from runtime.cli.live_status import fitted, render
from runtime.cli.status import SILENT_S, Picture

SECOND = 1_000_000_000
MUSCLES = ("triceps", "biceps_1", "biceps_3")


def picture(estimated_ns: int = SECOND) -> Picture:
    """The arm goes on without biceps_1; biceps_3 is up and in no schema."""
    count = len(MUSCLES)
    modules = tuple(
        m.ModuleInfo(name=name, kind="muscle", module_id=i, serial=i, state="up", link_errors=i)
        for i, name in enumerate(MUSCLES, start=2)
    )
    messages: tuple[m.Message, ...] = (
        m.SchemaVersion(version=3, joints=(), muscles=MUSCLES[:2], method="iv", data=b""),
        m.ExecutiveState(
            stage="relearn",
            growing="biceps_1",
            schema_version=3,
            joints=("elbow",),
            reference_rad=(1.2,),
            text="waiting for the retrainer",
        ),
        m.ChainBody(chain="arm", modules=modules),
        m.ChainState(
            stamp_ns=SECOND,
            chain="arm",
            muscles=MUSCLES,
            length_m=(0.1,) * count,
            tension_n=(20.0, 0.0, 0.0),
            temperature_degc=(25.0,) * count,
            target_length_m=(0.1,) * count,
            mode="stopping",
        ),
        m.JointState(stamp_ns=SECOND, source="arm", joints=("elbow",), angle_rad=(1.0,)),
        m.JointEstimate(
            stamp_ns=estimated_ns,
            joints=("elbow",),
            angle_rad=(1.1,),
            confidence_rad=(0.01,),
            muscles=(),
            predicted_length_m=(),
            predicted_tension_n=(),
            anomaly=(),
        ),
    )
    seen = Picture("elbow")
    for message in messages:
        seen.take(message)
    return seen


def shown(seen: Picture) -> str:
    console = Console(width=110, file=io.StringIO())
    with console.capture() as capture:
        console.print(render(seen))
    return capture.get()


def test_who_leaves_and_who_is_outside_is_said() -> None:
    lines = shown(picture()).splitlines()
    assert "relearn going on without biceps_1" in lines[0]
    states = [line.split("25.0")[1].split() for line in lines if "25.0" in line]
    assert [" ".join(words) for words in states] == [
        "2 up",
        "3 being left out",
        "4 not in the schema",
    ]


def test_a_large_robot_fits_a_small_terminal() -> None:
    """Its numbers whole, and what there is no room for is counted."""
    seen = Picture("musashi_w")
    for chain in ("right_shoulder", "left_shoulder"):
        names = tuple(f"{chain}_pitch_{n}" for n in range(20))
        rows = tuple(
            m.ModuleInfo(name=name, kind="muscle", module_id=n, serial=n, state="up")
            for n, name in enumerate(names)
        )
        seen.take(m.ChainBody(chain=chain, modules=rows))
        count = len(names)
        felt = m.ChainState(
            stamp_ns=1,
            chain=chain,
            muscles=names,
            length_m=(0.0,) * count,
            tension_n=(123.4,) * count,
            temperature_degc=(67.8,) * count,
            target_length_m=(0.0,) * count,
            mode="follow",
        )
        seen.take(felt)
    console = Console(width=80, height=24, file=io.StringIO())
    with console.capture() as capture:
        console.print(fitted(render(seen, 80), console))
    lines = capture.get().splitlines()
    assert len(lines) == 24
    assert "more lines" in lines[-1]
    (first, *_) = (line.split() for line in lines if "pitch_0" in line)
    assert first[:2] == ["left_shoulder", "follow"]
    assert first[-3:] == ["123.4", "67.8", "up"]


def test_the_reason_and_what_a_chain_does_is_said() -> None:
    first, *others = shown(picture()).splitlines()
    assert first.rstrip().endswith("waiting for the retrainer   schema 3 (iv)")
    assert ["arm", "stopping", "2", "triceps"] in [line.split()[:4] for line in others]


def test_status_says_the_same_once_and_to_programs() -> None:
    seen = picture()
    text = seen.as_text().splitlines()
    assert text[1] == "waiting for the retrainer"
    assert "chain arm: stopping" in text
    *_, joint = (line.split() for line in text if line.startswith("elbow "))
    assert joint[0] == "elbow" and len(joint) == 4, "wanted, measured and estimated, in degrees"
    assert [line.split()[-1] for line in text if line.startswith("biceps_3")] == ["schema"]
    told = json.loads(json.dumps(seen.as_dict()))
    assert told["text"] == "waiting for the retrainer"
    assert told["chains"] == [{"chain": "arm", "mode": "stopping"}]
    assert [row["standing"] for row in told["modules"]] == [
        "",
        "being left out",
        "not in the schema",
    ]
    assert [row["link_errors"] for row in told["modules"]] == [2, 3, 4]
    angles = {"wanted": 1.2, "measured": 1.0, "estimated": 1.1, "confidence": 0.01}
    expected = {f"{name}_rad": value for name, value in angles.items()}
    assert told["joints"] == [{"joint": "elbow", **expected}]


def test_a_chain_that_says_nothing_more_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = picture()
    later_s = time.monotonic() + 2 * SILENT_S
    monkeypatch.setattr("runtime.cli.status.time.monotonic", lambda: later_s)
    assert seen.chains() == [{"chain": "arm", "mode": "silent"}]
    assert "silent" in shown(seen)


def test_an_old_estimate_is_left_empty() -> None:
    assert "63.0°" in shown(picture())
    assert "57.3°" in shown(picture(SECOND // 4))
    assert "63.0°" not in shown(picture(SECOND // 4))
