"""Options of the benches."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--minutes", type=float, default=2.0, help="how long the picture's memory is watched"
    )
