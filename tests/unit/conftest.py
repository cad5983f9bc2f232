"""What several unit tests begin with."""

from __future__ import annotations

import pytest

from runtime.settings import RobotSettings, load_robot
from tests.unit.driver_bench import Bench
from tests.unit.paper_canvas import PaperCanvas


@pytest.fixture
def settings() -> RobotSettings:
    """The robot of the demo."""
    return load_robot("elbow")


@pytest.fixture
def canvas() -> PaperCanvas:
    """It only remembers what was drawn on it."""
    return PaperCanvas()


@pytest.fixture
def bench() -> Bench:
    """A driver that has met its modules."""
    bench = Bench()
    bench.run(0.3)
    assert bench.events == []
    return bench
