"""What the dashboard shows of a robot: messages in; plots, lanes, log and a moving body out.

A logic like any other (`runtime/logic.py`), but that it draws on a canvas. It keeps what came
since it last drew and no more, so nothing grows however long the robot runs.
"""

from __future__ import annotations

from collections.abc import Iterable

from dashboard.canvas import Canvas
from dashboard.plots import Plots
from dashboard.scene import Scene, Skeleton
from dashboard.story import Story
from runtime import messages as m
from runtime.settings import RobotSettings

DRAW_NS = 100_000_000
FRAME_NS = 66_000_000


class Stream:
    """Draws one robot. `url`, where the picture can be watched, is announced once."""

    inputs: tuple[type[m.Message], ...] = (
        m.ChainState,
        m.JointState,
        m.JointEstimate,
        m.ChainBody,
        m.HandState,
        m.ExecutiveState,
        m.TrainingProgress,
        m.SchemaVersion,
        m.GroupState,
        m.Event,
        m.Clock,
        m.Health,
    )
    requests: tuple[type[m.Message], ...] = ()
    period_ns = DRAW_NS

    def __init__(
        self,
        settings: RobotSettings,
        canvas: Canvas,
        body: Skeleton | None = None,
        url: str = "",
    ) -> None:
        self._plots = Plots(settings, canvas)
        self._story = Story(canvas)
        self._scene = Scene(settings, canvas, body, self._plots.muscles) if body else None
        self._url = url
        self._drawn_ns = self._framed_ns = -DRAW_NS

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in one message."""
        self._plots.receive(message, now_ns)
        self._story.receive(message, now_ns)
        if self._scene:
            self._scene.receive(message, now_ns)

    def answer(self, request: m.Message, now_ns: int) -> m.Reply:
        """Nobody asks the dashboard anything."""
        return m.Reply(ok=False, text="viz answers no requests")

    def tick(self, now_ns: int) -> Iterable[m.Message]:
        """Keep a row of what is newest, and draw when it is time."""
        self._plots.sample(now_ns)
        if _due(now_ns, self._drawn_ns, DRAW_NS):
            self._drawn_ns = now_ns
            self._plots.draw()
            self._story.draw(now_ns)
        if self._scene and _due(now_ns, self._framed_ns, FRAME_NS):
            self._framed_ns = now_ns
            self._scene.draw(now_ns)
        if not self._url:
            return ()
        url, self._url = self._url, ""
        return (
            m.Event(
                stamp_ns=now_ns,
                process="viz",
                level="info",
                kind="viewer",
                text=f"live view at {url}",
                data={"url": url},
            ),
        )


def _due(now_ns: int, last_ns: int, every_ns: int) -> bool:
    """Time for the next; also when the clock was set back."""
    return not last_ns <= now_ns < last_ns + every_ns
