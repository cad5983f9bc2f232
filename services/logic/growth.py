"""The growth procedure: join, collect, relearn, check, adopt, resume; and its inverse, shrinking.

What has to outlive a killed executive is in `GrowthRecord`, saved after every finished stage and
motion: a new executive goes on from there. Every way it can fail ends in holding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import msgspec
import numpy as np

from runtime.messages import (
    Event,
    Message,
    Motion,
    SchemaCandidate,
    SchemaVerdict,
    SchemaVersion,
    TrainingJob,
    TrainingProgress,
)
from services.body_schema.model import BodyModel
from services.body_schema.motions import TrainingError, residuals_m
from services.body_schema.schema import Schema, SchemaError
from services.logic.arm import Arm, MotionRecorder
from services.logic.guests import GUEST_BIAS_N
from services.logic.targets import Target

SETTLE_S = 0.45  # at the end of each motion
SETTLED_TAIL_S = 0.2  # of which the last part counts as settled
SAMPLE_EVERY = 2  # ticks
JOIN_LIMIT_S = 40.0  # the driver winds slack in for up to 30 s
TRAIN_LIMIT_S = 120.0  # without a word of the retrainer: on a busy machine it takes its time
REPEAT_S = 1.0  # of the job, until the retrainer is heard
SPEED_UP = 4.0 / 3.0  # of the fastest joint in a motion, over the speed of tasks


class GrowthRecord(msgspec.Struct):
    """All that a restarted executive needs."""

    kind: str  # grow | refit | shrink
    muscle: str  # that comes or goes
    muscles: tuple[str, ...]  # of the schema that is wanted
    base_version: int
    method: str
    seed: int
    n_new: int
    n_check: int
    return_rad: tuple[float, ...]
    targets: tuple[Target, ...]
    stage: str = "join"  # join | collect | relearn | adopt | resume
    motions: list[Motion] = []
    job: str = ""
    restarts: int = 0
    paused: bool = False  # until somebody asks for it again


class Growth:
    """One run of the procedure over an `Arm`; `tick` yields messages until `over`.

    Attributes:
        over: "" while it runs, else `done` or the reason for which it gave up.
        dirty: set when `record` has to be saved.
    """

    def __init__(self, record: GrowthRecord, arm: Arm, limit_mm: float) -> None:
        self.record = record
        self.over = ""
        self.dirty = True
        self._arm = arm
        self._limit_m = limit_mm * 1e-3
        self._recorder: MotionRecorder | None = None
        self._ticks = 0
        self._waited_s = 0.0
        self._since_ask_s = REPEAT_S
        self._heard = False
        self._unheard_s = 0.0
        self._returning = False
        self._candidate: SchemaCandidate | None = None
        self._bias = GUEST_BIAS_N
        self._bias_from = GUEST_BIAS_N

    @property
    def steps(self) -> int:
        """Motions in all, those for the check included."""
        return self.record.n_new + self.record.n_check

    def expects(self, version: SchemaVersion) -> bool:
        """Whether this schema in use is the one it began with, or the one that it brought."""
        began = version.version == self.record.base_version
        return began or (bool(self.record.job) and version.job == self.record.job)

    def receive(self, message: Message) -> None:
        """Candidates, adoptions and progress of this run's job."""
        record = self.record
        if isinstance(message, SchemaCandidate):
            if message.job == record.job and self._candidate is None:
                self._candidate = message
        elif isinstance(message, SchemaVersion):
            if message.job == record.job and record.stage == "adopt":
                self._enter("resume")
        elif isinstance(message, TrainingProgress) and message.job == record.job:
            self._heard = True
            self._unheard_s = 0.0
            if message.stage == "failed":
                self.over = f"relearning failed: {message.text}"

    def tick(self, now_ns: int, dt_s: float) -> Iterator[Message]:
        """Go on; called while the arm can move, after `arm.step`."""
        if self.over:
            return
        self._ticks += 1
        self._waited_s += dt_s
        self._arm.corrected = self.record.stage in ("collect", "relearn")
        if self.record.stage == "join":
            self._join()
        elif self.record.stage == "collect":
            self._collect(self.record.n_new, "relearn")
        elif self.record.stage == "relearn":
            yield from self._relearn(now_ns, dt_s)
        elif self.record.stage == "adopt":
            yield from self._ask_adoption(now_ns, dt_s)
        elif not self._returning:
            self._returning = True
            self._arm.go(np.array(self.record.return_rad))
        elif self._arm.resting_s() >= 0.0:
            self.over = "done"

    def _enter(self, stage: str) -> None:
        self.record.stage = stage
        self.dirty = True
        self._waited_s = 0.0
        self._since_ask_s = REPEAT_S

    def _join(self) -> None:
        module = self._arm.module(self.record.muscle)
        leaving = self.record.kind == "shrink"
        if (leaving or (module and module.state == "up")) and self._arm.resting_s() >= 0.0:
            self._enter("collect")
        elif self._waited_s > JOIN_LIMIT_S:
            self.over = f"muscle '{self.record.muscle}' did not come up within {JOIN_LIMIT_S:.0f} s"

    def _collect(self, until: int, then: str) -> None:
        """Motions up to `until`, one after the other; the guest's bias runs along each."""
        record, arm = self.record, self._arm
        if len(record.motions) >= until:
            self._enter(then)
            return
        target = record.targets[len(record.motions)]
        if self._recorder is None:
            self._recorder = MotionRecorder(record.muscles)
            self._bias_from, self._bias = self._bias, target.bias_n
            speed_deg_s = arm.settings.control.joint_speed_deg_s
            speed_deg_s *= 1.0 if arm.drawn else SPEED_UP  # carefully by a drawing
            arm.go(np.array(target.angle_rad), np.array(target.floor_n), speed_deg_s)
        path = arm.path
        assert path is not None
        arm.guests.bias_n[record.muscle] = self._bias_at(path.elapsed_s / path.duration_s)
        settled = path.arrived_s > SETTLE_S - SETTLED_TAIL_S
        if self._ticks % SAMPLE_EVERY == 0:
            self._recorder.sample(arm, settled)
        if path.arrived_s >= SETTLE_S:
            record.motions.append(self._recorder.motion())
            self._recorder = None
            self.dirty = True
            if len(record.motions) == self.steps:
                arm.guests.bias_n[record.muscle] = GUEST_BIAS_N
                arm.go(np.array(record.return_rad))

    def _bias_at(self, share: float) -> float:
        """The guest's tension [N] along a motion: over its whole range, down, and to its goal.

        Were it to run along with the joints, its stretch could not be told from its path.
        """
        growth = self._arm.settings.growth
        turns = (self._bias_from, growth.bias_max_n, growth.bias_min_n, self._bias)
        return float(np.interp(share, (0.0, 1 / 3, 2 / 3, 1.0), turns))

    def _relearn(self, now_ns: int, dt_s: float) -> Iterator[Message]:
        """Ask for the relearning; meanwhile move for the check, on motions never trained on."""
        record = self.record
        self._since_ask_s += dt_s
        self._unheard_s += dt_s
        if not record.job:
            record.job = f"{record.kind}-{record.muscle}-{now_ns // 1_000_000}"
            self.dirty = True
        if self._since_ask_s >= REPEAT_S and not self._heard:
            self._since_ask_s = 0.0
            yield self._job(now_ns)
        if len(record.motions) < self.steps:
            self._collect(self.steps, "relearn")
        elif self._candidate is not None:
            yield from self._check(now_ns, self._candidate)
        elif self._unheard_s > TRAIN_LIMIT_S and record.base_version:  # a first schema can wait
            self.over = f"no word of a relearned schema for {TRAIN_LIMIT_S:.0f} s"

    def _job(self, now_ns: int) -> TrainingJob:
        record = self.record
        return TrainingJob(
            stamp_ns=now_ns,
            job=record.job,
            kind=record.kind,
            base_version=record.base_version,
            joints=self._arm.settings.joints,
            muscles=record.muscles,
            method=record.method,
            seed=record.seed,
            motions=tuple(record.motions[: record.n_new]),
            paths=self._arm.guests.paths(record.muscles),
        )

    def _check(self, now_ns: int, candidate: SchemaCandidate) -> Iterator[Message]:
        record = self.record
        residual_m = self._residual_m(candidate)
        mm = {name: round(value * 1e3, 3) for name, value in residual_m.items()}
        bad = [name for name, value in residual_m.items() if not value <= self._limit_m]
        slack = record.kind != "shrink" and not {record.muscle, "schema"} & set(residual_m)
        words = ", ".join(f"{name} {value:.2f} mm" for name, value in mm.items())
        if bad or slack:
            limit_mm = self._limit_m * 1e3
            reason = f"length residual on held-out motion above {limit_mm:.1f} mm: {words}"
            if slack:
                reason = f"'{record.muscle}' hung slack on held-out motion: nobody can judge it"
            self.over = f"candidate refused: {reason}"
            yield SchemaVerdict(
                stamp_ns=now_ns, job=record.job, adopted=False, reason=reason, residual_mm=mm
            )
            return
        self._enter("adopt")
        yield Event(
            stamp_ns=now_ns,
            process="executive",
            level="info",
            kind="checked",
            text=f"held-out motion agrees: {words}",
            data={"job": record.job},
        )

    def _ask_adoption(self, now_ns: int, dt_s: float) -> Iterator[Message]:
        self._since_ask_s += dt_s
        if self._since_ask_s < REPEAT_S:
            return
        self._since_ask_s = 0.0
        record = self.record
        yield SchemaVerdict(
            stamp_ns=now_ns,
            job=record.job,
            adopted=True,
            reason="held-out motion agrees",
            residual_mm={} if self._candidate is None else self._residuals_mm(),
        )
        if self._waited_s > JOIN_LIMIT_S:
            self.over = "the retrainer did not publish the adopted schema"

    def _residuals_mm(self) -> dict[str, float]:
        assert self._candidate is not None
        residual_m = self._residual_m(self._candidate)
        return {name: round(value * 1e3, 3) for name, value in residual_m.items()}

    def _residual_m(self, candidate: SchemaCandidate) -> dict[str, float]:
        held_out = self.record.motions[self.record.n_new :]
        return held_out_residual_m(candidate.data, held_out, self._arm.served)


def held_out_residual_m(
    data: bytes, motions: list[Motion], served: Callable[[Schema], BodyModel]
) -> dict[str, float]:
    """Root mean square of measured minus predicted length [m] by muscle; inf for a bad schema.

    Of what will control: the schema's wires, else its network. A muscle that hung slack nearly all
    the time is left out: nothing can be said of it.
    """
    try:
        schema = Schema.from_bytes(data)
        rms = residuals_m(served(schema), motions)
    except (SchemaError, TrainingError):
        return {"schema": float("inf")}
    judged = zip(schema.muscles, rms.tolist(), strict=True)
    return {name: value for name, value in judged if not np.isnan(value)}
