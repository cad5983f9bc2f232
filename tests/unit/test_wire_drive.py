"""The winding motors and elastic elements, against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from hardware_sim.wire_drive import (
    WireDrive,
    elastic_stretch_m,
    elastic_tension_n,
)
from runtime.settings import Simulation

USUAL = Simulation()
CURVE = (1000.0, 0.0, 7.5e7)
DT_S = 0.001


def run(drive: WireDrive, command: float, tension: float, steps: int) -> None:
    count = len(drive.speed_m_s)
    for _ in range(steps):
        drive.step(DT_S, np.full(count, command), np.full(count, tension), np.zeros(count))
        drive.warm(DT_S, np.full(count, tension))


@pytest.mark.parametrize(
    ("stretch_m", "tension_n"),
    [(-0.01, 0.0), (0.0, 0.0), (0.001, 1.075), (0.004, 8.8), (0.01, 85.0)],
)
def test_elastic_curve(stretch_m: float, tension_n: float) -> None:
    assert elastic_tension_n(stretch_m, *CURVE) == pytest.approx(tension_n, abs=1e-12)


def test_elastic_curve_has_a_quadratic_term_too() -> None:
    # 2 * 0.5 + 3 * 0.25 + 4 * 0.125
    assert elastic_tension_n(0.5, 2.0, 3.0, 4.0) == pytest.approx(2.25)


@pytest.mark.parametrize(
    ("tension_n", "stretch_m"), [(0.0, 0.0), (1.075, 0.001), (8.8, 0.004), (85.0, 0.01)]
)
def test_inverse_of_the_elastic_curve(tension_n: float, stretch_m: float) -> None:
    assert elastic_stretch_m(tension_n, CURVE) == pytest.approx(stretch_m, abs=1e-12)


@pytest.mark.parametrize("curve", [(2000.0, 0.0, 0.0), (2000.0, 1e5, 0.0), (500.0, 1e5, 3e7)])
def test_inverse_holds_for_curves_of_any_degree(curve: tuple[float, float, float]) -> None:
    for tension in (0.0, 0.5, 20.0, 150.0):
        stretch = elastic_stretch_m(tension, curve)
        assert elastic_tension_n(stretch, *curve) == pytest.approx(tension, abs=1e-9)


def test_speed_follows_its_command_with_a_lag() -> None:
    drive = WireDrive(1, 0.25, USUAL)
    wire_m = np.array([0.3])
    drive.step(DT_S, np.array([0.1]), np.zeros(1), wire_m)
    assert drive.speed_m_s[0] == pytest.approx(0.1 * DT_S / (USUAL.motor_lag_s + DT_S)) == 0.02
    assert wire_m[0] == pytest.approx(0.3 + 2e-5, abs=1e-12)
    run(drive, 0.1, 0.0, 3)
    assert drive.speed_m_s[0] == pytest.approx(0.1 * (1 - 0.8**4))
    run(drive, 0.1, 0.0, 100)
    assert drive.speed_m_s[0] == pytest.approx(0.1)


@pytest.mark.parametrize("command", [-9.0, 9.0])
def test_no_motor_is_faster_than_its_limit(command: float) -> None:
    drive = WireDrive(2, 0.25, USUAL)
    run(drive, command, 0.0, 200)
    assert drive.speed_m_s.tolist() == [pytest.approx(np.sign(command) * 0.25)] * 2


def test_winding_falls_with_tension_and_ends_at_stall_but_paying_out_does_not() -> None:
    stall_n = USUAL.stall_tension_n
    for tension, winding in ((0.0, 0.25), (stall_n / 2, 0.125), (2 * stall_n, 0.0)):
        drive = WireDrive(1, 0.25, USUAL)
        run(drive, -9.0, tension, 200)
        assert drive.speed_m_s[0] == pytest.approx(-winding)
        run(drive, 9.0, tension, 200)
        assert drive.speed_m_s[0] == pytest.approx(0.25)


def test_winding_warms_with_the_square_of_tension() -> None:
    drive = WireDrive(1, 0.25, USUAL)
    run(drive, 0.0, 60.0, 1)
    assert drive.temperature_degc[0] - 25.0 == pytest.approx(
        USUAL.heating_degc_n2 * 3600.0 * DT_S / USUAL.thermal_time_s
    )
    stronger = WireDrive(1, 0.25, Simulation(heating_degc_n2=USUAL.heating_degc_n2 / 4))
    run(stronger, 0.0, 120.0, 1)
    assert stronger.temperature_degc == pytest.approx(drive.temperature_degc)
    drive.temperature_degc[:] = 25.0 + 27.0  # where it rests at 60 N
    run(drive, 0.0, 60.0, 100)
    assert drive.temperature_degc[0] == pytest.approx(52.0)
    run(drive, 0.0, 0.0, round(USUAL.thermal_time_s / DT_S / 1000))
    assert drive.temperature_degc[0] == pytest.approx(25.0 + 27.0 * np.exp(-1e-3), abs=1e-4)


def test_a_motor_more_is_cold_and_still_and_one_fewer_leaves_the_others() -> None:
    drive = WireDrive(2, 0.25, USUAL)
    drive.step(DT_S, np.array([0.1, 0.2]), np.array([50.0, 90.0]), np.zeros(2))
    drive.warm(DT_S, np.array([50.0, 90.0]))
    speed, temperature = drive.speed_m_s.copy(), drive.temperature_degc.copy()
    drive.add()
    assert drive.speed_m_s.tolist() == [*speed, 0.0]
    assert drive.temperature_degc.tolist() == [*temperature, 25.0]
    drive.remove(0)
    assert drive.speed_m_s.tolist() == [speed[1], 0.0]
    assert drive.temperature_degc.tolist() == [temperature[1], 25.0]
