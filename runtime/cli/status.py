"""`myograft status`: who runs, who is plugged in, how they feel."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections import deque
from importlib.util import find_spec

import msgspec

from runtime import messages as m
from runtime.cli.client import Client, add_robot_argument, with_robot
from runtime.cli.main import DONE, NOT_RUNNING
from runtime.growing import Growing

LISTEN_S = 0.5  # at most: a simulated robot that is whole has told everything long before
WATCH_S = 1.0
RECENT = 6  # events kept
SILENT_S = 1.0  # of wall time without readings: a chain is silent
STALE_NS = 500_000_000  # an estimate that is older is none

Row = dict[str, object]


class Status:
    """Show a robot's processes, modules, task and schema.

    Examples:
      myograft status
      myograft status --watch
      myograft status --json | jq .modules
    """

    def configure(self, parser: argparse.ArgumentParser) -> None:
        """Add the arguments."""
        add_robot_argument(parser, first=True)
        parser.add_argument("--json", action="store_true", help="for programs")
        parser.add_argument("--watch", action="store_true", help="go on; Ctrl-C ends it")

    def run(self, args: argparse.Namespace) -> int:
        """Listen for a moment, then show."""
        return with_robot(args.robot, lambda client: _look(client, args))


def _look(client: Client, args: argparse.Namespace) -> int:
    picture = Picture(client.robot)
    client.bus.subscribe(*Picture.inputs, poll=args.watch)  # who looks on is woken by nobody
    client.gather(picture.take, LISTEN_S)
    if args.watch and not args.json and sys.stdout.isatty() and find_spec("rich"):
        from runtime.cli.live_status import watch

        return watch(client, picture)
    while True:
        if args.json:
            print(msgspec.json.encode(picture.as_dict()).decode(), flush=True)
        else:
            start = "\033[H\033[J" if args.watch and sys.stdout.isatty() else ""
            print(start + picture.as_text(), flush=True)
        if not args.watch:
            return DONE
        client.gather(lambda message: bool(picture.take(message) and False), WATCH_S)
        if not client.alive:
            print(f"{client.robot} has stopped", file=sys.stderr)
            return NOT_RUNNING


class Picture:
    """The newest message of each kind, put together."""

    inputs = (
        m.Clock,
        m.GroupState,
        m.Health,
        m.ChainBody,
        m.ChainState,
        m.ExecutiveState,
        m.SchemaVersion,
        m.JointState,
        m.JointEstimate,
        m.TrainingProgress,
        m.Event,
    )

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self.clock: m.Clock | None = None
        self.group: m.GroupState | None = None
        self.executive: m.ExecutiveState | None = None
        self.schema: m.SchemaVersion | None = None
        self.estimate: m.JointEstimate | None = None
        self.training: m.TrainingProgress | None = None
        self.growing = Growing()
        self.angle_rad: dict[str, float] = {}  # measured
        self.events: deque[m.Event] = deque(maxlen=RECENT)
        self.health: dict[str, m.Health] = {}
        self.bodies: dict[str, m.ChainBody] = {}
        self.states: dict[str, m.ChainState] = {}
        self._felt_s: dict[str, float] = {}  # chain -> wall time of its last readings

    def take(self, message: m.Message) -> bool:
        """Take in a message; True once everything is known that a living robot tells."""
        self.growing.take(message)
        match message:
            case m.Clock():
                self.clock = message
            case m.GroupState():
                self.group = message
            case m.ExecutiveState():
                self.executive = message
            case m.SchemaVersion():
                self.schema = message
            case m.Health():
                self.health[message.process] = message
            case m.ChainBody():
                self.bodies[message.chain] = message
            case m.ChainState():
                self.states[message.chain] = message
                self._felt_s[message.chain] = time.monotonic()
            case m.JointState():
                self.angle_rad |= zip(message.joints, message.angle_rad, strict=False)
            case m.JointEstimate():
                self.estimate = message
            case m.TrainingProgress():
                self.training = message
            case m.Event():
                self.events.append(message)
        return self._complete

    @property
    def _complete(self) -> bool:
        if self.group is None or self.clock is None or self.executive is None:
            return False
        ready = [row.process for row in self.group.processes if row.state == "ready"]
        healthy = all(process in self.health for process in ready)
        learned = self.schema is not None or not self.executive.schema_version
        felt = bool(self.states) and self.bodies.keys() == self.states.keys()
        placed = self.angle_rad.keys() >= set(self.executive.joints)
        estimated = self.schema is None or self.estimate is not None
        return healthy and learned and felt and placed and estimated

    def as_dict(self) -> dict[str, object]:
        """For `--json`."""
        return {
            "robot": self.robot,
            "ready": self.group is not None and self.group.ready,
            "run_dir": self.group.run_dir if self.group else "",
            "time_s": self.clock.stamp_ns / 1e9 if self.clock else None,
            "speed": self.clock.speed if self.clock else None,
            "real_time_factor": self.clock.real_time_factor if self.clock else None,
            "processes": self.processes(),
            "chains": self.chains(),
            "modules": self.modules(),
            "joints": self.joints(),
            "stage": self.executive.stage if self.executive else "",
            "task": self.executive.task if self.executive else "",
            "step": self.executive.step if self.executive else 0,
            "steps": self.executive.steps if self.executive else 0,
            "text": self.executive.text if self.executive else "",
            "schema_version": self.schema.version if self.schema else None,
            "schema_method": self.schema.method if self.schema else "",
        }

    def as_text(self) -> str:
        """For a person."""
        lines = [self._headline()]
        if self.executive and self.executive.text:
            lines.append(self.executive.text)
        lines += ["", *_table("process state restarts pid tick_hz cpu_% MB", self.processes())]
        lines += [f"\nchain {row['chain']}: {row['mode']}" for row in self.chains()]
        if modules := self.modules():
            told = [{**row, "state": row["standing"] or row["state"]} for row in modules]
            lines += ["", *_table("module kind chain id serial N degC link_errors state", told)]
        if joints := self.joints():
            lines += ["", *_table("joint wanted_deg measured_deg by_muscles_deg", _degrees(joints))]
        return "\n".join(lines)

    def _headline(self) -> str:
        parts = [self.robot, "ready" if self.group and self.group.ready else "not ready"]
        if self.executive:
            step = f" {self.executive.step}/{self.executive.steps}" if self.executive.steps else ""
            doing = f"{self.executive.task} {self.executive.stage}".strip()
            parts.append(f"{doing}{step}")
        if self.schema:
            parts.append(f"schema {self.schema.version} ({self.schema.method})")
        if self.clock:
            parts.append(
                f"{self.clock.stamp_ns / 1e9:.1f} s, real-time factor "
                f"{self.clock.real_time_factor:.2f} of {self.clock.speed:g}"
            )
        return "  |  ".join(parts)

    def processes(self) -> list[Row]:
        """One row a process."""
        rows = []
        for row in self.group.processes if self.group else ():
            health = self.health.get(row.process)
            rows.append(
                {
                    "process": row.process,
                    "state": row.state,
                    "restarts": row.restarts,
                    "pid": row.pid,
                    "tick_hz": round(health.tick_hz, 1) if health else None,
                    "cpu_%": round(health.cpu_percent, 1) if health else None,
                    "MB": round(health.memory_mb) if health else None,
                    "dropped": health.dropped if health else None,
                    "last_exit": row.last_exit,
                }
            )
        return rows

    def chains(self) -> list[Row]:
        """One row a chain, and what its driver does with it; `silent` if nothing is felt there."""
        now_s = time.monotonic()
        rows: list[Row] = []
        for chain in sorted({**self.bodies, **self.states}):
            heard = now_s - self._felt_s.get(chain, -SILENT_S) < SILENT_S
            rows.append({"chain": chain, "mode": self.states[chain].mode if heard else "silent"})
        return rows

    def joints(self) -> list[Row]:
        """One row a joint [rad]: where it shall be, was measured and is felt to be, or None."""
        executive, estimate = self.executive, self._estimate_that_counts()
        wanted = _by_joint(executive, "reference_rad")
        felt, wide = (_by_joint(estimate, name) for name in ("angle_rad", "confidence_rad"))
        return [
            {
                "joint": joint,
                "wanted_rad": wanted.get(joint),
                "measured_rad": self.angle_rad.get(joint),
                "estimated_rad": felt.get(joint),
                "confidence_rad": wide.get(joint),
            }
            for joint in {**wanted, **self.angle_rad}
        ]

    def _estimate_that_counts(self) -> m.JointEstimate | None:
        """The estimate, unless what was felt since is too much newer."""
        felt_ns = max((state.stamp_ns for state in self.states.values()), default=0)
        if self.estimate is None or felt_ns - self.estimate.stamp_ns > STALE_NS:
            return None
        return self.estimate

    def modules(self) -> list[Row]:
        """One row a module, chain by chain, in the order in which they are strung."""
        return [
            {
                "module": module.name or "(new)",
                "kind": module.kind,
                "chain": body.chain,
                "id": module.module_id,
                "serial": f"{module.serial:08x}",
                "N": self._felt(body.chain, module.name, "tension_n"),
                "degC": self._felt(body.chain, module.name, "temperature_degc"),
                "limit_N": module.tension_limit_n,
                "link_errors": module.link_errors,
                "state": f"{module.state} {module.fault}".strip(),
                "standing": self.growing.standing(module),
            }
            for _, body in sorted(self.bodies.items())
            for module in body.modules
        ]

    def _felt(self, chain: str, muscle: str, quantity: str) -> float | None:
        state = self.states.get(chain)
        if state is None or muscle not in state.muscles:
            return None
        value: float = getattr(state, quantity)[state.muscles.index(muscle)]
        return round(value, 1)


def _by_joint(told: m.ExecutiveState | m.JointEstimate | None, name: str) -> dict[str, float]:
    return dict(zip(told.joints, getattr(told, name), strict=False)) if told else {}


def _degrees(joints: list[Row]) -> list[Row]:
    """Angles as a person reads them."""
    columns = {"wanted": "wanted_rad", "measured": "measured_rad", "by_muscles": "estimated_rad"}
    rows: list[Row] = []
    for row in joints:
        angles = {f"{name}_deg": row[column] for name, column in columns.items()}
        known = {k: f"{math.degrees(x):.1f}" for k, x in angles.items() if isinstance(x, float)}
        rows.append({"joint": row["joint"], **dict.fromkeys(angles), **known})
    return rows


def _table(columns: str, rows: list[Row]) -> list[str]:
    names = columns.split()
    cells = [names]
    for row in rows:
        values = (row[name] for name in names)
        cells.append(["-" if value is None else str(value) for value in values])
    widths = [max(len(line[i]) for line in cells) for i in range(len(names))]
    return ["  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)) for line in cells]
