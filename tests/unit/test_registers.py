"""The control table holds together, and both ways through it agree."""

from __future__ import annotations

from itertools import pairwise
from struct import error as StructError  # noqa: N812

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.wire.registers import (
    BY_NAME,
    GOAL_BLOCK,
    GOALS,
    PRESENT_BLOCK,
    PRESENTS,
    TABLE,
    Kind,
    Register,
    block,
)

# emanual.robotis.com/docs/en/dxl/x/xm430-w210: what foreign clients read without knowing us
X_SERIES = {
    "model_number": (0, 2),
    "model_information": (2, 4),
    "firmware_version": (6, 1),
    "id": (7, 1),
    "baud_rate": (8, 1),
    "return_delay": (9, 1),
    "temperature_limit": (31, 1),
    "torque_enable": (64, 1),
    "led": (65, 1),
    "status_return_level": (68, 1),
    "hardware_error": (70, 1),
    "bus_watchdog": (98, 1),
    "present_position": (132, 4),
    "present_temperature": (146, 1),
}


@pytest.mark.parametrize("name", X_SERIES)
def test_lies_where_the_x_series_has_it(name: str) -> None:
    assert (BY_NAME[name].address, BY_NAME[name].size) == X_SERIES[name]


@pytest.mark.parametrize("kind", Kind)
def test_no_two_registers_of_a_module_overlap(kind: Kind) -> None:
    rows = sorted((r.address, r.size, r.name) for r in TABLE if kind in r.kinds)
    for (address, size, name), (following, _, other) in pairwise(rows):
        assert address + size <= following, f"{name} runs into {other}"


@pytest.mark.parametrize("register", TABLE, ids=lambda r: r.name)
def test_defaults_and_limits_fit_the_register(register: Register) -> None:
    bits = 8 * register.size
    lowest, highest = (-(1 << bits - 1), 2 ** (bits - 1) - 1) if register.signed else (0, 2**bits)
    assert lowest <= register.default <= highest
    assert lowest <= register.low <= register.default <= register.high
    assert len(register.encode(register.default * register.scale)) == register.size


def test_literal_bytes() -> None:
    goals = {"bias_tension": 12.34, "stiffness": 20_000.0, "target_length": -0.001}
    assert GOAL_BLOCK.encode(goals).hex(" ") == "d2 04 20 4e 18 fc ff ff"
    present = PRESENT_BLOCK.decode(bytes.fromhex("18fcffff d204 fa00 21"))
    assert present == pytest.approx(
        {
            "present_length": -0.001,
            "present_tension": 12.34,
            "motor_temperature": 25.0,
            "status": 33,
        }
    )
    assert (GOAL_BLOCK.address, GOAL_BLOCK.length) == (720, 8)
    assert (PRESENT_BLOCK.address, PRESENT_BLOCK.length) == (740, 9)


@given(st.integers(0, 40_000), st.integers(0, 60_000), st.integers(-(2**31), 2**31 - 1))
def test_a_block_says_what_its_registers_say(bias: int, stiffness: int, target: int) -> None:
    raw = {"bias_tension": bias, "stiffness": stiffness, "target_length": target}
    values = {name: count * BY_NAME[name].scale for name, count in raw.items()}
    data = b"".join(register.encode(values[register.name]) for register in GOALS)
    assert GOAL_BLOCK.encode(values) == data
    assert GOAL_BLOCK.decode(data) == values


@given(st.binary(min_size=9, max_size=9))
def test_a_block_reads_what_its_registers_read(data: bytes) -> None:
    values = PRESENT_BLOCK.decode(data)
    for register in PRESENTS:
        at = register.address - PRESENT_BLOCK.address
        assert values[register.name] == register.decode(data[at:])


def test_a_value_too_large_is_an_error() -> None:
    with pytest.raises(OverflowError):
        BY_NAME["bias_tension"].encode(700.0)
    with pytest.raises(StructError):
        GOAL_BLOCK.encode({"bias_tension": 700.0, "stiffness": 0.0, "target_length": 0.0})


def test_a_block_has_no_gaps() -> None:
    with pytest.raises(ValueError, match="led"):
        block("id", "led")
