"""The curves of muscles and processes: vectors with the muscles in fixed slots.

A muscle that is plugged while the robot runs takes a free slot; one that is gone or silent reads
NaN, which leaves a gap in its line. So the layout never has to change.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from dashboard.canvas import Canvas, Muscles
from dashboard.palette import LIMIT, MEASURED, REFERENCE, Rgb, slot_color
from dashboard.tracks import Rows, Slots, Track
from runtime import messages as m
from runtime.growing import Growing
from runtime.settings import RobotSettings

FAST_NS = 10_000_000
SLOW_NS = 1_000_000_000
STALE_NS = 500_000_000  # who was silent for this long reads NaN
ODD_ANOMALY = 3.0
FREE_SLOTS = 12  # for muscles that are plugged while the robot runs
MAX_PROCESSES = 24
MANY = 8  # muscles; of more, those with which the spare shares its work are shown by themselves
_TENSION, _PLANNED, _ERROR, _ANOMALY = range(4)


class Plots:
    """Takes the newest of every signal and draws it as rows."""

    inputs = (
        m.ChainState,
        m.JointEstimate,
        m.ExecutiveState,
        m.SchemaVersion,
        m.Event,
        m.Health,
        m.Clock,
    )

    def __init__(self, settings: RobotSettings, canvas: Canvas) -> None:
        self._canvas = canvas
        self._limit_n = settings.module.tension_limit_n
        self._limit_degc = settings.module.temperature_limit_degc
        self.muscles = Slots(max(16, len(settings.muscle) + FREE_SLOTS), settings.muscles)
        self._processes = Slots(MAX_PROCESSES)
        self._rows = Rows(self.muscles, FAST_NS, layers=4)
        self._tracks = {"/temperature": Track("/temperature", self.muscles, SLOW_NS)}
        self._name_muscles()
        alike = settings.alike if settings.role and len(settings.muscles) > MANY else ()
        if alike:
            widths = [1.5] * (len(alike) - 1) + [3.0]
            slots = [*settings.muscles, *(spare.name for spare in settings.spare)]
            colors = [slot_color(slots.index(name)) for name in alike]
            self._track("/role", FAST_NS, alike, colors, widths)
        for path in ("/load/cpu", "/load/memory"):
            self._tracks[path] = Track(path, self._processes, SLOW_NS)
        self._line("/limit/tension", f"limit {self._limit_n:g} N", LIMIT)
        self._line("/limit/temperature", f"limit {self._limit_degc:g} °C", LIMIT)
        self._line("/limit/anomaly", f"odd above {ODD_ANOMALY:g}", LIMIT)
        self._line("/limit/zero", "zero", REFERENCE, width=0.5)
        self._line("/factor", "robot time / wall time", MEASURED)
        self._chains: dict[str, m.ChainState] = {}
        self._estimate: m.JointEstimate | None = None
        self._executive: m.ExecutiveState | None = None
        self._growing = Growing()
        self._health: dict[str, m.Health] = {}
        self._factor = math.nan

    def _line(
        self, path: str, name: str, color: Rgb, every_ns: int = SLOW_NS, width: float = 1.5
    ) -> None:
        self._track(path, every_ns, (name,), (color,), (width,))

    def _track(
        self,
        path: str,
        every_ns: int,
        names: tuple[str, ...],
        colors: Sequence[Rgb],
        widths: Sequence[float],
    ) -> None:
        self._tracks[path] = Track(path, Slots(len(names), names), every_ns)
        self._canvas.lines(path, names, colors, widths)

    def _add(self, path: str, stamp_ns: int, value: float) -> None:
        """A row of a track that is one line."""
        track = self._tracks[path]
        track.add(stamp_ns, tuple(track.slots.index), (value,))

    def _name_muscles(self) -> None:
        names, colors = self.muscles.labels()
        for path in ("/muscle", "/temperature"):
            self._canvas.lines(path, names, colors, [1.5] * self.muscles.size)

    def _meet(self, muscles: tuple[str, ...]) -> None:
        if self.muscles.meet(muscles):
            self._name_muscles()

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in one message of `inputs`."""
        self._growing.take(message)
        match message:
            case m.ChainState():
                self._meet(message.muscles)
                self._chains[message.chain] = message
                if self._rows.due(message.stamp_ns):
                    self._sample_muscles(message.stamp_ns)
            case m.JointEstimate():
                self._meet(message.muscles)
                self._estimate = message
            case m.ExecutiveState():
                self._meet(message.muscles)
                self._executive = message
            case m.Health():
                if self._processes.take((message.process,)):
                    names, colors = self._processes.labels()
                    for path in ("/load/cpu", "/load/memory"):
                        self._canvas.lines(path, names, colors, [1.5] * self._processes.size)
                if message.process in self._processes.index:
                    self._health[message.process] = message
            case m.Clock():
                self._factor = message.real_time_factor

    def draw(self, now_ns: int) -> None:
        """Draw all rows that wait."""
        self._rows.gap(now_ns, STALE_NS)
        if self._tracks["/factor"].due(now_ns):
            self._sample_load(now_ns)
        if self._rows.waiting:
            times_s, rows = self._rows.take()
            self._canvas.muscles(times_s, Muscles(*rows))
        for track in self._tracks.values():
            track.draw(self._canvas)

    def _sample_muscles(self, stamp_ns: int) -> None:
        """All chains together in one row."""
        chains = [c for c in self._chains.values() if stamp_ns - c.stamp_ns < STALE_NS]
        rows, estimate, executive = self._rows, self._estimate, self._executive
        rows.begin(stamp_ns)
        for chain in chains:
            rows.put(chain.muscles, chain.tension_n, _TENSION)
        if executive and abs(stamp_ns - executive.stamp_ns) < STALE_NS:
            rows.put(executive.muscles, executive.planned_tension_n, _PLANNED)
        if estimate and abs(stamp_ns - estimate.stamp_ns) < STALE_NS:
            rows.put(estimate.muscles, self._length_errors_m(estimate), _ERROR)
            rows.put(estimate.muscles, estimate.anomaly, _ANOMALY)
        self._sample_by_chain("/role", chains, [chain.tension_n for chain in chains], stamp_ns)
        self._add("/limit/tension", stamp_ns, self._limit_n)
        degc = [chain.temperature_degc for chain in chains]
        self._sample_by_chain("/temperature", chains, degc, stamp_ns)
        self._add("/limit/temperature", stamp_ns, self._limit_degc)
        self._add("/limit/anomaly", stamp_ns, ODD_ANOMALY)
        self._add("/limit/zero", stamp_ns, 0.0)  # else noise fills the plot

    def _length_errors_m(self, estimate: m.JointEstimate) -> Sequence[float]:
        """Without that of a muscle that is being left out: of a torn wire it would be metres."""
        leaving = self._growing.leaving
        if leaving not in estimate.muscles:
            return estimate.length_error_m
        pairs = zip(estimate.muscles, estimate.length_error_m, strict=False)
        return [math.nan if name == leaving else error_m for name, error_m in pairs]

    def _sample_by_chain(
        self,
        path: str,
        chains: Sequence[m.ChainState],
        values: Sequence[Sequence[float]],
        stamp_ns: int,
    ) -> None:
        track = self._tracks.get(path)
        if track and track.due(stamp_ns):
            track.begin(stamp_ns)
            for chain, row in zip(chains, values, strict=True):
                track.put(chain.muscles, row)

    def _sample_load(self, now_ns: int) -> None:
        names, health = tuple(self._health), self._health.values()
        self._tracks["/load/cpu"].add(now_ns, names, [h.cpu_percent for h in health])
        self._tracks["/load/memory"].add(now_ns, names, [h.memory_mb for h in health])
        self._add("/factor", now_ns, self._factor)
