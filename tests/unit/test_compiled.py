"""Compiled loops over wires, against the same equations written for whole arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hardware_sim.compiled import INTEGER, NUMBER, VECTOR, compiled
from hardware_sim.muscle_bank import CHECK_NS, Mode, MuscleBank
from hardware_sim.muscle_rows import ROWS, Array
from hardware_sim.wire_drive import WireDrive, stretch_wires
from runtime.settings import Simulation
from runtime.wire.registers import HardwareError

USUAL = Simulation()

M = 200
DT_S = 0.001
CURVE = (1000.0, 300.0, 7.5e7)
Table = dict[str, Array]


def a_bank(rng: np.random.Generator) -> tuple[MuscleBank, Table]:
    """Muscles in every state that they can be in, but for one that `step` would act on at once."""
    table = {name: np.full(M, value) for name, value in ROWS.items()}
    table |= {
        "bias_n": rng.uniform(0.0, 60.0, M),
        "stiffness_n_m": rng.choice([0.0, 2000.0, 60_000.0], M),
        "target_length_m": rng.uniform(0.08, 0.12, M),
        "tension_limit_n": rng.uniform(60.0, 150.0, M),
        "winding_speed_limit_m_s": rng.uniform(0.02, 0.25, M),
        "length_zero_m": rng.uniform(-0.1, 0.1, M),
        "tension_tare_n": rng.uniform(-3.0, 3.0, M),
        "tension_n": rng.uniform(-5.0, 140.0, M),
        "length_m": rng.uniform(0.08, 0.12, M),
        "torque": rng.choice([0.0, 1.0], M, p=(0.2, 0.8)),
        "tripped": rng.choice([0.0, 1.0], M, p=(0.9, 0.1)),
        "stop": rng.choice([0.0, 1.0], M, p=(0.7, 0.3)),
        "mode": rng.choice([float(Mode.STOPPED), float(Mode.FOLLOWING)], M),
        "derating": rng.choice([1.0, 0.5], M),
    }
    bank = MuscleBank()
    for index in range(M):
        bank.add()
        bank.set_column(index, {name: row[index] for name, row in table.items()})
    assert {int(mode) for mode in bank.mode} == {int(mode) for mode in Mode}
    return bank, {name: getattr(bank, name).copy() for name in ROWS}


def the_loops(before: Table, tension: Array, length: Array) -> tuple[Array, Array]:
    """Winding speeds [m/s] and modes of M muscles that read these."""
    mode, limit = before["mode"], before["winding_speed_limit_m_s"]
    guard = 0.88 * before["tension_limit_n"]
    stretch = length - before["target_length_m"]
    reference = before["bias_n"] + before["stiffness_n_m"] * stretch
    reference = np.clip(reference, -25.0, guard * before["derating"])
    follow = 0.006 * (tension - reference) / (1.0 + np.maximum(tension, 0.0) / 40.0)
    speed = np.select([mode == Mode.FOLLOWING, mode == Mode.STOPPING], [follow, 0.05], 0.0)
    rise = tension - before["tension_n"]
    speed = np.maximum(speed, 0.01 * (tension + 2.0 * rise - guard))
    mode = np.select(
        [
            (before["mode"] == Mode.STOPPING) & (tension < 3.0),
            (before["mode"] == Mode.STOPPED) & (tension > 6.0),
        ],
        [float(Mode.STOPPED), float(Mode.STOPPING)],
        before["mode"],
    )
    return np.clip(speed, -limit, limit), mode


@pytest.mark.parametrize("seed", range(5))
def test_the_modules_loops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bank, before = a_bank(rng)
    bank.step(DT_S, np.full(M, 20.0) + before["tension_tare_n"], np.zeros(M), np.zeros(M), 0)
    for name, row in before.items():  # the check, which has been made, is not due again for 5 ms
        getattr(bank, name)[:] = row
    load, encoder = before["tension_n"] + rng.normal(0.0, 5.0, M), rng.uniform(-0.1, 0.3, M)
    speed = bank.step(DT_S, load, encoder, np.zeros(M), CHECK_NS - 1)
    tension = load - before["tension_tare_n"]
    length = encoder - before["length_zero_m"]
    expected_speed, expected_mode = the_loops(before, tension, length)
    np.testing.assert_allclose(speed, expected_speed, rtol=0.0, atol=1e-12)
    np.testing.assert_array_equal(bank.mode, expected_mode)
    np.testing.assert_array_equal(bank.tension_n, tension)
    np.testing.assert_array_equal(bank.length_m, length)
    for name in set(ROWS) - {"mode", "tension_n", "length_m"}:
        np.testing.assert_array_equal(getattr(bank, name), before[name])


@pytest.mark.parametrize(
    ("row", "value", "tension_n", "bits", "tripped"),
    [
        ("derating", 1.0, 20.0, 0, 0.0),
        ("watchdog_s", 0.1, 20.0, 0, 1.0),
        ("temperature_limit_degc", 20.0, 20.0, HardwareError.OVERHEATING, 0.0),
        ("tension_limit_n", 10.0, 25.0, HardwareError.LOAD_CELL, 0.0),
        ("tension_limit_n", 10.0, -26.0, HardwareError.LOAD_CELL, 0.0),
        ("overload_s", 0.2, 151.0, HardwareError.OVERLOAD, 0.0),
    ],
)
def test_what_is_odd_is_seen_in_any_muscle(
    row: str, value: float, tension_n: float, bits: int, tripped: float
) -> None:
    bank = MuscleBank()
    for index in range(3):
        bank.add()
        bank.set_torque(index, True)
    getattr(bank, row)[1] = value
    load = np.array([20.0, tension_n, 20.0])
    bank.step(DT_S, load, np.zeros(3), np.full(3, 25.0), 200_000_000)
    assert bank.hardware_error.tolist() == [0, bits, 0]
    assert bank.tripped.tolist() == [0.0, tripped, 0.0]


def test_winding_motors() -> None:
    rng = np.random.default_rng(0)
    drive = WireDrive(M, 0.25, USUAL)
    drive.speed_m_s[:] = before = rng.uniform(-0.25, 0.25, M)
    command, tension = rng.uniform(-0.3, 0.3, M), rng.uniform(0.0, 500.0, M)
    drive.peak_speed_m_s[:] = 0.1
    drive.peak_tension_n[:] = 100.0
    before_m = np.full(M, 0.3)
    wire_m = before_m.copy()
    drive.step(DT_S, command, tension, wire_m)
    speed = before + (command - before) * DT_S / (USUAL.motor_lag_s + DT_S)
    speed = np.clip(speed, -0.25 * np.maximum(1.0 - tension / USUAL.stall_tension_n, 0.0), 0.25)
    np.testing.assert_allclose(drive.speed_m_s, speed, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(wire_m - before_m, speed * DT_S, rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(drive.peak_speed_m_s, np.maximum(np.abs(speed), 0.1), atol=1e-12)
    np.testing.assert_array_equal(drive.peak_tension_n, np.maximum(tension, 100.0))


def test_elastic_elements_and_friction_at_the_guides() -> None:
    rng = np.random.default_rng(0)
    path, wire = rng.uniform(0.295, 0.315, M), np.full(M, 0.3)
    stiffness = rng.choice([0.0, 1.0, 2.0], M)
    tension, friction = np.empty(M), np.empty(M)
    stretch_wires(path, wire, stiffness, *CURVE, 0.2, tension, friction)
    e = np.maximum(path - wire, 0.0)
    expected = (CURVE[0] * e + CURVE[1] * e**2 + CURVE[2] * e**3) * stiffness
    np.testing.assert_allclose(tension, expected, rtol=1e-12)
    np.testing.assert_allclose(friction, 0.2 * expected, rtol=1e-12)


def test_arrays_of_another_size_are_refused() -> None:
    with pytest.raises(IndexError):
        WireDrive(3, 0.25, USUAL).step(DT_S, np.zeros(2), np.zeros(3), np.zeros(3))


def test_where_machine_code_cannot_be_kept_it_is_made_each_time() -> None:
    space: dict[str, Any] = {}
    exec("def total(x, y, n):\n    return x[0] + y * n\n", space)  # stands in no file
    total = compiled(VECTOR, NUMBER, INTEGER)(space["total"])
    assert total(np.array([1.0]), 0.5, 3) == 2.5
