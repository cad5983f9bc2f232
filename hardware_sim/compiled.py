"""Compiles what runs for every wire in every millisecond: the only file that imports numba.

A compiled function is a loop over wires whose body reads as the equations. Machine code is kept in
`__pycache__` beside the file that the function stands in, and made anew when that file changes. So
each constant that a function uses has to stand in its own file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np

Function = TypeVar("Function", bound=Callable[..., Any])

NUMBER = numba.float64
INTEGER = numba.int64
VECTOR = numba.float64[:]
BLOCK = numba.float64[:, :, ::1]


def records(dtype: np.dtype[np.void]) -> Any:
    """Type of a contiguous array of such records."""
    return numba.from_dtype(dtype)[::1]


def compiled(*arguments: Any) -> Callable[[Function], Function]:
    """Compile a function for arguments of these types, as soon as it is defined."""

    def compile_(function: Function) -> Function:
        try:
            made = numba.njit(arguments, cache=True, boundscheck=True)(function)
        except (RuntimeError, OSError):  # nowhere to keep the machine code: each start compiles
            made = numba.njit(arguments, boundscheck=True)(function)
        return cast(Function, made)

    return compile_
