"""A script's view of a live group, where no world tells robot time."""

from __future__ import annotations

import time
from pathlib import Path
from typing import cast

import pytest

from experiments.live import LiveSession
from experiments.session import SessionError
from runtime import messages as m
from runtime.bus import Bus
from runtime.settings import find_robot_file, load_robot


class Line:
    """A bus on which, after some looks, one message comes."""

    def __init__(self, after: int) -> None:
        self.after = after

    def wait(self, timeout_s: float) -> list[m.Message]:
        self.after -= 1
        return [m.JointState(source="arm", joints=(), angle_rad=())] if self.after == 0 else []


def session(folder: Path, after: int) -> LiveSession:
    shipped = find_robot_file("elbow")
    text = shipped.read_text().replace('"../', f'"{shipped.parent}/../')
    file = folder / "real.toml"
    file.write_text(text.replace('"sim:"', '"serial:///dev/ttyUSB0"'))
    bus = cast(Bus, Line(after))
    return LiveSession(load_robot(str(file)), bus, speed=1.0, say=lambda line: None)


def test_robot_time_is_the_hosts(tmp_path: Path) -> None:
    live = session(tmp_path, after=2)
    before_ns = time.monotonic_ns()
    live.wait(lambda message: True, 10.0, "a message")
    assert before_ns <= live.now_ns <= time.monotonic_ns()


def test_patience_ends_by_the_hosts_clock(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="a message did not come about within 0 s"):
        session(tmp_path, after=-1).wait(lambda message: True, 0.05, "a message")
