"""What commands share: one tool's place on a robot's bus."""

from __future__ import annotations

from typing import cast

from runtime import messages as m
from runtime.bus import Bus
from runtime.cli.client import Client
from runtime.hubs import Hub


def test_what_comes_together_is_gathered_together() -> None:
    """Late subscribers get fifty events at once: none is lost behind the first."""
    fifty = [m.Event(process="world", level="info", kind=f"k{n}", text="") for n in range(50)]

    class Box:
        def wait(self, timeout_s: float) -> list[m.Message]:
            return fifty

    client = Client(Hub(robot="elbow", pid=0, endpoint=""), cast(Bus, Box()))
    assert client.gather(lambda _: True, 1.0) == fifty
