"""Every curve of the dashboard: one vector a signal, with the muscles in fixed slots.

A muscle that is plugged while the robot runs takes a free slot; one that is gone or silent reads
NaN, which leaves a gap in its line. So the layout never has to change.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dashboard.canvas import Canvas
from dashboard.palette import CONFIDENCE, ESTIMATED, LIMIT, MEASURED, REFERENCE, Rgb, slot_color
from dashboard.tracks import Slots, Track
from runtime import messages as m
from runtime.settings import RobotSettings

FAST_NS = 10_000_000
SLOW_NS = 500_000_000
STALE_NS = 500_000_000  # who was silent for this long reads NaN
LIMIT_FROM = 0.5  # of the tension limit: below, its line would only flatten the others
ODD_ANOMALY = 3.0
MAX_PROCESSES = 16
MANY = 8  # muscles; of more, those with which the spare shares its work are shown by themselves


class Plots:
    """Takes the newest of every signal and draws it as rows."""

    def __init__(self, settings: RobotSettings, canvas: Canvas) -> None:
        self._canvas = canvas
        self._tension_limit_n = settings.module.tension_limit_n
        self._joints = settings.joints
        self.muscles = Slots(max(16, 2 * len(settings.muscle)), settings.muscles)
        self.processes = Slots(MAX_PROCESSES)
        self._tracks: dict[str, Track] = {}
        self._chains: dict[str, m.ChainState] = {}
        self._reference: dict[str, float] = {}
        self._estimate: m.JointEstimate | None = None
        self._health: dict[str, m.Health] = {}
        self._factor = math.nan
        for path in ("/tension", "/length_error", "/planned", "/anomaly"):
            self._track(path)
        self._track("/temperature", SLOW_NS)
        self._name_muscles()
        self._alike = settings.alike if len(settings.muscles) > MANY else ()
        if self._alike:
            widths = [1.5] * (len(self._alike) - 1) + [3.0]
            colors = [slot_color(slot) for slot in range(len(self._alike))]
            self._track("/role", FAST_NS, self._alike, colors, widths)
        for joint in self._joints:
            self._track(
                f"/angle/{joint}",
                FAST_NS,
                ("reference", "measured", "estimated from wires", "± confidence", "± confidence"),
                (REFERENCE, MEASURED, ESTIMATED, CONFIDENCE, CONFIDENCE),
                (1.5, 2.5, 1.5, 0.6, 0.6),
            )
        self._track("/limit/tension", FAST_NS, ("limit",), (LIMIT,))
        self._track("/limit/zero", SLOW_NS, ("zero",), (REFERENCE,), (0.5,))
        self._track("/limit/anomaly", SLOW_NS, ("odd above",), (LIMIT,))
        self._track(
            "/training",
            1,
            ("all", "new muscle", "old muscles"),
            (REFERENCE, ESTIMATED, MEASURED),
        )
        self._track("/load/cpu", SLOW_NS)
        self._track("/load/memory", SLOW_NS)
        self._track("/factor", SLOW_NS, ("real-time factor",), (MEASURED,))

    def _track(
        self,
        path: str,
        every_ns: int = FAST_NS,
        names: Sequence[str] = (),
        colors: Sequence[Rgb] = (),
        widths: Sequence[float] = (),
    ) -> None:
        self._tracks[path] = Track(path, every_ns)
        if names:
            self._canvas.lines(path, names, colors, widths or [1.5] * len(names))

    def _name_muscles(self) -> None:
        names, colors = self.muscles.labels()
        for path in ("/tension", "/length_error", "/temperature", "/planned", "/anomaly"):
            self._canvas.lines(path, names, colors, [1.5] * self.muscles.size)

    def _meet(self, muscles: Sequence[str]) -> None:
        if self.muscles.take(muscles):
            self._name_muscles()

    def receive(self, message: m.Message, now_ns: int) -> None:
        """Take in one message; what is not plotted is passed over."""
        match message:
            case m.ChainState():
                self._meet(message.muscles)
                self._chains[message.chain] = message
            case m.JointState():
                self._sample_angles(message)
            case m.JointEstimate():
                self._meet(message.muscles)
                self._estimate = message
                self._sample_anomaly(message)
            case m.ExecutiveState():
                self._meet(message.muscles)
                self._reference = dict(zip(message.joints, message.reference_rad, strict=False))
                self._sample_plan(message)
            case m.TrainingProgress():
                self._sample_training(message, message.stamp_ns or now_ns)
            case m.Health():
                if self.processes.take((message.process,)):
                    names, colors = self.processes.labels()
                    for path in ("/load/cpu", "/load/memory"):
                        self._canvas.lines(path, names, colors, [1.5] * self.processes.size)
                if message.process in self.processes.index:
                    self._health[message.process] = message
            case m.Clock():
                self._factor = message.real_time_factor

    def sample(self, now_ns: int) -> None:
        """Keep one row of the muscles when one is due: all chains together in one row."""
        fresh = [c for c in self._chains.values() if now_ns - c.stamp_ns < STALE_NS]
        stamp_ns = max((c.stamp_ns for c in fresh), default=now_ns)
        if self._chains and self._tracks["/tension"].due(stamp_ns):
            self._sample_muscles(fresh, stamp_ns)
        if self._tracks["/factor"].due(now_ns):
            self._sample_load(now_ns)

    def draw(self) -> None:
        """Draw all rows that wait."""
        for track in self._tracks.values():
            track.draw(self._canvas)

    def _sample_muscles(self, chains: Sequence[m.ChainState], stamp_ns: int) -> None:
        tension, error = self.muscles.empty(), self.muscles.empty()
        for chain in chains:
            self.muscles.fill(tension, chain.muscles, chain.tension_n)
            pairs = zip(chain.target_length_m, chain.length_m, strict=False)
            self.muscles.fill(
                error, chain.muscles, (target - length for target, length in pairs), 1e3
            )
        self._tracks["/tension"].add(stamp_ns, tension)
        if self._alike:
            felt = {n: f for c in chains for n, f in zip(c.muscles, c.tension_n, strict=False)}
            row = np.array([felt.get(name, math.nan) for name in self._alike])
            self._tracks["/role"].add(stamp_ns, row)
        self._tracks["/length_error"].add(stamp_ns, error)
        near = np.nanmax(tension, initial=0.0) > LIMIT_FROM * self._tension_limit_n
        limit = self._tension_limit_n if near else math.nan
        self._tracks["/limit/tension"].add(stamp_ns, np.array([limit]))
        if self._tracks["/temperature"].due(stamp_ns):
            self._tracks["/limit/zero"].add(stamp_ns, np.zeros(1))  # else noise fills the plot
            temperature = self.muscles.empty()
            for chain in chains:
                self.muscles.fill(temperature, chain.muscles, chain.temperature_degc)
            self._tracks["/temperature"].add(stamp_ns, temperature)

    def _sample_angles(self, state: m.JointState) -> None:
        measured = dict(zip(state.joints, state.angle_rad, strict=False))
        estimate = self._estimate
        estimated: dict[str, tuple[float, float]] = {}
        if estimate and abs(state.stamp_ns - estimate.stamp_ns) < STALE_NS:
            pairs = zip(estimate.angle_rad, estimate.confidence_rad, strict=False)
            estimated = dict(zip(estimate.joints, pairs, strict=False))
        for joint in self._joints:
            track = self._tracks[f"/angle/{joint}"]
            if joint not in measured or not track.due(state.stamp_ns):
                continue
            angle, spread = estimated.get(joint, (math.nan, math.nan))
            row = (
                self._reference.get(joint, math.nan),
                measured[joint],
                angle,
                angle + spread,
                angle - spread,
            )
            track.add(state.stamp_ns, np.rad2deg(row))

    def _sample_anomaly(self, estimate: m.JointEstimate) -> None:
        if self._tracks["/anomaly"].due(estimate.stamp_ns):
            row = self.muscles.empty()
            self.muscles.fill(row, estimate.muscles, estimate.anomaly)
            self._tracks["/anomaly"].add(estimate.stamp_ns, row)
        if self._tracks["/limit/anomaly"].due(estimate.stamp_ns):
            self._tracks["/limit/anomaly"].add(estimate.stamp_ns, np.array([ODD_ANOMALY]))

    def _sample_plan(self, executive: m.ExecutiveState) -> None:
        if executive.muscles and self._tracks["/planned"].due(executive.stamp_ns):
            row = self.muscles.empty()
            self.muscles.fill(row, executive.muscles, executive.planned_tension_n)
            self._tracks["/planned"].add(executive.stamp_ns, row)

    def _sample_training(self, progress: m.TrainingProgress, stamp_ns: int) -> None:
        row = np.full(3, math.nan)  # so a new job's line does not join the last one's
        if progress.stage == "training":
            losses = (progress.loss, progress.loss_new, progress.loss_old)
            row = np.array([math.log10(x) if x > 0.0 else math.nan for x in losses])
        self._tracks["/training"].add(stamp_ns, row)

    def _sample_load(self, now_ns: int) -> None:
        cpu, memory = self.processes.empty(), self.processes.empty()
        names = list(self._health)
        self.processes.fill(cpu, names, (h.cpu_percent for h in self._health.values()))
        self.processes.fill(memory, names, (h.memory_mb for h in self._health.values()))
        for path, row in (("/load/cpu", cpu), ("/load/memory", memory)):
            self._tracks[path].add(now_ns, row)
        self._tracks["/factor"].add(now_ns, np.array([self._factor]))
