"""A made-up robot of 74 muscles and 31 joints on six chains, and what it would say.

For the dashboard's figures: nothing is simulated, the numbers only move as a robot's would.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from runtime import messages as m
from runtime.settings import RobotSettings, load_robot

MUSCLES, JOINTS, CHAINS = 74, 31, 6
STEP_NS = 10_000_000  # 100 Hz
LIMBS = ("spine", "neck", "left_arm", "right_arm", "left_leg", "right_leg")
_ROOTS = ((0, 0, 0.9), (0, 0, 0.15), (0, 0.15, 0.1), (0, -0.15, 0.1), (0, 0.1, 0.9), (0, -0.1, 0.9))
_STEPS = (
    (0, 0, 0.1),
    (0, 0, 0.05),
    (0, 0.03, -0.08),
    (0, -0.03, -0.08),
    (0, 0, -0.15),
    (0, 0, -0.15),
)
_COUNTS = (5, 2, 6, 6, 6, 6)  # joints of each limb
_PROCESSES = ("world", "estimator", "executive", "retrainer", "recorder", "viz")


def many_muscles(folder: Path, rate_hz: float = 100.0) -> RobotSettings:
    """Write body and robot file into a folder, and load them."""
    (folder / "many.xml").write_text(_body())
    (folder / "many.toml").write_text(_robot_file(rate_hz))
    return load_robot(str(folder / "many.toml"))


def say(settings: RobotSettings, now_ns: int) -> Iterator[m.Message]:
    """All that the robot says within one hundredth of a second."""
    t = now_ns * 1e-9
    step = now_ns // STEP_NS
    phases = np.arange(MUSCLES) * 0.7
    tension = 30.0 + 20.0 * np.sin(t + phases) + np.sin(31.0 * t + 3.0 * phases)
    length = 0.2 + 0.02 * np.sin(0.5 * t + phases)
    error = 0.0004 * np.sin(3.0 * t + phases)
    angle = 0.4 * np.sin(0.5 * t + np.arange(JOINTS))
    yield m.Clock(stamp_ns=now_ns, speed=1.0, real_time_factor=1.0, incarnation=1)
    for k, chain in enumerate(settings.chain):
        own = slice(k, MUSCLES, CHAINS)
        yield m.ChainState(
            stamp_ns=now_ns,
            chain=chain.name,
            muscles=settings.muscles[own],
            length_m=tuple(length[own].tolist()),
            tension_n=tuple(tension[own].tolist()),
            temperature_degc=tuple((30.0 + 0.1 * tension[own]).tolist()),
            target_length_m=tuple((length[own] - 0.001).tolist()),
            mode="follow",
        )
        joints = slice(k, JOINTS, CHAINS)
        yield m.JointState(
            stamp_ns=now_ns,
            source=chain.name,
            joints=settings.joints[joints],
            angle_rad=tuple(angle[joints].tolist()),
        )
    yield m.JointEstimate(
        stamp_ns=now_ns,
        joints=settings.joints,
        angle_rad=tuple((angle + 0.01).tolist()),
        confidence_rad=(0.02,) * JOINTS,
        muscles=settings.muscles,
        predicted_length_m=tuple((length - error).tolist()),
        predicted_tension_n=tuple(tension.tolist()),
        anomaly=tuple(np.abs(2000.0 * error).tolist()),
        length_error_m=tuple(error.tolist()),
    )
    if step % 2 == 0:
        yield m.ExecutiveState(
            stamp_ns=now_ns,
            stage="move",
            task="dance",
            step=1 + int(t / 2.0) % 8,
            steps=8,
            joints=settings.joints,
            reference_rad=tuple(angle.tolist()),
            muscles=settings.muscles,
            planned_tension_n=tuple((tension - 1.0).tolist()),
            schema_version=1,
        )
    if step % 100 == 0:
        yield from _once_a_second(settings, now_ns)


def _once_a_second(settings: RobotSettings, now_ns: int) -> Iterator[m.Message]:
    processes = (*_PROCESSES, *(f"driver-{chain.name}" for chain in settings.chain))
    for process in processes:
        yield m.Health(
            stamp_ns=now_ns,
            process=process,
            pid=1,
            tick_hz=100.0,
            cpu_percent=5.0 + math.sin(now_ns * 1e-9),
            memory_mb=40.0,
            dropped=0,
        )
    rows = tuple(m.ProcessRow(process=name, state="ready", pid=1) for name in processes)
    yield m.GroupState(stamp_ns=now_ns, ready=True, run_dir="", processes=rows)
    text = f"step {now_ns // 1_000_000_000} is reached"
    yield m.Event(stamp_ns=now_ns, process="executive", level="info", kind="step", text=text)
    for k, chain in enumerate(settings.chain):
        modules = [
            m.ModuleInfo(name=name, kind="muscle", module_id=2 + i, serial=i, state="up")
            for i, name in enumerate(settings.muscles[k::CHAINS])
        ]
        yield m.ChainBody(stamp_ns=now_ns, chain=chain.name, modules=tuple(modules))


def _joints() -> list[tuple[str, str, int]]:
    """Limb, joint and its number in the limb, along each limb."""
    return [
        (limb, f"{limb}_{i + 1}", i)
        for limb, count in zip(LIMBS, _COUNTS, strict=True)
        for i in range(count)
    ]


def _muscles() -> list[tuple[str, str]]:
    """Muscle and the joint that it spans: two or three to a joint."""
    joints = [joint for _, joint, _ in _joints()]
    return sorted(
        (f"{joints[i % JOINTS]}_{'abc'[i // JOINTS]}", joints[i % JOINTS]) for i in range(MUSCLES)
    )


def _body() -> str:
    sites: dict[str, list[str]] = {"pelvis": []}
    parent = {f"{limb}_{i + 1}": f"{limb}_{i}" if i else "pelvis" for limb, _, i in _joints()}
    parent |= {f"{limb}_1": "spine_5" for limb in ("neck", "left_arm", "right_arm")}
    tendons = []
    for k, (muscle, joint) in enumerate(_muscles()):
        x, y = 0.04 * math.cos(2.1 * k), 0.04 * math.sin(2.1 * k)
        for link, end, z in ((parent[joint], "from", -0.02), (joint, "to", 0.03)):
            site = f'<site name="{muscle}_{end}" pos="{x:.3f} {y:.3f} {z}"/>'
            sites.setdefault(link, []).append(site)
        ends = f'<site site="{muscle}_from"/><site site="{muscle}_to"/>'
        tendons.append(f'<spatial name="{muscle}">{ends}</spatial>')

    def link(joint: str) -> str:
        limb, number = joint.rsplit("_", 1)
        k = LIMBS.index(limb)
        place = " ".join(str(x) for x in (_ROOTS if number == "1" else _STEPS)[k])
        axis = ("0 1 0", "1 0 0", "0 0 1")[int(number) % 3]
        rod = " ".join(str(0.9 * x) for x in _STEPS[k])
        children = "".join(link(child) for child, above in parent.items() if above == joint)
        return (
            f'<body name="{joint}" pos="{place}">'
            f'<joint name="{joint}" axis="{axis}" range="-60 60"/>'
            f'<geom type="capsule" size="0.02" fromto="0 0 0 {rod}" mass="0.5"/>'
            f"{''.join(sites.get(joint, ()))}{children}</body>"
        )

    limbs = "".join(link(child) for child, above in parent.items() if above == "pelvis")
    return (
        '<mujoco model="many"><compiler angle="degree" autolimits="true"/><worldbody>'
        '<body name="pelvis"><geom type="box" size="0.05 0.1 0.03" pos="0 0 0.9" mass="5"/>'
        f"{''.join(sites['pelvis'])}{limbs}</body></worldbody>"
        f"<tendon>{''.join(tendons)}</tendon></mujoco>"
    )


def _robot_file(rate_hz: float) -> str:
    lines = ["[robot]", 'name = "many"', 'body = "many.xml"']
    for limb in LIMBS:
        lines += ["[[chain]]", f'name = "{limb}"', f"rate_hz = {rate_hz}", "max_modules = 24"]
    for i, (_, joint, _) in enumerate(_joints()):
        lines += ["[[joint]]", f'name = "{joint}"']
        lines += [f'chain = "{LIMBS[i % CHAINS]}"', f"id = {100 + i // CHAINS}"]
    for i, (muscle, _) in enumerate(_muscles()):
        lines += ["[[muscle]]", f'name = "{muscle}"']
        lines += [f'chain = "{LIMBS[i % CHAINS]}"', f"id = {2 + i // CHAINS}"]
    return "\n".join(lines) + "\n"
