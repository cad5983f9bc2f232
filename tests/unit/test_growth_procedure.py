"""Taking a muscle in, step by step: every stage, every restart, every way to fail into holding."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from runtime.messages import (
    ChainBody,
    Event,
    Message,
    ModuleInfo,
    SchemaCandidate,
    SchemaVerdict,
    SchemaVersion,
    TrainingJob,
    TrainingProgress,
)
from services.body_schema.growth import grow
from services.body_schema.model import BodyModel
from services.body_schema.schema import Schema
from services.logic.arm import Arm
from services.logic.growth import (
    JOIN_LIMIT_S,
    TRAIN_LIMIT_S,
    Growth,
    GrowthRecord,
    held_out_residual_m,
)
from services.logic.guests import GUEST_BIAS_N
from services.logic.targets import spread_targets
from tests.unit.arm_bench import DT_S, SETTINGS, SKELETON, Bench

MUSCLES = (*SETTINGS.muscles, "biceps_3")
START_RAD = np.zeros(2)
GUEST_M = 0.03  # the guest's length, wherever the arm is
LIMIT_MM = 4.0
RETURN_RAD = (0.9,)


class Procedure:
    """A growth over an arm that follows its reference at once; what it says is in `out`."""

    def __init__(self, record: GrowthRecord | None = None) -> None:
        self.bench = Bench(
            muscles=MUSCLES, tension_n={"biceps_3": 12.0}, shift_m={"biceps_3": GUEST_M}
        )
        self.growth = Growth(record or new_record(), self.bench.arm, LIMIT_MM)
        self.saved = b""
        self.out: list[Message] = []
        self.seconds = 0.0

    @property
    def stage(self) -> str:
        return self.growth.record.stage

    def tick(self) -> None:
        self.bench.step()
        self.bench.angle_rad = float(self.bench.arm.reference_rad[0])
        self.out += self.growth.tick(self.bench.now_ns, DT_S)
        self.seconds += DT_S
        if self.growth.dirty:
            self.growth.dirty = False
            self.saved = msgspec.msgpack.encode(self.growth.record)

    def until(self, condition: Callable[[], bool], limit_s: float = 60.0) -> None:
        for _ in range(round(limit_s / DT_S)):
            if condition():
                return
            self.tick()
        raise AssertionError(f"not within {limit_s} s; stage {self.stage}, {self.growth.over}")

    def until_stage(self, stage: str) -> None:
        self.until(lambda: self.stage == stage)

    def told(self, kind: type[Message]) -> list[Message]:
        return [message for message in self.out if isinstance(message, kind)]

    def jobs(self) -> list[TrainingJob]:
        return [message for message in self.out if isinstance(message, TrainingJob)]

    def verdicts(self) -> list[SchemaVerdict]:
        return [message for message in self.out if isinstance(message, SchemaVerdict)]

    def progress(self, stage: str, text: str = "") -> None:
        job = self.growth.record.job
        self.growth.receive(TrainingProgress(job=job, stage=stage, text=text))

    def candidate(self, reference_m: float = GUEST_M, job: str = "", data: bytes = b"") -> None:
        schema = grown(self.bench.schema, reference_m)
        self.growth.receive(
            SchemaCandidate(
                version=2,
                joints=schema.joints,
                muscles=schema.muscles,
                method="iii",
                job=job or self.growth.record.job,
                data=data or schema.to_bytes(),
                train_s=1.0,
            )
        )

    def adopt(self, job: str = "") -> None:
        """The retrainer publishes the candidate as everyone's schema; as the executive hears it."""
        schema = grown(self.bench.schema, GUEST_M)
        self.bench.arm.use(schema)
        self.growth.receive(
            SchemaVersion(
                version=2,
                joints=schema.joints,
                muscles=schema.muscles,
                method="iii",
                job=job or self.growth.record.job,
                data=schema.to_bytes(),
            )
        )

    def finish(self) -> None:
        """Play the retrainer until it is over."""
        for _ in range(6000):
            if self.growth.over:
                return
            self.tick()
            if self.jobs() and self.stage == "relearn":
                self.progress("done")
                self.candidate()
            if self.stage == "adopt" and self.verdicts():
                self.adopt()
        raise AssertionError(f"still in stage {self.stage}")

    def module_is(self, state: str) -> None:
        """What the chain says of the guest, for now."""
        modules = tuple(
            ModuleInfo(name=name, kind="muscle", module_id=2 + k, serial=50 + k, state=state)
            for k, name in enumerate(MUSCLES)
        )
        self.bench.arm.receive(ChainBody(chain="arm", modules=modules))


def grown(schema: Schema, reference_m: float) -> Schema:
    """A schema that expects the guest's wire at one length always."""
    return grow(schema, "biceps_3", 80.0, 0.01, length_reference_m=reference_m)


def new_record(kind: str = "grow", n_new: int = 3, n_check: int = 2) -> GrowthRecord:
    rng = np.random.default_rng(5)
    targets = spread_targets(
        n_new + n_check, SKELETON.range_rad, 3, (8.0, 35.0), rng, START_RAD[:1]
    )
    return GrowthRecord(
        kind=kind,
        muscle="biceps_3",
        muscles=MUSCLES,
        base_version=1,
        method="iii",
        seed=5,
        n_new=n_new,
        n_check=n_check,
        return_rad=RETURN_RAD,
        targets=targets,
        motions=[],
    )


# ── the stages ────────────────────────────────────────────────────────────────────────────────


def test_all_stages_in_order_to_the_end() -> None:
    run = Procedure()
    assert run.growth.steps == 5
    seen = [run.stage]
    for _ in range(10_000):
        if run.growth.over:
            break
        run.tick()
        if run.stage == "relearn" and len(run.growth.record.motions) == 5:
            run.candidate()
        if run.stage == "adopt" and run.verdicts():
            run.adopt()
        if run.stage != seen[-1]:
            seen.append(run.stage)
    assert seen == ["join", "collect", "relearn", "adopt", "resume"]
    assert run.growth.over == "done"
    assert run.bench.arm.reference_rad == pytest.approx(RETURN_RAD)
    (event,) = run.told(Event)
    assert isinstance(event, Event) and event.kind == "checked"
    (verdict,) = run.verdicts()
    assert verdict.adopted and set(verdict.residual_mm) == set(MUSCLES)
    assert verdict.residual_mm["biceps_3"] == pytest.approx(0.0, abs=1e-3)


def test_joining_waits_for_the_module_and_gives_up_in_words() -> None:
    run = Procedure()
    run.bench.feel = lambda: None  # type: ignore[method-assign]
    run.module_is("joining")
    run.until(lambda: bool(run.growth.over), JOIN_LIMIT_S + 1.0)
    assert run.stage == "join"
    assert run.growth.over == "muscle 'biceps_3' did not come up within 40 s"
    assert run.seconds == pytest.approx(JOIN_LIMIT_S, abs=0.1)


def test_the_job_carries_the_new_motions_alone_never_those_of_the_check() -> None:
    run = Procedure()
    run.until(lambda: len(run.growth.record.motions) == 5)
    (job, *again) = run.jobs()
    assert (job.kind, job.method, job.seed, job.base_version) == ("grow", "iii", 5, 1)
    assert job.muscles == MUSCLES and job.joints == ("elbow",)
    assert list(job.motions) == run.growth.record.motions[:3]
    assert all(other.motions == job.motions and other.job == job.job for other in again)


def test_motions_are_whole_trajectories_that_end_at_rest() -> None:
    run = Procedure()
    run.until(lambda: len(run.growth.record.motions) == 3)
    for motion, target in zip(run.growth.record.motions, run.growth.record.targets, strict=False):
        angles = np.array(motion.angle_rad)[:, 0]
        settled = np.array(motion.settled)
        assert 5 <= settled.sum() < len(settled) / 2
        assert settled[-1] and not settled[0]
        assert angles[-1] == pytest.approx(target.angle_rad[0], abs=1e-6)
        assert np.ptp(angles) > 0.1
        assert all(len(row) == 4 for row in motion.tension_n)


def test_the_guest_pulls_as_each_motion_says_and_rests_afterwards() -> None:
    run = Procedure()
    biases = []
    for k in range(1, 6):
        run.until(lambda k=k: len(run.growth.record.motions) == k)  # type: ignore[misc]
        biases.append(run.bench.arm.guests.bias_n["biceps_3"])
    wanted = [target.bias_n for target in run.growth.record.targets]
    assert biases == pytest.approx([*wanted[:4], GUEST_BIAS_N])
    run.until(lambda: run.bench.arm.resting_s() > 0.5)
    assert run.bench.arm.reference_rad == pytest.approx(RETURN_RAD)


def test_the_job_is_repeated_until_the_retrainer_is_heard() -> None:
    run = Procedure()
    run.until_stage("relearn")
    start = run.seconds
    run.until(lambda: run.seconds >= start + 3.5)
    assert len(run.jobs()) == 4
    run.progress("starting")
    run.until(lambda: run.seconds >= start + 8.0)
    assert len(run.jobs()) == 4


def test_somebody_elses_words_are_not_heard() -> None:
    run = Procedure()
    run.until_stage("relearn")
    run.growth.receive(TrainingProgress(job="other", stage="failed"))
    run.until(lambda: len(run.growth.record.motions) == 5)
    run.candidate(job="other")
    run.until(lambda: run.seconds > 25.0)
    assert run.stage == "relearn" and not run.growth.over
    run.candidate()
    run.until_stage("adopt")
    run.adopt(job="other")
    assert run.stage == "adopt"


def test_a_shrinking_body_needs_no_module_and_no_new_motion() -> None:
    record = new_record(kind="shrink", n_new=0)
    record.muscles, record.muscle = SETTINGS.muscles, "biceps_3"
    run = Procedure(record)
    run.bench.muscles = SETTINGS.muscles
    run.until_stage("relearn")
    assert run.growth.record.motions == []
    run.tick()
    assert run.jobs()[0].kind == "shrink" and run.jobs()[0].motions == ()
    run.growth.receive(
        SchemaCandidate(
            version=2,
            joints=("elbow",),
            muscles=SETTINGS.muscles,
            method="shrink",
            job=run.growth.record.job,
            data=run.bench.schema.to_bytes(),
            train_s=1.0,
        )
    )
    run.until_stage("adopt")


# ── failing ───────────────────────────────────────────────────────────────────────────────────


def test_a_candidate_that_is_off_on_held_out_motion_is_refused() -> None:
    run = Procedure()
    run.until_stage("relearn")
    run.candidate(reference_m=GUEST_M + 0.006)
    run.until(lambda: bool(run.growth.over))
    assert "candidate refused: length residual on held-out motion above 4.0 mm" in run.growth.over
    assert "biceps_3 6.00 mm" in run.growth.over
    (verdict,) = run.verdicts()
    assert not verdict.adopted and verdict.reason in run.growth.over
    assert verdict.residual_mm["biceps_3"] == pytest.approx(6.0, abs=0.01)
    assert len(run.growth.record.motions) == 5  # it was looked at with all of them


def test_a_candidate_that_is_no_schema_is_refused() -> None:
    run = Procedure()
    run.until_stage("relearn")
    run.candidate(data=b"torn")
    run.until(lambda: bool(run.growth.over))
    assert run.growth.over.startswith("candidate refused")
    assert not run.verdicts()[0].adopted


def test_a_failed_job_ends_it() -> None:
    run = Procedure()
    run.until_stage("relearn")
    run.tick()
    run.progress("failed", "of 10 samples only 3 have every wire taut")
    assert run.growth.over == "relearning failed: of 10 samples only 3 have every wire taut"


def test_what_is_over_stays_over() -> None:
    run = Procedure()
    run.until_stage("relearn")
    run.candidate()
    run.until(lambda: len(run.growth.record.motions) == 5)
    said = len(run.out)
    run.growth.over = "a muscle left meanwhile"
    for _ in range(200):
        run.tick()
    assert run.growth.over == "a muscle left meanwhile"
    assert len(run.out) == said


def test_a_silent_retrainer_ends_it_and_a_slow_one_does_not() -> None:
    run = Procedure()
    run.until_stage("relearn")
    run.until(lambda: len(run.growth.record.motions) == 5)

    def wait(said: bool) -> str:
        for _ in range(round(TRAIN_LIMIT_S) + 1):
            if said:
                word = TrainingProgress(job=run.growth.record.job, stage="training")
                run.growth.receive(word)
            list(run.growth.tick(run.bench.now_ns, 1.0))
        return run.growth.over

    assert wait(said=True) == wait(said=True) == ""
    assert wait(said=False) == "no word of a relearned schema for 120 s"


def test_a_retrainer_that_never_publishes_ends_it() -> None:
    run = Procedure()
    run.until_stage("relearn")
    run.candidate()
    run.until(lambda: bool(run.growth.over))
    assert run.growth.over == "the retrainer did not publish the adopted schema"
    assert len(run.verdicts()) > 10  # it was asked each second


# ── restarting ────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize("stage", ["join", "collect", "relearn", "check", "adopt", "resume"])
def test_a_restarted_executive_goes_on_from_the_record(stage: str) -> None:
    first = Procedure()
    if stage == "collect":
        first.until(lambda: len(first.growth.record.motions) == 2)
        for _ in range(20):  # in the middle of a motion
            first.tick()
    elif stage == "check":
        first.until(lambda: len(first.growth.record.motions) == 4)
    elif stage == "resume":
        first.until_stage("relearn")
        first.candidate()
        first.until_stage("adopt")
        first.tick()
        first.adopt()
        first.tick()
    else:
        if stage == "adopt":
            first.until_stage("relearn")
            first.candidate()
        first.until_stage(stage)
        first.tick()

    record = msgspec.msgpack.decode(first.saved, type=GrowthRecord)
    second = Procedure(record)
    if stage == "resume":
        second.bench.arm.use(grown(second.bench.schema, GUEST_M))
    second.finish()
    assert second.growth.over == "done"
    assert len(record.motions) == 5
    kept = first.growth.record.motions
    assert record.motions[: len(kept)] == kept  # what was collected is not collected anew
    if first.growth.record.job:
        assert record.job == first.growth.record.job
    assert {job.job for job in second.jobs()} <= {record.job}
    assert second.bench.arm.reference_rad == pytest.approx(RETURN_RAD)


def test_an_adoption_heard_before_the_arm_is_felt_costs_nothing() -> None:
    first = Procedure()
    first.until_stage("relearn")
    first.candidate()
    first.until_stage("adopt")
    first.tick()
    record = msgspec.msgpack.decode(first.saved, type=GrowthRecord)
    arm = Arm(SETTINGS, SKELETON)  # of a new executive: the retained schema may be its first word
    growth = Growth(record, arm, LIMIT_MM)
    schema = grown(first.bench.schema, GUEST_M)
    arm.use(schema)
    growth.receive(
        SchemaVersion(
            version=2,
            joints=schema.joints,
            muscles=schema.muscles,
            method="iii",
            job=record.job,
            data=schema.to_bytes(),
        )
    )
    assert growth.record.stage == "resume"


# ── held-out residuals and targets ────────────────────────────────────────────────────────────


def itself(schema: Schema) -> BodyModel:
    return schema


def test_residuals_are_root_mean_squares_by_muscle() -> None:
    run = Procedure()
    run.until(lambda: len(run.growth.record.motions) == 1)
    motions = run.growth.record.motions[:1]
    data = grown(run.bench.schema, GUEST_M - 0.002).to_bytes()
    residual = held_out_residual_m(data, motions, itself)
    assert residual["biceps_3"] == pytest.approx(0.002, abs=1e-9)
    assert residual["triceps"] == pytest.approx(0.0, abs=1e-9)
    assert held_out_residual_m(b"", motions, itself) == {"schema": float("inf")}
    assert held_out_residual_m(data, [], itself) == {"schema": float("inf")}
    three = tuple(row[:3] for row in motions[0].tension_n)
    narrow = msgspec.structs.replace(motions[0], tension_n=three)
    assert held_out_residual_m(data, [narrow], itself) == {"schema": float("inf")}
