"""Keeps the body schema's versions and relearns it on request.

A `TrainingJob` becomes a `SchemaCandidate`; only the executive's `SchemaVerdict`, after held-out
motion, makes it the `SchemaVersion` that everyone uses. Training takes seconds: it runs as a job
that the shell starts (a thread when live, at once in the rig), so that `tick` never waits.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator
from typing import Protocol

import msgspec

from runtime.logic import Store
from runtime.messages import (
    Event,
    Message,
    Reply,
    SchemaCandidate,
    SchemaRequest,
    SchemaVerdict,
    SchemaVersion,
    TrainingJob,
    TrainingProgress,
    VersionRow,
)
from runtime.settings import RobotSettings
from runtime.settings_file import shown
from services.body_schema.growth import permuted
from services.body_schema.motions import TrainingError
from services.body_schema.schema import Schema, SchemaError
from services.logic.relearning import first, grown, refitted, shrunk
from services.logic.versions import CANDIDATE, NONE, REFUSED, USABLE, Version, Versions

PROGRESS_MESSAGES = 100  # at most, for one job


class Running(Protocol):
    """A job under way: a `concurrent.futures.Future` will do."""

    def done(self) -> bool:
        """It has ended, well or not."""

    def result(self) -> Schema:
        """What it gave, or the exception that ended it."""


StartJob = Callable[[Callable[[], Schema]], Running]


class CancelledError(Exception):
    """The job is not wanted any more."""


class Retrainer:
    """`TrainingJob` and `SchemaVerdict` in; progress, candidates and versions out.

    Args:
        settings: the robot's.
        store: where versions outlive the process.
        shipped: bytes of the schema that comes with the robot; version 1 of an empty store.
        start_job: runs a callable beside or inside the present one.
        wall_s: a clock, for `train_s` alone.
    """

    inputs: tuple[type[Message], ...] = (TrainingJob, SchemaVerdict)
    requests: tuple[type[Message], ...] = (SchemaRequest,)
    period_ns = 50_000_000

    def __init__(
        self,
        settings: RobotSettings,
        store: Store,
        shipped: bytes | None,
        start_job: StartJob,
        wall_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self._settings = settings
        self._versions = Versions(store, shipped)
        self._start_job = start_job
        self._wall_s = wall_s
        self._run: _Run | None = None
        self._out: list[Message] = [
            _event("warning", "schema_corrupt", text) for text in self._versions.complaints
        ]
        if self._versions.active is None:
            file = settings.schema_file
            lacks = f": {shown(file)} does not exist" if file is not None and not shipped else ""
            text = f"this robot has no body schema yet{lacks}; 'myograft learn' makes one"
            self._out.append(_event("warning", "no_schema", text))
        self._publish_active()

    # ── in ────────────────────────────────────────────────────────────────────────────────────

    def receive(self, message: Message, now_ns: int) -> None:
        """Jobs start, unless they are done or under way; verdicts adopt or refuse."""
        if isinstance(message, TrainingJob):
            self._take_job(message)
        elif isinstance(message, SchemaVerdict):
            self._take_verdict(message)

    def answer(self, request: Message, now_ns: int) -> Reply:
        """`list` the versions, or `rollback` to one."""
        if not isinstance(request, SchemaRequest):
            return Reply(ok=False, text=f"the retrainer does not know {type(request).__name__}")
        if request.action == "list":
            rows = self._versions.rows()
            data = {str(row.version): _words(row) for row in rows}
            text = f"{len(data)} version{'s' if len(data) != 1 else ''}"
            data["rows"] = msgspec.json.encode(rows).decode()
            return Reply(ok=True, text=text, data=data)
        if request.action == "rollback":
            return self._roll_back(request.version)
        return Reply(ok=False, text=f"'{request.action}' is neither list nor rollback")

    def cancel(self) -> None:
        """End the running job at its next epoch; for the process when it stops."""
        if self._run is not None:
            self._run.cancelled = True
            self._run = None

    # ── out ───────────────────────────────────────────────────────────────────────────────────

    def tick(self, now_ns: int) -> Iterator[Message]:
        """What is new: versions, progress, the end of a job."""
        run = self._run
        if run is not None and run.running is None:
            run.started_s = self._wall_s()
            run.running = self._start_job(run.work)
        if run is not None:
            while run.progress:
                self._out.append(run.progress.popleft())
            if run.running is not None and run.running.done():
                self._run = None
                self._finish(run, run.running)
        out, self._out = self._out, []
        for message in out:
            yield msgspec.structs.replace(message, stamp_ns=now_ns)

    # ── jobs ──────────────────────────────────────────────────────────────────────────────────

    def _take_job(self, job: TrainingJob) -> None:
        if self._run is not None and self._run.job.job == job.job:
            self._tell(job, "starting")
            return
        version = self._versions.of_job(job.job)
        if version is not None:  # done in a former life, or asked twice
            self._tell(job, "done")
            self._publish_candidate(version)
            return
        self.cancel()
        self._tell(job, "starting")
        try:
            work = self._work(job)
        except (SchemaError, TrainingError) as error:
            self._tell(job, "failed", str(error))
            return
        self._run = _Run(job, *work)

    def _work(self, job: TrainingJob) -> tuple[int, Callable[[_Run], Schema]]:
        """Number of the parent version, and what there is to do for a job."""
        if job.kind == "grow" and job.base_version == NONE:
            return NONE, lambda run: first(job, self._settings, run.epoch_done)
        base = self._versions.schema(job.base_version)
        if set(job.joints) != set(base.joints):
            raise TrainingError(f"the schema's joints are {', '.join(base.joints)}")
        if job.kind == "shrink":
            return job.base_version, lambda run: shrunk(base, job, run.epoch_done)
        if job.kind == "grow":
            return job.base_version, lambda run: grown(base, job, self._settings, run.epoch_done)
        if job.kind == "refit":
            last = self._versions.last_with(set(job.muscles))
            if last is None:
                raise TrainingError(f"no schema of {', '.join(job.muscles)} is stored")
            former = Schema.from_bytes(last.data)
            returning = tuple(set(job.muscles) - set(base.muscles))
            limit_m = self._settings.growth.residual_limit_mm * 1e-3
            return last.number, lambda _: refitted(former, job, returning, limit_m)
        raise TrainingError(f"a job of kind '{job.kind}' is neither grow, shrink nor refit")

    def _finish(self, run: _Run, running: Running) -> None:
        job = run.job
        try:
            schema = permuted(running.result(), job.muscles)
        except CancelledError:
            self._tell(job, "failed", "cancelled")
        except Exception as error:  # whatever went wrong in there must not end the process
            known = isinstance(error, (TrainingError, SchemaError))
            self._tell(job, "failed", str(error) if known else repr(error))
        else:
            method = _method(job)
            train_s = self._wall_s() - run.started_s
            version = self._versions.add(schema, method, CANDIDATE, job.job, run.parent, train_s)
            self._tell(job, "done")
            self._publish_candidate(version)

    def _tell(self, job: TrainingJob, stage: str, text: str = "") -> None:
        self._out.append(TrainingProgress(job=job.job, stage=stage, method=_method(job), text=text))

    # ── versions ──────────────────────────────────────────────────────────────────────────────

    def _take_verdict(self, verdict: SchemaVerdict) -> None:
        version = self._versions.of_job(verdict.job)
        if version is None:
            if self._run is not None and self._run.job.job == verdict.job and not verdict.adopted:
                self._run.cancelled = True
        elif version.state == CANDIDATE and verdict.adopted:
            residual_mm = verdict.residual_mm or version.residual_mm
            replaced = msgspec.structs.replace(
                version, residual_mm=residual_mm, reason=verdict.reason
            )
            self._versions.activate(replaced)
            self._publish_active()
        elif version.state == CANDIDATE:
            self._versions.refuse(version, verdict.reason)
        elif version is self._versions.active:  # said again by somebody who did not hear us
            self._publish_active()

    def _roll_back(self, number: int) -> Reply:
        version = self._versions.known.get(number)
        if version is None:
            known = ", ".join(map(str, self._versions.known))
            return Reply(ok=False, text=f"there is no version {number} to be read, only {known}")
        if version.state not in USABLE:
            return Reply(ok=False, text=f"version {number} was never in use: it is {version.state}")
        self.cancel()  # what was being learned follows from another version
        self._versions.activate(version)
        self._publish_active()
        text = f"version {number} is in use again"
        self._out.append(_event("info", "rolled_back", text, version=str(number)))
        return Reply(ok=True, text=text)

    def _publish_active(self) -> None:
        version = self._versions.active
        if version is not None:
            self._out.append(
                SchemaVersion(
                    version=version.number,
                    joints=version.joints,
                    muscles=version.muscles,
                    method=version.method,
                    job=version.job,
                    parent=version.parent,
                    residual_mm=version.residual_mm,
                    data=version.data,
                )
            )

    def _publish_candidate(self, version: Version) -> None:
        self._out.append(
            SchemaCandidate(
                version=version.number,
                joints=version.joints,
                muscles=version.muscles,
                method=version.method,
                job=version.job,
                parent=version.parent,
                residual_mm=version.residual_mm,
                data=version.data,
                train_s=version.train_s,
            )
        )


class _Run:
    """One job under way. `work` runs beside the logic: it touches `progress` alone."""

    def __init__(self, job: TrainingJob, parent: int, do: Callable[[_Run], Schema]) -> None:
        self.job = job
        self.parent = parent
        self.running: Running | None = None
        self.started_s = 0.0
        self.cancelled = False
        self.progress: deque[TrainingProgress] = deque()  # appending and popping are atomic
        self._do = do

    def work(self) -> Schema:
        return self._do(self)

    def epoch_done(
        self, epoch: int, epochs: int, loss: float, loss_new: float, loss_old: float
    ) -> None:
        if self.cancelled:
            raise CancelledError
        if epoch % math.ceil(epochs / PROGRESS_MESSAGES) == 0:
            self.progress.append(
                TrainingProgress(
                    job=self.job.job,
                    stage="training",
                    method=_method(self.job),
                    epoch=epoch,
                    epochs=epochs,
                    loss=loss,
                    loss_new=loss_new,
                    loss_old=loss_old,
                )
            )


def _words(row: VersionRow) -> str:
    use = "active, " if row.active else ""
    words = f"{use}{row.state}, method {row.method}, {', '.join(row.muscles)}"
    if off_mm := row.residual_mm.values():
        words += f", off by {sum(off_mm) / len(off_mm):.2f} mm, {max(off_mm):.2f} mm at most"
    if row.train_s:
        words += f", trained in {row.train_s:.1f} s"
    return f"{words} ({row.reason})" if row.state == REFUSED else words


def _method(job: TrainingJob) -> str:
    return job.method if job.kind == "grow" else job.kind


def _event(level: str, kind: str, text: str, **data: str) -> Event:
    return Event(process="retrainer", level=level, kind=kind, text=text, data=data)
