"""A made-up run of the elbow: what a robot would say while a muscle is plugged in and learnt.

For the dashboard's tests: nothing is simulated, the numbers only look the part.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from runtime import messages as m

STEP_NS = 10_000_000
FIRST = ("triceps", "biceps_1", "biceps_2")
ADDED = "biceps_3"
PLUG_S = 12.0
# (start in s, stage, steps) of the growth
STAGES = (
    (0.0, "hold", 0),
    (3.0, "move", 16),
    (PLUG_S, "join", 0),
    (15.0, "collect", 7),
    (27.0, "relearn", 0),
    (30.0, "adopt", 0),
    (31.0, "resume", 0),
    (32.5, "move", 16),
)


def run(seconds: float) -> Iterator[tuple[int, m.Message]]:
    """Messages with the robot time at which they arrive, in order."""
    stage_before = ""
    for i in range(round(seconds * 1e9) // STEP_NS):
        now_ns = (i + 1) * STEP_NS
        t = now_ns * 1e-9
        start_s, stage, steps = [row for row in STAGES if row[0] <= t][-1]
        muscles = FIRST if t < PLUG_S else (*FIRST, ADDED)
        if i == 0:
            yield from _beginning(now_ns)
        if stage != stage_before:
            stage_before = stage
            yield now_ns, _event(now_ns, "executive", stage, f"{stage} begins")
        if math.isclose(t, PLUG_S) or i == 0:
            yield now_ns, _body(now_ns, muscles, "up" if i == 0 else "joining")
        if math.isclose(t, PLUG_S + 2.5):
            yield now_ns, _event(now_ns, "driver-arm", "joined", f"{ADDED} answers as id 5")
            yield now_ns, _body(now_ns, muscles, "up")
        if math.isclose(t, 21.0):
            text = "one corrupt reply, sample dropped"
            yield now_ns, _event(now_ns, "driver-arm", "link", text, "warning")
        yield from _signals(now_ns, t, stage, start_s, steps, muscles)
        if stage == "relearn" and i % 10 == 0:
            epoch = round((t - start_s) * 100)
            loss = 0.5 * math.exp(-(t - start_s)) + 0.01
            yield (
                now_ns,
                m.TrainingProgress(
                    stamp_ns=now_ns,
                    job="grow-1",
                    stage="training",
                    method="iv",
                    epoch=epoch,
                    epochs=300,
                    loss=loss,
                    loss_new=1.6 * loss,
                    loss_old=0.6 * loss,
                ),
            )
        if math.isclose(t, 30.0):
            done = m.TrainingProgress(stamp_ns=now_ns, job="grow-1", stage="done")
            yield now_ns, done
        if i % 100 == 0:
            yield now_ns, m.Clock(stamp_ns=now_ns, speed=1.0, real_time_factor=1.0, incarnation=1)
            for process, cpu in (("world", 28.0), ("driver-arm", 9.0), ("estimator", 4.0)):
                yield (
                    now_ns,
                    m.Health(
                        stamp_ns=now_ns,
                        process=process,
                        pid=1,
                        tick_hz=200.0,
                        cpu_percent=cpu + math.sin(t),
                        memory_mb=40.0 + cpu,
                        dropped=0,
                    ),
                )


def _beginning(now_ns: int) -> Iterator[tuple[int, m.Message]]:
    rows = tuple(
        m.ProcessRow(process=name, state="ready", pid=1)
        for name in ("world", "driver-arm", "estimator", "executive", "retrainer")
    )
    yield now_ns, m.GroupState(stamp_ns=now_ns, ready=True, run_dir="", processes=rows)
    yield (
        now_ns,
        m.SchemaVersion(
            stamp_ns=now_ns,
            version=1,
            joints=("elbow",),
            muscles=FIRST,
            method="shipped",
            data=b"",
        ),
    )


def _event(now_ns: int, process: str, kind: str, text: str, level: str = "info") -> m.Event:
    return m.Event(stamp_ns=now_ns, process=process, level=level, kind=kind, text=text)


def _body(now_ns: int, muscles: tuple[str, ...], newest: str) -> m.ChainBody:
    modules = [
        m.ModuleInfo(
            name=name,
            kind="muscle",
            module_id=2 + i,
            serial=100 + i,
            state=newest if name == ADDED else "up",
            tension_limit_n=150.0,
        )
        for i, name in enumerate(muscles)
    ]
    joint = m.ModuleInfo(name="elbow", kind="joint", module_id=100, serial=9, state="up")
    return m.ChainBody(stamp_ns=now_ns, chain="arm", modules=(*modules, joint))


def _signals(
    now_ns: int, t: float, stage: str, start_s: float, steps: int, muscles: tuple[str, ...]
) -> Iterator[tuple[int, m.Message]]:
    moving = stage in ("move", "collect", "resume")
    swing = 60.0 - 55.0 * math.cos(0.5 * (t - start_s)) if moving else 5.0
    reference = math.radians(15.0 * round(swing / 15.0))
    measured = math.radians(swing)
    estimated = measured + math.radians(1.5 * math.sin(3.0 * t))
    load = 8.0 + 32.0 * abs(math.sin(measured))
    eased = 1.0 if t < STAGES[-1][0] else 0.6
    tension = [12.0, load * eased, 0.8 * load * eased]
    if len(muscles) > len(FIRST):
        tension.append(3.0 if t < STAGES[-1][0] else 0.7 * load)
    noisy = [f + 0.3 * math.sin(37.0 * t + k) for k, f in enumerate(tension)]
    length = [0.2 + 0.02 * measured * (1 if k == 0 else -1) for k in range(len(muscles))]
    yield (
        now_ns,
        m.ChainState(
            stamp_ns=now_ns,
            chain="arm",
            muscles=muscles,
            length_m=tuple(length),
            tension_n=tuple(noisy),
            temperature_degc=tuple(26.0 + 0.05 * t + k for k in range(len(muscles))),
            target_length_m=tuple(x - 0.001 * (k + 1) / 4 for k, x in enumerate(length)),
            mode="follow",
        ),
    )
    yield (
        now_ns,
        m.JointState(stamp_ns=now_ns, source="arm", joints=("elbow",), angle_rad=(measured,)),
    )
    yield (
        now_ns,
        m.JointEstimate(
            stamp_ns=now_ns,
            joints=("elbow",),
            angle_rad=(estimated,),
            confidence_rad=(math.radians(3.0),),
            muscles=FIRST,
            predicted_length_m=tuple(length[:3]),
            predicted_tension_n=tuple(tension[:3]),
            anomaly=tuple(0.8 + 0.4 * math.sin(t + k) for k in range(3)),
            length_error_m=tuple(2e-4 * math.sin(t + k) for k in range(3)),
        ),
    )
    yield (
        now_ns,
        m.ExecutiveState(
            stamp_ns=now_ns,
            stage=stage,
            task="sweep" if stage == "move" else "",
            step=min(steps, 1 + int((t - start_s) / 1.7)) if steps else 0,
            steps=steps,
            joints=("elbow",),
            reference_rad=(reference,),
            muscles=FIRST if t < STAGES[-1][0] else (*FIRST, ADDED),
            planned_tension_n=tuple(tension[:3] if t < STAGES[-1][0] else tension),
            growing=ADDED if stage in ("join", "collect", "relearn", "adopt") else "",
            schema_version=1 if t < 30.0 else 2,
        ),
    )
