"""What muscle modules remember, as one table: a row is a quantity, a column is a module.

The table lies in memory module by module, as `_run_loops` in `muscle_bank.py` goes through it.
"""

from __future__ import annotations

from struct import Struct
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROWS = {  # row of the table -> its value in a new module
    "bias_n": 0.0,
    "stiffness_n_m": 0.0,
    "target_length_m": 0.0,
    "tension_limit_n": 150.0,
    "winding_speed_limit_m_s": 0.25,
    "temperature_limit_degc": 80.0,
    "length_zero_m": 0.0,
    "tension_tare_n": 0.0,
    "spool_radius_m": 0.008,
    "tension_n": 0.0,
    "length_m": 0.0,
    "temperature_degc": 25.0,
    "mode": 0.0,
    "torque": 0.0,
    "stop": 0.0,
    "tripped": 0.0,
    "watchdog_s": 0.0,
    "heard_ns": 0.0,
    "hardware_error": 0.0,
    "derating": 1.0,
    "overload_s": 0.0,
    "peak_target_speed_m_s": 0.0,
    "target_since_ns": -1.0,
    "target_from_m": 0.0,
}
MUSCLE = np.dtype([(name, np.float64) for name in ROWS])


def picker(*names: str) -> Struct:
    """Unpacks these rows, which are in the order of `ROWS`, of one module from the memory."""
    return Struct("<" + "".join("d" if name in names else "8x" for name in ROWS))


class _Indexed(Protocol):
    index: int


class MuscleRows:
    """The table's rows as arrays of shape (M,), named as in `ROWS`; columns come and go.

    The arrays are views, and stale after `add` and `remove`.
    """

    bias_n: Array
    stiffness_n_m: Array
    target_length_m: Array
    tension_limit_n: Array
    winding_speed_limit_m_s: Array
    temperature_limit_degc: Array
    length_zero_m: Array
    tension_tare_n: Array
    spool_radius_m: Array
    tension_n: Array
    length_m: Array
    temperature_degc: Array
    mode: Array
    torque: Array
    stop: Array
    tripped: Array
    watchdog_s: Array
    heard_ns: Array
    hardware_error: Array
    derating: Array
    overload_s: Array
    peak_target_speed_m_s: Array
    target_since_ns: Array
    target_from_m: Array

    def __init__(self) -> None:
        self._holders: list[_Indexed] = []
        self._use(np.zeros(0, MUSCLE))

    def __len__(self) -> int:
        return len(self.bias_n)

    def add(self, **values: float) -> int:
        """One more module, torque off; `values` set rows by name. Returns its index."""
        column = tuple({**ROWS, **values}[name] for name in ROWS)
        self._use(np.append(self._table, np.array(column, MUSCLE)))
        return len(self) - 1

    def remove(self, index: int) -> None:
        """Take a module out; those behind it move up by one."""
        self._use(np.delete(self._table, index))
        self._holders = [holder for holder in self._holders if holder.index != index]
        for holder in self._holders:
            holder.index -= holder.index > index

    def bind(self, holder: _Indexed) -> None:
        """Keep `holder.index` right when modules are removed."""
        self._holders.append(holder)

    def column(self, index: int) -> dict[str, float]:
        """All that one module remembers, to be saved; see `set_column`."""
        return dict(zip(ROWS, self._table[index].tolist(), strict=True))

    def set_column(self, index: int, column: dict[str, Any]) -> None:
        """Give a module back what `column` saved."""
        self._table[index] = tuple(column[name] for name in ROWS)

    def _use(self, table: NDArray[np.void]) -> None:
        self._table = table
        self._memory = table.view(np.uint8).data
        for name in ROWS:
            setattr(self, name, table[name])
