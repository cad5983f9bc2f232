"""What `myograft status --watch` shows of what the bus says."""

from __future__ import annotations

import io

import pytest

pytest.importorskip("rich", reason="needs the extra myograft[view]")
from rich.console import Console

from runtime import messages as m
from runtime.cli.live_status import render
from runtime.cli.status import Picture

SECOND = 1_000_000_000
MUSCLES = ("triceps", "biceps_1", "biceps_3")


def picture(estimated_ns: int = SECOND) -> Picture:
    """The arm goes on without biceps_1; biceps_3 is up and in no schema."""
    count = len(MUSCLES)
    modules = tuple(
        m.ModuleInfo(name=name, kind="muscle", module_id=i, serial=i, state="up")
        for i, name in enumerate(MUSCLES, start=2)
    )
    messages: tuple[m.Message, ...] = (
        m.SchemaVersion(version=3, joints=(), muscles=MUSCLES[:2], method="iv", data=b""),
        m.ExecutiveState(stage="relearn", growing="biceps_1", schema_version=3),
        m.ChainBody(chain="arm", modules=modules),
        m.ChainState(
            stamp_ns=SECOND,
            chain="arm",
            muscles=MUSCLES,
            length_m=(0.1,) * count,
            tension_n=(20.0, 0.0, 0.0),
            temperature_degc=(25.0,) * count,
            target_length_m=(0.1,) * count,
            mode="follow",
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
    states = [line.split("25.0")[1].strip() for line in lines if "25.0" in line]
    assert states == ["up", "being left out", "not in the schema"]


def test_an_old_estimate_is_left_empty() -> None:
    assert "63.0°" in shown(picture())
    assert "57.3°" in shown(picture(SECOND // 4))
    assert "63.0°" not in shown(picture(SECOND // 4))
