"""What the page shows of a robot: messages in, sections of plain data out.

A section is what changes together, so that what stands still is not sent again. Angles are in
degrees here, for the eye; on the bus they are in radians. Time that passes without a word is wall
time, as it is told to `receive` and `sections`: a dead robot has no robot time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

from dashboard.web.rows import module_row, process_row, version_row, words_of_link
from runtime import messages as m
from runtime.body_names import read_body
from runtime.growing import Growing
from runtime.hubs import Hub
from runtime.limits import HOT, WARM
from runtime.settings import RobotSettings

EVENTS = 60  # that are shown, and kept
SILENT_S = 1.0  # without readings: a chain counts as silent
STALE_S = 0.5  # an estimate that is older is not shown
RESET = "press 'Reset: hold where the arm is' to go on"
GROUP_SILENT_S = 4.0  # without the supervisor's table
SLOW_S = 1.0  # between two looks at what only time changes

Section = tuple[str, dict[str, object]]


class Picture:
    """The newest of everything, as sections.

    Attributes:
        viewer_url: where viz serves its stream, once it has said so and if that is this host.
        versions_stale: the retrainer should be asked for its versions.
    """

    inputs: tuple[type[m.Message], ...] = (
        m.Clock,
        m.GroupState,
        m.Health,
        m.ChainBody,
        m.ChainState,
        m.JointState,
        m.JointEstimate,
        m.ExecutiveState,
        m.TrainingProgress,
        m.SchemaVersion,
        m.SchemaCandidate,
        m.SchemaVerdict,
        m.Event,
    )

    def __init__(self, settings: RobotSettings, simulated: bool, host: str = "") -> None:
        self.viewer_url = ""
        self._host = host
        self._viewer_host = ""
        self.versions_stale = True
        self._settings = settings
        self._simulated = simulated
        self._ranges = read_body(settings.body_file).joints
        self._clock: m.Clock | None = None
        self._group: m.GroupState | None = None
        self._executive: m.ExecutiveState | None = None
        self._progress: m.TrainingProgress | None = None
        self._schema: m.SchemaVersion | None = None
        self._estimate: m.JointEstimate | None = None
        self._estimate_s = -math.inf  # when it came, in wall time
        self._growing = Growing()
        self._health: dict[str, m.Health] = {}
        self._bodies: dict[str, m.ChainBody] = {}
        self._states: dict[str, m.ChainState] = {}
        self._heard_s: dict[str, float] = {}  # chain, or "" for the group -> wall time
        self._measured_rad: dict[str, float] = {}
        self._rows: Sequence[m.VersionRow] = ()
        self._events: list[m.Event] = []  # as they happened
        self._viewers = 0
        self._changed = {"robot", "processes", "chains", "executive", "schema", "events"}
        self._slow_due_s = 0.0

    def receive(self, message: m.Message, now_s: float) -> None:
        """Take in one message of `inputs`.

        Raises:
            ValueError: it contradicts itself; nothing of it is kept.
        """
        self._take_growing(message)
        match message:
            case m.Clock():
                self._clock = message
            case m.GroupState():
                self._group = message
                self._heard_s[""] = now_s
                self._changed.add("processes")
            case m.Health():
                self._health[message.process] = message
                self._changed.add("processes")
            case m.ChainBody():
                self._bodies[message.chain] = message
                self._changed.add("chains")
            case m.ChainState():
                _check_even(message)
                self._states[message.chain] = message
                self._heard_s[message.chain] = now_s
            case m.JointState():
                self._measured_rad.update(zip(message.joints, message.angle_rad, strict=True))
            case m.JointEstimate():
                self._estimate, self._estimate_s = message, now_s
            case m.ExecutiveState():
                self._executive = message
                self._changed.add("executive")
            case m.TrainingProgress():
                self._progress = message
                self._changed.add("executive")
            case m.SchemaCandidate() | m.SchemaVerdict():
                self.versions_stale = True
            case m.SchemaVersion():
                self._schema = message
                self.versions_stale = True
                self._changed |= {"schema", "chains"}
            case m.Event():
                self._take_event(message)

    def take_versions(self, rows: Sequence[m.VersionRow]) -> None:
        """What the retrainer has kept."""
        self._rows = rows
        self._changed.add("schema")

    def sections(self, now_s: float, hubs: Mapping[str, tuple[Hub, str]]) -> Iterator[Section]:
        """What may have changed since it was last asked for.

        Args:
            now_s: wall time.
            hubs: the robots of this host by name, each with its page's address.
        """
        if now_s >= self._slow_due_s:
            self._slow_due_s = now_s + SLOW_S
            self._changed |= {"processes"}
            rows = [
                {"name": name, "started": hub.started, "address": address}
                for name, (hub, address) in hubs.items()
            ]
            yield "robots", {"here": self._settings.name, "robots": rows}
        changed, self._changed = self._changed, set()
        makers = {
            "robot": self._robot,
            "processes": lambda: self._processes(now_s),
            "chains": self._chains,
            "executive": self._doing,
            "schema": self._versions,
            "events": self._story,
        }
        for name, make in makers.items():
            if name in changed:
                yield name, make()
        yield "readings", self._readings(now_s)

    # ── sections ──────────────────────────────────────────────────────────────────────────────

    def _robot(self) -> dict[str, object]:
        settings = self._settings
        return {
            "name": settings.name,
            "simulated": self._simulated,
            "joints": [
                {"name": joint.name, "rest_deg": joint.rest_deg, **self._range(joint.name)}
                for joint in settings.joint
            ],
            "tasks": [{"name": t.name, "targets": len(t.targets_deg)} for t in settings.task],
            "muscles": [
                *({"name": row.name, "chain": row.chain} for row in settings.muscle),
                *({"name": row.name, "chain": row.chain} for row in settings.spare),
            ],
            "methods": m.METHODS,
            "growth": {"method": settings.growth.method, "n_new": settings.growth.n_new},
            "viewer": {
                "there": bool(self.viewer_url),
                "number": self._viewers,
                "host": self._viewer_host,
            },
        }

    def _range(self, joint: str) -> dict[str, float]:
        low, high = self._ranges.get(joint) or (-180.0, 180.0)
        return {"low_deg": round(low, 1), "high_deg": round(high, 1)}

    def _processes(self, now_s: float) -> dict[str, object]:
        group = self._group
        silent = now_s - self._heard_s.get("", -math.inf) > GROUP_SILENT_S
        return {
            "supervised": group is not None and not silent,
            "run_dir": group.run_dir if group else "",
            "rows": [process_row(row, self._health.get(row.process)) for row in group.processes]
            if group
            else [],
        }

    def _chains(self) -> dict[str, object]:
        limit_degc = self._settings.module.temperature_limit_degc
        return {
            "temperature_limit_degc": limit_degc,
            "warm": WARM,
            "hot": HOT,
            "chains": [
                {
                    "chain": chain.name,
                    "link": words_of_link(chain.link),
                    "modules": [
                        module_row(module, self._growing.standing(module))
                        for module in self._modules(chain.name)
                    ],
                }
                for chain in self._settings.chain
            ],
        }

    def _modules(self, chain: str) -> tuple[m.ModuleInfo, ...]:
        body = self._bodies.get(chain)
        return body.modules if body else ()

    def _doing(self) -> dict[str, object]:
        state, progress = self._executive, self._progress
        if state is None:
            return {"stage": "waiting", "text": "the executive has not spoken yet"}
        shown = ("stage", "task", "step", "steps", "settled", "schema_version", "text")
        doing: dict[str, object] = {name: getattr(state, name) for name in shown}
        doing["growth"] = self._growing.words
        if state.stage == "stopped":
            doing["text"] = RESET
        if state.stage == "relearn" and progress is not None:
            doing["training"] = {"epoch": progress.epoch, "epochs": progress.epochs}
        return doing

    def _versions(self) -> dict[str, object]:
        return {"rows": [version_row(row) for row in reversed(self._rows)]}

    def _story(self) -> dict[str, object]:
        return {
            "events": [
                {
                    "time_s": round(event.stamp_ns * 1e-9, 1),
                    "process": event.process,
                    "level": event.level,
                    "kind": event.kind,
                    "text": event.text,
                    "muscle": event.data.get("muscle", ""),
                }
                for event in reversed(self._events)
            ]
        }

    def _readings(self, now_s: float) -> dict[str, object]:
        clock = self._clock
        return {
            "time_s": round(clock.stamp_ns * 1e-9, 1) if clock else None,
            "real_time_factor": round(clock.real_time_factor, 2) if clock else None,
            "chains": {
                name: {
                    "silent": now_s - self._heard_s[name] > SILENT_S,
                    "mode": state.mode,
                    "muscles": {
                        muscle: [round(tension_n, 1), round(temperature_degc, 1)]
                        for muscle, tension_n, temperature_degc in zip(
                            state.muscles, state.tension_n, state.temperature_degc, strict=True
                        )
                    },
                }
                for name, state in self._states.items()
            },
            "joints": self._joints(now_s),
        }

    def _joints(self, now_s: float) -> dict[str, dict[str, float]]:
        found: dict[str, dict[str, float]] = {name: {} for name in self._settings.joints}
        state = self._executive
        estimate = self._estimate if now_s - self._estimate_s <= STALE_S else None
        columns: dict[str, tuple[Sequence[str], Sequence[float]]] = {
            "measured_deg": (tuple(self._measured_rad), tuple(self._measured_rad.values())),
            "estimated_deg": (estimate.joints, estimate.angle_rad) if estimate else ((), ()),
            "confidence_deg": (estimate.joints, estimate.confidence_rad) if estimate else ((), ()),
            "reference_deg": (state.joints, state.reference_rad) if state else ((), ()),
        }
        for quantity, (names, values) in columns.items():
            for name, value in zip(names, values, strict=False):  # no reference while it waits
                if name in found and math.isfinite(value):
                    found[name][quantity] = round(math.degrees(value), 1)
        return found

    # ── inside ────────────────────────────────────────────────────────────────────────────────

    def _take_growing(self, message: m.Message) -> None:
        before = self._growing.words
        self._growing.take(message)
        if before != self._growing.words:
            self._changed |= {"executive", "chains"}

    def _take_event(self, event: m.Event) -> None:
        # What happened before we came is told process by process.
        in_order = sorted([*self._events, event], key=lambda known: known.stamp_ns)
        self._events = in_order[-EVENTS:]
        self._changed.add("events")
        if event.kind == "viewer":
            self._viewer_host = event.data.get("host", self._host)
            here = self._viewer_host == self._host  # it serves on its host's loopback
            self.viewer_url = event.data.get("url", "") if here else ""
            self._viewers += 1
            self._changed.add("robot")


def _check_even(state: m.ChainState) -> None:
    lengths = len(state.muscles), len(state.tension_n), len(state.temperature_degc)
    if len(set(lengths)) > 1:
        what = "{} muscles, {} tensions and {} temperatures".format(*lengths)
        raise ValueError(f"chain '{state.chain}' tells of {what}")
