"""The simulated robot: hands plug modules, faults break things, snapshots bring it back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from hardware_sim.robot import STEP_NS, PlugError, SimulatedRobot, serial_number
from runtime import messages as m
from runtime.settings import RobotSettings
from runtime.wire import packet as wire
from runtime.wire.packet import StatusPacket
from runtime.wire.registers import BY_NAME, HardwareError, Kind
from tests.unit.two_joint_body import PATH, two_joints

MS = STEP_NS


@pytest.fixture
def settings(tmp_path: Path) -> RobotSettings:
    return two_joints(tmp_path)


@pytest.fixture
def robot(settings: RobotSettings) -> SimulatedRobot:
    robot = SimulatedRobot(settings)
    pull(robot, 12.0)
    return robot


def pull(robot: SimulatedRobot, bias_n: float) -> None:
    for index in range(len(robot.bank)):
        robot.bank.set_torque(index, True)
        robot.bank.bias_n[index] = bias_n


def run(robot: SimulatedRobot, steps: int) -> None:
    for _ in range(steps):
        robot.step()


def say(robot: SimulatedRobot, chain: str, packet: wire.InstructionPacket) -> list[StatusPacket]:
    request = m.BusRequest(chain=chain, sequence=7, data=wire.encode(packet))
    reply, _ = robot.exchange(request)
    assert (reply.chain, reply.sequence, reply.stamp_ns) == (chain, 7, robot.now_ns)
    return [p for p in wire.Decoder().feed(reply.data) if isinstance(p, StatusPacket)]


def read(robot: SimulatedRobot, chain: str, module_id: int, name: str) -> float:
    register = BY_NAME[name]
    (status,) = say(robot, chain, wire.read(module_id, register.address, register.size))
    return float(register.decode(status.params))


def ids(robot: SimulatedRobot, chain: str) -> list[int]:
    return [status.id for status in say(robot, chain, wire.ping())]


# ── bytes ─────────────────────────────────────────────────────────────────────────────────────


def test_modules_hang_on_the_chains_of_the_robot_file(robot: SimulatedRobot) -> None:
    assert ids(robot, "near") == [2, 3, 100]
    assert ids(robot, "far") == [2, 101]
    assert read(robot, "near", 100, "model_number") == Kind.JOINT
    assert read(robot, "far", 2, "serial_number") == serial_number("two", "long")


def test_a_built_robot_is_calibrated_and_its_joints_are_measured(robot: SimulatedRobot) -> None:
    run(robot, 1)
    assert read(robot, "near", 2, "present_tension") == pytest.approx(8.0, abs=1.0)
    assert read(robot, "near", 2, "present_length") == pytest.approx(0.0, abs=2e-4)
    assert read(robot, "far", 101, "present_angle") == pytest.approx(np.radians(20.0), abs=5e-3)


def test_a_reply_takes_as_long_as_its_bytes_on_the_line(robot: SimulatedRobot) -> None:
    data = wire.encode(wire.ping(2))
    reply, free_ns = robot.exchange(m.BusRequest(chain="near", sequence=1, data=data))
    on_the_line_ns = (len(data) + len(reply.data)) * 10 / 3e6 * 1e9
    assert free_ns - robot.now_ns >= round(on_the_line_ns)
    robot.fault(m.Fault(kind="delay", target="near", amount=0.5))
    _, late_ns = robot.exchange(m.BusRequest(chain="near", sequence=2, data=data))
    assert late_ns - free_ns == pytest.approx(5e8, abs=2)


def test_time_passes_by_steps_alone_and_two_robots_of_one_seed_are_equal(
    settings: RobotSettings,
) -> None:
    first, second = SimulatedRobot(settings, 4), SimulatedRobot(settings, 4)
    for robot in (first, second):
        pull(robot, 15.0)
        run(robot, 100)
    assert first.now_ns == 100 * MS
    assert first.truth() == second.truth()
    assert first.bank.tension_n.tolist() == second.bank.tension_n.tolist()


# ── hands ─────────────────────────────────────────────────────────────────────────────────────


def test_a_spare_is_plugged_at_the_tail_and_answers_as_fresh(robot: SimulatedRobot) -> None:
    event = robot.plug(m.Plug(muscle="spare"))
    serial = serial_number("two", "spare")
    assert (event.kind, event.process) == ("plugged", "world")
    path = msgspec.json.encode(robot.settings.spare[0].path).decode()
    assert event.data == {"muscle": "spare", "chain": "far", "serial": str(serial), "path": path}
    assert robot.chains["far"].modules[-1].serial == serial
    assert ids(robot, "far") == [1, 2, 101]
    assert robot.plant.wires[-1] == "spare"
    run(robot, 20)
    assert robot.truth().tension_n[-1] == 0.0


def test_a_plug_may_name_chain_path_and_id(robot: SimulatedRobot) -> None:
    robot.plug(m.Plug(muscle="extra", chain="near", path=PATH, module_id=9))
    assert ids(robot, "near") == [2, 3, 9, 100]
    # no chain named: the spare's, else the first
    robot.plug(m.Plug(muscle="other", path=PATH, module_id=10))
    assert ids(robot, "near") == [2, 3, 9, 10, 100]


@pytest.mark.parametrize(
    ("plug", "words"),
    [
        (m.Plug(muscle="flexor"), "muscle 'flexor' is plugged in already"),
        (
            m.Plug(muscle="wing"),
            "no spare 'wing' in the robot file, and no path by --path; there is spare",
        ),
        (m.Plug(muscle="spare", chain="tail"), "no chain 'tail'; there is far, near"),
        (
            m.Plug(
                muscle="spare",
                path=m.MusclePath(
                    attachment=m.Place(link="hand", position_m=(0.0, 0.0, 0.0)),
                    direction=(0.0, 0.0, 1.0),
                    relays=(),
                ),
            ),
            "no link 'hand'",
        ),
    ],
)
def test_what_hands_cannot_do_is_said_and_changes_nothing(
    robot: SimulatedRobot, plug: m.Plug, words: str
) -> None:
    before = robot.snapshot()
    with pytest.raises(PlugError, match=words):
        robot.plug(plug)
    assert robot.snapshot() == before
    run(robot, 5)


def test_nobody_can_unplug_what_is_not_there(robot: SimulatedRobot) -> None:
    with pytest.raises(PlugError, match="no muscle 'spare' is plugged in; there is extensor, fl"):
        robot.unplug(m.Unplug(muscle="spare"))


def test_unplugging_takes_module_and_wire_away_and_leaves_the_others(
    robot: SimulatedRobot,
) -> None:
    run(robot, 50)
    before = robot.truth()
    event = robot.unplug(m.Unplug(muscle="flexor"))
    assert event.kind == "unplugged" and event.data == {"muscle": "flexor", "chain": "near"}
    assert ids(robot, "near") == [3, 100]
    after = robot.truth()
    assert after.muscles == ("extensor", "long")
    assert after.length_m == before.length_m[1:]
    assert after.tension_n == before.tension_n[1:]
    assert after.peak_tension_n == before.peak_tension_n[1:]
    assert after.peak_speed_m_s == before.peak_speed_m_s[1:]
    run(robot, 50)
    assert read(robot, "near", 3, "present_tension") > 5.0


def test_a_module_that_returns_has_its_serial_number_id_and_registers_but_not_its_length(
    robot: SimulatedRobot,
) -> None:
    run(robot, 20)
    index = robot.plant.wires.index("long")
    tare, path = float(robot.bank.tension_tare_n[index]), robot.plant.paths["long"]
    robot.unplug(m.Unplug(muscle="long"))
    run(robot, 10)
    with pytest.raises(PlugError, match="no chain"):
        robot.plug(m.Plug(muscle="long", chain="tail"))
    robot.plug(m.Plug(muscle="long"))  # where and how it ran is remembered, also after a refusal
    assert robot.snapshot()["paths"]["long"] == msgspec.to_builtins(path)
    assert ids(robot, "far") == [2, 101]
    assert read(robot, "far", 2, "serial_number") == serial_number("two", "long")
    assert read(robot, "far", 2, "torque_enable") == 0
    assert robot.bank.tension_tare_n[-1] == tare
    assert robot.bank.bias_n[-1] == 0.0
    run(robot, 10)
    assert robot.truth().tension_n[-1] == 0.0
    assert abs(read(robot, "far", 2, "present_length")) > 1e-3


# ── faults ────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("kind", "target", "words"),
    [
        ("rupture", "spare", "nothing called 'spare' can have that; there is extensor, flexor"),
        ("rupture", "near", "nothing called 'near' can have that; there is extensor, flexor"),
        ("rupture", "flexo", r"nothing called 'flexo' can have that; did you mean 'flexor'\?"),
        ("rupture", "", "say what shall have it; there is extensor, flexor, long$"),
        ("overheat", "elbow", "nothing called 'elbow' can have that"),
        ("stuck", "far", "nothing called 'far' can have that; there is elbow, extensor"),
        ("drop", "tail", "nothing called 'tail' can have that; there is elbow, extensor, far"),
        ("melt", "flexor", "no fault 'melt'; there are"),
        ("drop", "near", "drop cannot have the amount 2, but any from 0 to 1"),
        ("delay", "near", "delay cannot have the amount 2, but any from 0 to 1"),
    ],
)
def test_faults_that_cannot_be_are_refused(
    robot: SimulatedRobot, kind: str, target: str, words: str
) -> None:
    with pytest.raises(PlugError, match=words):
        robot.fault(m.Fault(kind=kind, target=target, amount=2.0))
    assert robot.faults.active == []


def test_a_rupture_takes_the_tension_until_the_muscle_is_plugged_anew(
    robot: SimulatedRobot,
) -> None:
    run(robot, 20)
    robot.fault(m.Fault(kind="rupture", target="flexor"))
    run(robot, 300)
    assert robot.truth().tension_n[0] == 0.0
    assert robot.truth().tension_n[1] > 5.0
    robot.unplug(m.Unplug(muscle="flexor"))
    robot.plug(m.Plug(muscle="flexor"))
    assert robot.faults.active == []
    robot.bank.set_torque(2, True)
    robot.bank.bias_n[2] = 12.0
    run(robot, 1500)
    assert robot.truth().tension_n[2] == pytest.approx(12.0, abs=2.0)


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (m.Fault(kind="rupture", target="flexor", amount=1.0), "rupture on 'flexor'"),
        (m.Fault(kind="cable", target="flexor"), "cable on 'flexor'"),
        (m.Fault(kind="cable", target="near", amount=1.0), "cable on 'near', 1 modules left"),
        (m.Fault(kind="delay", target="near", amount=0.02), "delay on 'near', 0.02 s late"),
        (
            m.Fault(kind="overheat", target="flexor", amount=9),
            "overheat on 'flexor', 9 degC hotter",
        ),
    ],
)
def test_a_fault_says_how_bad_it_is_where_that_means_something(
    robot: SimulatedRobot, fault: m.Fault, words: str
) -> None:
    assert robot.fault(fault).text == words


def test_an_overheated_motor_reports_it(robot: SimulatedRobot) -> None:
    robot.fault(m.Fault(kind="overheat", target="extensor", amount=70.0))
    run(robot, 10)
    assert read(robot, "near", 3, "motor_temperature") == pytest.approx(95.0, abs=1.0)
    assert int(read(robot, "near", 3, "hardware_error")) & HardwareError.OVERHEATING
    assert read(robot, "near", 2, "motor_temperature") == pytest.approx(25.0, abs=1.0)
    text = mend(robot, target="extensor")
    assert text.endswith("; 'extensor' reports its error until it is unplugged and plugged in")
    run(robot, 100)
    assert int(read(robot, "near", 3, "hardware_error")) & HardwareError.OVERHEATING
    robot.unplug(m.Unplug(muscle="extensor"))
    robot.plug(m.Plug(muscle="extensor"))
    run(robot, 10)
    assert read(robot, "near", 3, "hardware_error") == 0


def test_stuck_sensors_give_their_last_reading_until_mended(robot: SimulatedRobot) -> None:
    run(robot, 100)
    tension, angle = read(robot, "near", 2, "present_tension"), 0.0
    robot.fault(m.Fault(kind="stuck", target="flexor", amount=1.0))
    robot.fault(m.Fault(kind="stuck", target="shoulder", amount=1.0))
    angle = read(robot, "near", 100, "present_angle")
    robot.plant.torque_nm(np.array([1.5, 0.0]))
    run(robot, 100)
    assert read(robot, "near", 2, "present_tension") == tension
    assert read(robot, "near", 100, "present_angle") == angle
    assert abs(robot.truth().angle_rad[0] - angle) > 0.01
    robot.fault(m.Fault(kind="stuck", target="flexor", amount=0.0))
    robot.fault(m.Fault(kind="stuck", target="shoulder", amount=0.0))
    run(robot, 1)
    assert read(robot, "near", 2, "present_tension") != tension
    assert read(robot, "near", 100, "present_angle") == pytest.approx(
        robot.truth().angle_rad[0], abs=5e-3
    )


# ── truth ─────────────────────────────────────────────────────────────────────────────────────


def test_peaks_are_the_greatest_of_every_millisecond(robot: SimulatedRobot) -> None:
    tensions, speeds = [], []
    for k in range(400):
        if k == 100:
            robot.plant.torque_nm(np.array([2.0, 0.0]))
        if k == 200:
            robot.plant.torque_nm(np.zeros(2))
        robot.step()
        tensions.append(robot.truth().tension_n)
        speeds.append(np.abs(robot.plant.drive.speed_m_s).tolist())
    truth = robot.truth()
    assert truth.peak_tension_n == tuple(np.max(tensions, axis=0).tolist())
    assert truth.peak_speed_m_s == tuple(np.max(speeds, axis=0).tolist())
    assert max(truth.peak_tension_n) > max(truth.tension_n)


def test_a_muscle_more_has_peaks_of_its_own(robot: SimulatedRobot) -> None:
    run(robot, 50)
    before = robot.truth()
    robot.plug(m.Plug(muscle="spare"))
    after = robot.truth()
    assert after.peak_tension_n == (*before.peak_tension_n, 0.0)
    assert after.muscles == (*before.muscles, "spare")


# ── snapshots ─────────────────────────────────────────────────────────────────────────────────


def roundtrip(snapshot: dict[str, Any]) -> dict[str, Any]:
    """As it comes back from disk."""
    decoded: dict[str, Any] = msgspec.msgpack.decode(msgspec.msgpack.encode(snapshot))
    return decoded


def eventful(robot: SimulatedRobot) -> None:
    """Plug, shelve and re-order muscles, break something."""
    run(robot, 60)
    robot.plug(m.Plug(muscle="spare"))
    robot.plug(m.Plug(muscle="extra", chain="near", path=PATH, module_id=9))
    robot.unplug(m.Unplug(muscle="extra"))
    robot.unplug(m.Unplug(muscle="flexor"))
    robot.plug(m.Plug(muscle="flexor", chain="far"))
    robot.fault(m.Fault(kind="overheat", target="long", amount=20.0))
    robot.fault(m.Fault(kind="rupture", target="extensor"))
    robot.fault(m.Fault(kind="stuck", target="elbow", amount=1.0))
    robot.fault(m.Fault(kind="cable", target="near", amount=1.0))
    say(robot, "far", wire.write(1, BY_NAME["id"].address, bytes([5])))
    run(robot, 60)


def test_a_snapshot_brings_everything_back(robot: SimulatedRobot, settings: RobotSettings) -> None:
    eventful(robot)
    snapshot = roundtrip(robot.snapshot())
    other = SimulatedRobot(settings)
    other.restore(snapshot, robot.now_ns + 5)
    assert other.now_ns == robot.now_ns + 5
    assert other.plant.wires == robot.plant.wires == ["extensor", "long", "spare", "flexor"]
    again = roundtrip(other.snapshot())
    for key in snapshot:
        if key not in ("now_ns", "modules"):  # their master was heard later by as much
            assert again[key] == snapshot[key], key
    for name in robot.chains:
        mine = [module.serial for module in robot.chains[name].modules]
        assert [module.serial for module in other.chains[name].modules] == mine
        assert ids(other, name) == ids(robot, name)
    assert other.faults.active == robot.faults.active
    assert other.truth() == msgspec.structs.replace(robot.truth(), stamp_ns=other.now_ns)
    assert read(other, "far", 101, "present_angle") == read(robot, "far", 101, "present_angle")
    run(other, 50)
    assert other.plug(m.Plug(muscle="extra")).data["chain"] == "near"  # it lay on the shelf


def test_a_snapshot_also_brings_back_a_robot_that_has_changed_since(
    robot: SimulatedRobot,
) -> None:
    run(robot, 20)
    snapshot = roundtrip(robot.snapshot())
    eventful(robot)
    robot.restore(snapshot, robot.now_ns)
    assert robot.plant.wires == ["flexor", "extensor", "long"]
    assert robot.faults.active == []
    assert ids(robot, "near") == [2, 3, 100]
    run(robot, 20)
    with pytest.raises(PlugError, match="no spare 'extra'"):  # never was there
        robot.plug(m.Plug(muscle="extra"))


def test_watchdogs_do_not_count_the_time_that_passed_without_them(
    robot: SimulatedRobot, settings: RobotSettings
) -> None:
    register = BY_NAME["bus_watchdog"]
    say(robot, "near", wire.write(2, register.address, register.encode(0.1)))
    run(robot, 20)
    other = SimulatedRobot(settings)
    other.restore(roundtrip(robot.snapshot()), robot.now_ns + 3_000_000_000)
    run(other, 50)
    assert other.bank.tripped[0] == 0.0
    run(other, 100)
    assert other.bank.tripped[0] == 1.0


# ── mending ───────────────────────────────────────────────────────────────────────────────────


def mend(robot: SimulatedRobot, kind: str = "", target: str = "") -> str:
    return robot.fault(m.Fault(action="mend", kind=kind, target=target)).text


def test_a_cable_pulled_in_mid_chain_silences_all_behind_it_until_it_is_mended(
    robot: SimulatedRobot,
) -> None:
    robot.fault(m.Fault(kind="cable", target="extensor"))
    assert ids(robot, "near") == [2]
    assert ids(robot, "far") == [2, 101]
    robot.fault(m.Fault(kind="cable", target="near", amount=0))
    assert ids(robot, "near") == []
    assert mend(robot, target="near") == "mended: cable on 'near'"
    assert ids(robot, "near") == [2]
    mend(robot)
    assert ids(robot, "near") == [2, 3, 100]


def test_what_is_mended_is_what_was_asked_for(robot: SimulatedRobot) -> None:
    for kind, target in (("drop", "near"), ("drop", "far"), ("stuck", "flexor")):
        robot.fault(m.Fault(kind=kind, target=target, amount=0.5))
    assert mend(robot, "drop", "far") == "mended: drop on 'far'"
    assert mend(robot, "drop") == "mended: drop on 'near'"
    assert [fault.kind for fault in robot.faults.active] == ["stuck"]
    assert mend(robot) == "mended: stuck on 'flexor'"
    with pytest.raises(PlugError, match="that is not broken; there is: nothing"):
        mend(robot)
    with pytest.raises(PlugError, match="'melt'"):
        robot.fault(m.Fault(action="melt"))


def test_a_torn_wire_is_not_mended_by_a_word(robot: SimulatedRobot) -> None:
    robot.fault(m.Fault(kind="rupture", target="flexor"))
    with pytest.raises(PlugError, match="unplug the muscle and plug it in"):
        mend(robot)
    robot.fault(m.Fault(kind="drop", target="near", amount=0.1))
    assert mend(robot) == "mended: drop on 'near'"
    assert [fault.kind for fault in robot.faults.active] == ["rupture"]
