"""The recorder's files: one after the other, so that a long run's index never fills the memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from runtime.messages import Event, Message
from runtime.runs import read_all, recordings
from runtime.settings import RobotSettings, load_robot
from services import recorder


class Bus:
    """Says one event each time it is looked at, four times."""

    def __init__(self) -> None:
        self.said = 0

    @property
    def stopping(self) -> bool:
        return self.said == 4

    def subscribe(self, *kinds: type[Message], every: bool = False) -> None:
        assert every
        assert Event in kinds

    def ready(self) -> None: ...

    def wait(self, timeout_s: float) -> list[Message]:
        self.said += 1
        return [Event(process="test", level="info", kind="said", text=str(self.said))]

    def now_ns(self) -> int:
        return self.said

    def beat(self, now_ns: int) -> None: ...


@dataclass
class Launch:
    """As much of a launch as the recorder asks for."""

    run_dir: Path
    settings: RobotSettings

    @contextmanager
    def open_bus(self) -> Iterator[Bus]:
        yield Bus()


@pytest.mark.parametrize(("segment_s", "files"), [(60.0, 1), (0.0, 4)])
def test_a_full_file_is_followed_by_the_next(
    segment_s: float, files: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "PACE_S", 0.0)
    monkeypatch.setattr(recorder, "SEGMENT_S", segment_s)
    recorder.main(Launch(tmp_path, load_robot("elbow")))  # type: ignore[arg-type]
    found = recordings(str(tmp_path))
    assert len(found) == files
    texts = [entry.message.text for entry in read_all(found) if isinstance(entry.message, Event)]
    assert texts == ["1", "2", "3", "4"]
