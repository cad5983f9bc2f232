"""What the dashboard shows of a robot: messages in; plots, lanes, log and a moving body out.

A logic like any other (`runtime/logic.py`), but that it draws on a canvas. It keeps what came
since it last drew and no more, so nothing grows however long the robot runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from dashboard.angles import JointAngles
from dashboard.canvas import Canvas
from dashboard.charts import Learning, Sharing
from dashboard.plots import Plots
from dashboard.scene import Scene, Skeleton
from dashboard.story import Story
from runtime import messages as m
from runtime.settings import RobotSettings

Reader = Callable[[m.Message, int], None]

DRAW_NS = 170_000_000
FRAME_NS = 62_000_000


class Stream:
    """Draws one robot. `url`, where the picture can be watched on `host`, is announced once."""

    requests: tuple[type[m.Message], ...] = ()
    period_ns = DRAW_NS

    def __init__(
        self,
        settings: RobotSettings,
        canvas: Canvas,
        body: Skeleton | None = None,
        url: str = "",
        host: str = "",
    ) -> None:
        self._canvas = canvas
        self._plots = Plots(settings, canvas)
        self._angles = JointAngles(settings.joints, canvas)
        self._sharing = Sharing(self._plots.muscles, settings.module.tension_limit_n)
        self._learning = Learning()
        self._story = Story(canvas)
        self._scene = Scene(settings, canvas, body, self._plots.muscles) if body else None
        parts = (self._plots, self._angles, self._sharing, self._learning, self._story, self._scene)
        self._readers: dict[type[m.Message], list[Reader]] = {}
        for part in parts:
            if part is not None:
                for kind in part.inputs:
                    self._readers.setdefault(kind, []).append(part.receive)
        self.inputs = tuple(self._readers)
        self._url, self._host = url, host
        self._drawn_ns = self._framed_ns = -DRAW_NS

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in one message."""
        for reader in self._readers[type(message)]:
            reader(message, now_ns)

    def answer(self, request: m.Message, now_ns: int) -> m.Reply:
        """Nobody asks the dashboard anything."""
        return m.Reply(ok=False, text="viz answers no requests")

    def tick(self, now_ns: int) -> Iterable[m.Message]:
        """Draw when it is time."""
        if _due(now_ns, self._drawn_ns, DRAW_NS):
            self._drawn_ns = now_ns
            self._plots.draw(now_ns)
            self._angles.draw(now_ns)
            self._sharing.draw(self._canvas, now_ns)
            self._learning.draw(self._canvas, now_ns)
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
                data={"url": url, "host": self._host},
            ),
        )


def _due(now_ns: int, last_ns: int, every_ns: int) -> bool:
    """Time for the next; also when the clock was set back."""
    return not last_ns <= now_ns < last_ns + every_ns
