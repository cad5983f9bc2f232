from __future__ import annotations

import numpy as np
import pytest

from hardware_sim.firmware import MuscleModule
from hardware_sim.module import JointModule
from hardware_sim.muscle_bank import Mode, MuscleBank
from hardware_sim.muscle_rows import Array
from hardware_sim.wire_drive import WireDrive, elastic_stretch_m, elastic_tension_n
from runtime.settings import Simulation
from runtime.wire.packet import StatusError
from runtime.wire.registers import BY_NAME, GOAL_BLOCK, HardwareError, Status

USUAL = Simulation()

MS = 1_000_000
CURVE = (1000.0, 0.0, 7.5e7)  # elastic element: 35 kN/m at 150 N


class Bench:
    """One module on a test bench: readings are given, speeds come out."""

    def __init__(self, **values: float) -> None:
        self.bank = MuscleBank()
        self.module = MuscleModule(self.bank, self.bank.add(**values), serial=0x1122334455667788)
        self.now_ns = 0
        self.tension_n, self.length_m, self.temperature_degc = 0.0, 0.0, 25.0

    def step(self, count: int = 1) -> float:
        for _ in range(count):
            self.now_ns += MS
            speed = self.bank.step(
                0.001,
                np.array([self.tension_n]),
                np.array([self.length_m]),
                np.array([self.temperature_degc]),
                self.now_ns,
            )
        return float(speed[0])

    def feel(self, tension_n: float, length_m: float = 0.0) -> float:
        """Steady readings: two steps, so that the guard sees no change."""
        self.tension_n, self.length_m = tension_n, length_m
        return self.step(2)

    def write(self, name: str, value: float) -> int:
        register = BY_NAME[name]
        return self.module.write(register.address, register.encode(value))

    def read(self, name: str) -> float:
        register = BY_NAME[name]
        return register.decode(self.module.read(register.address, register.size))

    def goals(self, bias_n: float, stiffness_n_m: float, target_m: float) -> int:
        values = {
            "bias_tension": bias_n,
            "stiffness": stiffness_n_m,
            "target_length": target_m,
        }
        return self.module.write(GOAL_BLOCK.address, GOAL_BLOCK.encode(values))

    def is_in(self, mode: Mode) -> bool:
        return bool(self.bank.mode[0] == mode)


def following(bias_n: float, stiffness_n_m: float, target_m: float, **values: float) -> Bench:
    bench = Bench(**values)
    bench.step()
    bench.write("torque_enable", 1)
    assert bench.goals(bias_n, stiffness_n_m, target_m) == StatusError.NONE
    return bench


# ── the loop ──────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("goals", "tension_n", "length_m", "speed_m_s"),
    [
        # f_ref = 10 + 20000 * 1 mm = 30 N, speed = 0.006 * (f - f_ref) / (1 + f / 40 N)
        ((10.0, 20_000, 0.050), 30.0, 0.051, 0.0),
        ((10.0, 20_000, 0.050), 20.0, 0.051, -0.04),
        ((10.0, 20_000, 0.050), 50.0, 0.051, 0.12 / 2.25),
        # new muscle: no stiffness, the bias alone
        ((12.0, 0, 0.0), 2.0, 0.3, -0.06 / 1.05),
        # slack side: f_ref = 10 - 20000 * 1 mm = -10 N pays out although there is no tension
        ((10.0, 20_000, 0.051), 0.0, 0.050, 0.06),
        # ... and is cut at -25 N
        ((10.0, 20_000, 0.060), 0.0, 0.050, 0.15),
        # f_ref = 410 N is cut to 0.88 of 150 N = 132 N
        ((10.0, 20_000, 0.050), 122.0, 0.070, -0.06 / 4.05),
        ((10.0, 20_000, 0.050), 132.0, 0.070, 0.0),
    ],
)
def test_stiffness_law(
    goals: tuple[float, float, float], tension_n: float, length_m: float, speed_m_s: float
) -> None:
    assert following(*goals).feel(tension_n, length_m) == pytest.approx(speed_m_s, abs=1e-12)


def test_speed_limit() -> None:
    bench = following(10.0, 20_000, 0.05, winding_speed_limit_m_s=0.04)
    assert bench.feel(0.0, 0.2) == -0.04  # 0.002 * 132 N wanted
    assert bench.feel(100.0, 0.05) == 0.04  # 0.18 wanted


def test_capped_reference_shows_in_status() -> None:
    bench = following(10.0, 20_000, 0.05)
    bench.feel(60.0, 0.052)
    assert bench.read("status") == Status.FOLLOWING
    bench.feel(60.0, 0.070)
    assert bench.read("status") == Status.FOLLOWING | Status.TENSION_CAPPED


@pytest.mark.parametrize("mode", [Mode.OFF, Mode.FOLLOWING, Mode.HOLDING])
@pytest.mark.parametrize("stretch_m_s", [0.02, 0.14])
def test_tension_stays_under_limit(mode: Mode, stretch_m_s: float) -> None:
    """A joint that is pushed stretches the wire by 30 mm, faster than a planned motion does."""
    bank = MuscleBank()
    module = MuscleModule(bank, bank.add(), serial=1)
    drive = WireDrive(1, 0.25, USUAL)
    rng = np.random.default_rng(0)
    wire_m = np.array([0.1])
    path_m = 0.1 + elastic_stretch_m(20.0, CURVE)
    peak_n, tension = 0.0, np.zeros(1)

    def run(milliseconds: int, speed_m_s: float, start_ms: int) -> None:
        nonlocal path_m, peak_n, tension
        for now in range(start_ms, start_ms + milliseconds):
            path_m += speed_m_s * 0.001
            tension = np.array([elastic_tension_n(path_m - wire_m[0], *CURVE)])
            peak_n = max(peak_n, float(tension[0]))
            noise: Array = rng.normal(0.0, 0.2, 1)
            command = bank.step(0.001, tension + noise, wire_m, np.array([25.0]), now * MS)
            drive.step(0.001, command, tension, wire_m)

    run(5, 0.0, 0)
    if mode != Mode.OFF:
        module.write(722, (20_000).to_bytes(2, "little"))
        module.write(64, b"\1")
    if mode == Mode.HOLDING:
        module.write(98, b"\1")
        run(30, 0.0, 5)
    assert bank.mode[0] == mode
    run(round(30 / stretch_m_s), stretch_m_s, 50)
    assert 120.0 < peak_n < 150.0
    run(300, 0.0, 3000)
    assert 100.0 < float(tension[0]) < 135.0  # still held


# ── modes ─────────────────────────────────────────────────────────────────────────────────────


def test_torque_off_brakes() -> None:
    bench = Bench()
    assert bench.feel(60.0, 0.1) == 0.0
    assert bench.read("status") == 0


def test_enabling_torque_moves_nothing() -> None:
    bench = Bench()
    bench.goals(10.0, 20_000, 0.0)
    bench.feel(60.0, 0.1)
    bench.write("torque_enable", 1)
    assert bench.step() == pytest.approx(0.0, abs=1e-9)
    assert bench.read("target_length") == pytest.approx(0.1 - 50.0 / 20_000)


def test_watchdog_trips_holds_and_is_cleared() -> None:
    bench = following(10.0, 20_000, 0.05)
    bench.write("bus_watchdog", 0.1)
    bench.feel(40.0, 0.051)
    for _ in range(10):  # any packet feeds it
        bench.step(60)
        bench.module.hear(bench.now_ns)
    assert bench.is_in(Mode.FOLLOWING)
    bench.step(100)
    assert bench.is_in(Mode.FOLLOWING)
    bench.step(10)
    assert bench.is_in(Mode.HOLDING)
    assert bench.feel(40.0, 0.051) == 0.0
    assert bench.feel(142.0, 0.051) == pytest.approx(0.1)  # 10 N over 132 N, 0.01 m/s each
    bench.feel(40.0, 0.051)
    assert bench.read("bus_watchdog") == pytest.approx(-0.02)  # raw -1, as on the X series
    assert bench.read("status") == Status.HOLDING

    bench.module.hear(bench.now_ns)  # latched: bytes alone do not wake it
    assert bench.feel(40.0, 0.051) == 0.0
    assert bench.goals(10.0, 20_000, 0.0) == StatusError.DATA_RANGE
    assert bench.write("bus_watchdog", 0.0) == StatusError.NONE
    assert bench.is_in(Mode.FOLLOWING)
    assert bench.step() == pytest.approx(0.0, abs=1e-9)  # goes on at the tension that is there
    assert bench.goals(10.0, 20_000, 0.05) == StatusError.NONE
    bench.step(1000)
    assert bench.is_in(Mode.FOLLOWING)  # 0: never trips


@pytest.mark.parametrize("torque", [0, 1])
def test_stop_pays_out_slowly_until_slack(torque: int) -> None:
    bench = Bench()
    bench.feel(80.0)
    bench.write("torque_enable", torque)
    bench.write("stop", 1)
    assert bench.feel(80.0) == 0.05
    assert bench.feel(3.5) == 0.05
    assert bench.read("status") == Status.STOPPING
    bench.feel(2.9)
    assert bench.read("status") == Status.STOPPED
    assert bench.feel(5.0) == 0.0
    bench.feel(6.5)  # the sinking arm hangs on this wire again
    assert bench.feel(6.5) == 0.05
    bench.feel(1.0)
    bench.write("torque_enable", 1 - torque)
    assert bench.is_in(Mode.STOPPED)  # latched
    bench.write("stop", 0)
    assert bench.is_in(Mode.OFF if torque else Mode.FOLLOWING)
    assert bench.step() == pytest.approx(0.0 if torque else 0.006 / 1.025)  # 1 N, 0 N is wanted


def test_overheating_reduces_tension_slowly() -> None:
    bench = following(100.0, 0, 0.0)
    bench.feel(100.0)
    bench.temperature_degc = 81.0
    speeds = [bench.step() for _ in range(10_000)]
    assert max(np.diff(speeds)) < 0.001  # never at once
    assert speeds[-1] == pytest.approx(0.006 * (100 - 0.3 * 132) / 3.5)
    assert bench.read("hardware_error") == HardwareError.OVERHEATING
    assert bench.module.alert
    bench.temperature_degc = 60.0
    assert bench.step(10_000) == pytest.approx(0.0, abs=1e-12)
    assert bench.module.alert  # latched
    bench.module.reboot()
    assert not bench.module.alert


@pytest.mark.parametrize("reading_n", [-40.0, 310.0])
def test_impossible_load_cell_brakes(reading_n: float) -> None:
    bench = following(20.0, 0, 0.0)
    bench.feel(20.0)
    bench.tension_n = reading_n
    bench.step(10)
    assert bench.read("hardware_error") == HardwareError.LOAD_CELL
    assert bench.is_in(Mode.HOLDING)


def test_overload_takes_a_while() -> None:
    bench = following(20.0, 0, 0.0)
    bench.tension_n = 155.0
    bench.step(50)
    assert bench.read("hardware_error") == 0
    bench.step(100)
    assert bench.read("hardware_error") == HardwareError.OVERLOAD


# ── registers ─────────────────────────────────────────────────────────────────────────────────


def test_literal_registers() -> None:
    bench = Bench(length_zero_m=0.010, tension_tare_n=1.5)
    bench.temperature_degc = 31.4
    bench.feel(21.5, 0.110)
    assert bench.module.read(740, 9) == bytes.fromhex("a0860100 d007 3a01 00")
    assert bench.module.read(740, 4) == bytes.fromhex("a0860100")
    assert bench.module.read(746, 3) == bytes.fromhex("3a01 00")
    assert bench.module.read(132, 4) == (8964).to_bytes(4, "little")  # 0.11 m / 8 mm of spool
    assert bench.module.read(146, 1) == b"\x1f"
    assert bench.module.read(700, 8) == bytes.fromhex("8877665544332211")
    assert bench.module.read(0, 2) == b"1M"
    assert bench.module.read(64, 5) == bytes(4) + b"\x02"  # gaps read 0
    assert bench.module.read(66, 1) == b""
    assert bench.module.read(2000, 1) == b""


def test_presents_clip_at_the_end_of_their_scale() -> None:
    bench = Bench()
    bench.feel(400.0, -0.001)
    assert bench.module.read(740, 6) == bytes.fromhex("18fcffff ff7f")
    assert bench.module.read(740, 9)[:6] == bytes.fromhex("18fcffff ff7f")


@pytest.mark.parametrize(
    ("address", "data", "error"),
    [
        (65, b"\1", StatusError.NONE),
        (65, b"\2", StatusError.DATA_LIMIT),
        (719, bytes(9), StatusError.NONE),  # the stop and the goals together
        (720, b"\xff\xff" + bytes(6), StatusError.DATA_LIMIT),
        (720, b"\x01", StatusError.DATA_LENGTH),
        (721, b"\x01", StatusError.DATA_LENGTH),
        (64, b"\1\1\1", StatusError.DATA_LENGTH),  # over a gap
        (70, b"\0", StatusError.ACCESS),
        (744, b"\0\0", StatusError.ACCESS),
        (300, b"\0", StatusError.ACCESS),
        (7, b"\xfd", StatusError.DATA_LIMIT),
        (98, b"\xff", StatusError.DATA_LIMIT),
    ],
)
def test_write_errors(address: int, data: bytes, error: StatusError) -> None:
    assert Bench().module.write(address, data) == error


def test_refused_write_changes_nothing() -> None:
    bench = Bench()
    assert bench.module.write(64, b"\1\2") == StatusError.DATA_LIMIT
    assert bench.read("torque_enable") == 0


def test_eeprom_only_when_torque_is_off() -> None:
    bench = Bench()
    bench.feel(7.0, 0.02)
    bench.write("torque_enable", 1)
    for name, value in (("id", 9), ("length_zero", 0.02), ("tension_tare", 5.0)):
        before = bench.read(name)
        assert bench.write(name, value) == StatusError.ACCESS
        assert bench.read(name) == before
    bench.write("torque_enable", 0)
    for name, value in (("id", 9), ("length_zero", 0.02), ("tension_tare", 5.0)):
        assert bench.write(name, value) == StatusError.NONE
    assert bench.module.id == 9
    for _ in range(2):  # at once, and with the next reading
        assert bench.read("present_length") == 0.0
        assert bench.read("present_tension") == 2.0
        bench.step()
    assert bench.read("status") == Status.TARED


def test_tension_limit_register_limits() -> None:
    bench = Bench()
    bench.write("tension_limit", 50.0)
    bench.write("torque_enable", 1)
    bench.goals(100.0, 0, 0.0)
    assert bench.feel(34.0) == pytest.approx(0.006 * (34 - 44) / 1.85)


def test_reboot_forgets_ram_and_keeps_eeprom() -> None:
    bench = Bench()
    bench.write("id", 9)
    bench.write("tension_limit", 60.0)
    bench.write("torque_enable", 1)
    bench.goals(10.0, 20_000, 0.05)
    bench.write("stop", 1)
    bench.module.reboot()
    assert bench.is_in(Mode.OFF)
    assert bench.feel(40.0) == 0.0
    assert bench.module.read(720, 8) == bytes(8)
    assert (bench.module.id, bench.read("tension_limit")) == (9, 60.0)


def test_factory_reset_spares_what_it_says() -> None:
    bench = Bench()
    for option, module_id, baud in ((2, 9, 57_600), (1, 9, 3_000_000), (0xFF, 1, 3_000_000)):
        bench.write("id", 9)
        bench.module.listen_at(57_600)
        bench.write("temperature_limit", 60)
        assert bench.module.factory_reset(option)
        assert (bench.module.id, bench.module.baud) == (module_id, baud)
        assert bench.read("temperature_limit") == 80
    assert not bench.module.factory_reset(3)


def test_peak_target_speed() -> None:
    bench = Bench()
    bench.goals(10.0, 20_000, 0.5)  # torque is off
    bench.write("torque_enable", 1)
    bench.goals(10.0, 0, 0.9)  # no stiffness: the target means nothing
    bench.step(10)
    bench.goals(10.0, 20_000, 0.1)  # the first that counts has nothing before it
    assert bench.bank.peak_target_speed_m_s[0] == 0.0
    bench.step(10)
    bench.goals(10.0, 20_000, 0.102)
    assert bench.bank.peak_target_speed_m_s[0] == pytest.approx(0.2)
    bench.step(10)
    bench.goals(10.0, 20_000, 0.101)
    assert bench.bank.peak_target_speed_m_s[0] == pytest.approx(0.2)


def test_joint_module() -> None:
    joint = JointModule(5, lambda: -0.5, module_id=100)
    assert joint.read(740, 4) == (-500_000).to_bytes(4, "little", signed=True)
    assert joint.read(740, 9) == (-500_000).to_bytes(4, "little", signed=True) + bytes(5)
    assert joint.read(720, 8) == b""
    assert joint.write(64, b"\1") == StatusError.ACCESS
    assert joint.ping() == b"1J\x01"


# ── the bank ──────────────────────────────────────────────────────────────────────────────────


def test_save_and_restore() -> None:
    bench = following(10.0, 20_000, 0.05)
    bench.write("bus_watchdog", 0.1)
    bench.write("led", 1)
    bench.feel(40.0, 0.051)
    bench.step(200)
    state = bench.module.save()
    assert state["serial"] == 0x1122334455667788

    again = Bench()
    again.module.restore(state)
    assert again.is_in(Mode.HOLDING)
    assert again.module.save() == state
    for address, length in ((0, 10), (64, 7), (98, 1), (700, 52)):
        assert again.module.read(address, length) == bench.module.read(address, length)
    for twin in (bench, again):
        twin.now_ns = 10**9
        twin.tension_n, twin.length_m = 40.0, 0.051
        twin.write("bus_watchdog", 0.0)
    assert again.step() == bench.step()
    assert again.goals(30.0, 20_000, 0.05) == bench.goals(30.0, 20_000, 0.05) == 0
    assert again.step() == bench.step() != 0.0


def test_a_stop_survives_the_restore() -> None:
    bench = Bench()
    bench.feel(50.0)
    bench.write("stop", 1)
    again = Bench()
    again.module.restore(bench.module.save())
    assert again.feel(50.0) == 0.05


def test_modules_keep_their_muscle_when_others_go() -> None:
    bank = MuscleBank()
    modules = [MuscleModule(bank, bank.add(), serial) for serial in (1, 2, 3)]
    for module in modules:
        module.write(720, bytes((module.serial, 0)))
        module.write(64, b"\1")
    bank.remove(1)
    assert [m.index for m in (modules[0], modules[2])] == [0, 1]
    assert bank.bias_n.tolist() == [0.01, 0.03]
    zeros = np.zeros(2)
    speeds = bank.step(0.001, zeros, zeros, zeros, MS)
    assert speeds.tolist() == pytest.approx([-0.00006, -0.00018])
    MuscleModule(bank, bank.add(), 4)
    assert len(bank) == 3
    assert bank.mode.tolist() == [Mode.FOLLOWING, Mode.FOLLOWING, Mode.OFF]
