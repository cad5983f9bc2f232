"""What happened, for a person: state lanes, the log of events, and a few words on now."""

from __future__ import annotations

import math
from collections import deque

from dashboard.canvas import Canvas
from dashboard.palette import MODULE_COLORS, PROCESS_COLORS, STAGE_COLORS, Rgb
from runtime import messages as m
from runtime.growing import Growing

MAX_TEXTS = 256  # between two drawings; more is a storm, of which the last lines are kept
MAX_LANES = 128
_LEVELS = {"warning": "WARN", "error": "ERROR"}


class Story:
    """Turns states and events into lanes and lines; what did not change is not drawn again."""

    inputs = (
        m.ExecutiveState,
        m.ChainBody,
        m.GroupState,
        m.SchemaVersion,
        m.Event,
        m.TrainingProgress,
        m.Clock,
    )

    def __init__(self, canvas: Canvas) -> None:
        self._canvas = canvas
        self._lanes: dict[str, str] = {}
        self._bodies: dict[str, m.ChainBody] = {}
        self._growing = Growing()
        self._texts: deque[tuple[int, str, str]] = deque(maxlen=MAX_TEXTS)
        self._executive: m.ExecutiveState | None = None
        self._schema = ""
        self._factor = math.nan
        self._status = ""
        self._progress: m.TrainingProgress | None = None

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in one message of `inputs`."""
        before = self._growing.words
        self._growing.take(message)
        if self._growing.words != before or isinstance(message, m.SchemaVersion):
            for body in self._bodies.values():
                self._take_body(body, now_ns)
        match message:
            case m.ExecutiveState():
                self._executive = message
                self._lane("executive", message.stage, now_ns, STAGE_COLORS)
            case m.ChainBody():
                self._take_body(message, now_ns)
                self._bodies[message.chain] = message
            case m.GroupState():
                for row in message.processes:
                    self._lane(f"process/{row.process}", row.state, now_ns, PROCESS_COLORS)
            case m.SchemaVersion():
                muscles = len(message.muscles)
                self._schema = f"{message.version} ({message.method}, {muscles} muscles)"
            case m.Event():
                text = f"{message.process}: {message.text}"
                level = _LEVELS.get(message.level, "INFO")
                self._texts.append((message.stamp_ns or now_ns, text, level))
            case m.TrainingProgress():
                self._progress = message
            case m.Clock():
                self._factor = message.real_time_factor

    def draw(self, now_ns: int) -> None:
        """Draw the lines that wait, and the few words when they changed."""
        while self._texts:
            stamp_ns, text, level = self._texts.popleft()
            self._canvas.text(stamp_ns * 1e-9, text, level)
        status = self._words()
        if status != self._status:
            self._status = status
            self._canvas.status(now_ns * 1e-9, status)

    def _take_body(self, body: m.ChainBody, now_ns: int) -> None:
        before = self._bodies.get(body.chain, body).modules
        named = {module.name: module for module in body.modules if module.name}
        for name in {module.name for module in before if module.name} - named.keys():
            self._lane(f"module/{name}", "unplugged", now_ns, MODULE_COLORS)
        for name, module in named.items():
            state = self._growing.standing(module) or module.state
            self._lane(f"module/{name}", state, now_ns, MODULE_COLORS)

    def _lane(self, name: str, state: str, now_ns: int, colors: dict[str, Rgb]) -> None:
        if self._lanes.get(name) == state:
            return
        if name not in self._lanes:
            if len(self._lanes) >= MAX_LANES:
                return
            self._canvas.lane(f"/{name}", colors)
        self._lanes[name] = state
        self._canvas.state(f"/{name}", now_ns * 1e-9, state)

    def _words(self) -> str:
        executive = self._executive
        if executive is None:
            return "## waiting for the executive"
        step = f" {executive.step}/{executive.steps}" if executive.steps else ""
        title = f"## {executive.stage}{step}"
        lines = []
        if self._growing.words:
            lines.append(self._growing.words)
        elif executive.task:
            lines.append(f"task **{executive.task}**")
        if self._progress and self._progress.stage == "training":
            lines.append(f"relearning: epoch {self._progress.epoch} of {self._progress.epochs}")
        if self._schema:
            lines.append(f"schema {self._schema}")
        if executive.text:
            lines.append(executive.text)
        if not math.isnan(self._factor):
            lines.append(f"{self._factor:.1f} x real time")
        return f"{title}\n\n" + " · ".join(lines)
