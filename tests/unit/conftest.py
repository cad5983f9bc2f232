"""What several unit tests begin with."""

from __future__ import annotations

import pytest

from runtime.settings import RobotSettings, load_robot
from tests.unit.paper_canvas import PaperCanvas


@pytest.fixture
def settings() -> RobotSettings:
    """The robot of the demo."""
    return load_robot("elbow")


@pytest.fixture
def canvas() -> PaperCanvas:
    """It only remembers what was drawn on it."""
    return PaperCanvas()
