"""The retrainer's promises: nothing is lost, adopted unchecked, or done twice."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial

import msgspec
import numpy as np
import pytest

from runtime import messages as m
from runtime.logic import MemoryStore
from runtime.settings import Control, Growth, Robot, RobotSettings, load_robot
from services.body_schema import train
from services.body_schema.schema import Schema
from services.logic.retrainer import Retrainer, _words
from tests.unit import analytic_body as body
from tests.unit.schemas import untrained

SETTINGS = RobotSettings(
    robot=Robot(name="toy", body="none.xml"),
    chain=(),
    joint=(),
    muscle=(),
    control=Control(),
    growth=Growth(residual_limit_mm=4.0),
)
NEW = body.MUSCLES[3]


SHIPPED = untrained().to_bytes()


class Later:
    """Runs jobs when told, as a thread would; `jobs` counts them."""

    def __init__(self) -> None:
        self.jobs = 0
        self._waiting: list[tuple[Callable[[], Schema], Future[Schema]]] = []

    def __call__(self, job: Callable[[], Schema]) -> Future[Schema]:
        future: Future[Schema] = Future()
        self._waiting.append((job, future))
        self.jobs += 1
        return future

    def run(self) -> None:
        for job, future in self._waiting:
            try:
                future.set_result(job())
            except Exception as error:
                future.set_exception(error)
        self._waiting.clear()


@pytest.fixture(autouse=True)
def short_recipes(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is learned is no matter here: a few steps will do."""
    short = train.Recipe(steps=12, batch=64, rate=1e-3)
    monkeypatch.setattr(train, "relearn", partial(train.relearn, recipe=short))
    monkeypatch.setattr(train, "distil", partial(train.distil, recipe=short))


@pytest.fixture
def store() -> MemoryStore:
    return MemoryStore()


def job(name: str = "job-1", kind: str = "grow", **more: object) -> m.TrainingJob:
    fields: dict[str, object] = {
        "muscles": body.MUSCLES,
        "base_version": 1,
        "motions": tuple(body.spread_motions(2, 0)),
        "method": "iii",  # the made-up body has no skeleton to lead wires over
        **more,
    }
    return m.TrainingJob(job=name, kind=kind, joints=body.JOINTS, **fields)  # type: ignore[arg-type]


def started(store: MemoryStore, start_job: Later | None = None) -> tuple[Retrainer, Later]:
    later = start_job or Later()
    return Retrainer(SETTINGS, store, SHIPPED, later), later


def out(retrainer: Retrainer, kind: type[m.Message] = m.Message) -> list[m.Message]:
    return [message for message in retrainer.tick(5) if type(message) is kind or kind is m.Message]


def grown(store: MemoryStore) -> tuple[Retrainer, m.SchemaCandidate]:
    """A retrainer that has just finished job-1."""
    retrainer, later = started(store)
    retrainer.receive(job(), 0)
    out(retrainer)
    later.run()
    (candidate,) = out(retrainer, m.SchemaCandidate)
    assert isinstance(candidate, m.SchemaCandidate)
    return retrainer, candidate


def test_the_shipped_schema_is_published_at_once(store: MemoryStore) -> None:
    retrainer, _ = started(store)
    (version,) = out(retrainer)
    assert isinstance(version, m.SchemaVersion)
    assert (version.version, version.method, version.data) == (1, "shipped", SHIPPED)
    assert version.stamp_ns == 5


def test_without_any_schema_it_says_so() -> None:
    (event,) = out(Retrainer(load_robot("elbow"), MemoryStore(), None, Later()))
    assert isinstance(event, m.Event)
    assert event.kind == "no_schema"
    assert "elbow.safetensors does not exist" in event.text


def test_a_job_ends_in_a_candidate_that_nobody_uses_yet(store: MemoryStore) -> None:
    retrainer, later = started(store)
    out(retrainer)
    retrainer.receive(job(), 0)
    (starting,) = out(retrainer)
    assert isinstance(starting, m.TrainingProgress)
    assert starting.stage == "starting"
    assert out(retrainer) == []  # the tick does not wait for the job
    later.run()
    *progress, done, candidate = out(retrainer)
    assert progress
    assert all(isinstance(p, m.TrainingProgress) and p.stage == "training" for p in progress)
    assert {p.method for p in (starting, *progress)} == {candidate.method}  # type: ignore[attr-defined]
    assert isinstance(done, m.TrainingProgress)
    assert done.stage == "done"
    assert isinstance(candidate, m.SchemaCandidate)
    assert (candidate.version, candidate.method, candidate.parent) == (2, "iii", 1)
    assert Schema.from_bytes(candidate.data).muscles == body.MUSCLES
    assert store["active"] == b"1"


def test_an_adopted_candidate_becomes_the_version_in_use(store: MemoryStore) -> None:
    retrainer, candidate = grown(store)
    retrainer.receive(
        m.SchemaVerdict(job="job-1", adopted=True, reason="", residual_mm={NEW: 0.5}), 0
    )
    (version,) = out(retrainer)
    assert isinstance(version, m.SchemaVersion)
    assert (version.version, version.job, version.data) == (2, "job-1", candidate.data)
    assert version.residual_mm == {NEW: 0.5}
    (again,) = out(started(store)[0])
    assert isinstance(again, m.SchemaVersion)
    assert (again.version, again.residual_mm) == (2, {NEW: 0.5})


def test_a_verdict_said_twice_is_answered_twice_and_done_once(store: MemoryStore) -> None:
    retrainer, _ = grown(store)
    verdict = m.SchemaVerdict(job="job-1", adopted=True, reason="")
    for _ in range(2):
        retrainer.receive(verdict, 0)
        (version,) = out(retrainer)
        assert isinstance(version, m.SchemaVersion)
        assert version.version == 2


def test_a_refused_candidate_is_kept_and_never_used(store: MemoryStore) -> None:
    retrainer, _ = grown(store)
    retrainer.receive(m.SchemaVerdict(job="job-1", adopted=False, reason="9 mm off"), 0)
    assert out(retrainer) == []
    listed = retrainer.answer(m.SchemaRequest(action="list"), 0)
    assert listed.data["1"].startswith("active, shipped")
    assert "refused" in listed.data["2"]
    assert "9 mm off" in listed.data["2"]
    assert not retrainer.answer(m.SchemaRequest(action="rollback", version=2), 0).ok


def test_versions_are_listed_with_their_figures(store: MemoryStore) -> None:
    retrainer, _ = grown(store)
    residual_mm = {"a": 0.25, "b": 0.5}
    verdict = m.SchemaVerdict(job="job-1", adopted=True, reason="", residual_mm=residual_mm)
    retrainer.receive(verdict, 0)
    listed = retrainer.answer(m.SchemaRequest(action="list"), 0)
    assert listed.data["2"].endswith(", off by 0.38 mm, 0.50 mm at most")
    rows = msgspec.json.decode(listed.data["rows"], type=list[m.VersionRow])
    assert [(x.version, x.state, x.active) for x in rows] == [
        (1, "shipped", False),
        (2, "adopted", True),
    ]
    assert rows[1].residual_mm == residual_mm
    assert rows[1].parent == 1
    trained = msgspec.structs.replace(rows[1], train_s=1.25)
    assert _words(trained).endswith("0.50 mm at most, trained in 1.2 s")
    assert rows[0].muscles == Schema.from_bytes(SHIPPED).muscles


def test_a_rollback_brings_the_old_version_back_under_its_number(store: MemoryStore) -> None:
    retrainer, _ = grown(store)
    verdict = m.SchemaVerdict(job="job-1", adopted=True, reason="")
    retrainer.receive(verdict, 0)
    out(retrainer)
    assert retrainer.answer(m.SchemaRequest(action="rollback", version=1), 0).ok
    (version,) = out(retrainer, m.SchemaVersion)
    assert isinstance(version, m.SchemaVersion)
    assert (version.version, version.data) == (1, SHIPPED)
    # the verdict is retained on the bus: after a restart it must not undo the rollback
    restarted, _ = started(store)
    restarted.receive(verdict, 0)
    assert [v.version for v in out(restarted, m.SchemaVersion)] == [1]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "request_",
    [m.SchemaRequest(action="rollback", version=7), m.SchemaRequest(action="burn"), m.Reset()],
)
def test_requests_that_cannot_be_done_are_refused_in_words(
    store: MemoryStore, request_: m.Message
) -> None:
    reply = started(store)[0].answer(request_, 0)
    assert not reply.ok
    assert reply.text


def test_killed_in_the_middle_it_does_the_retained_job_again(store: MemoryStore) -> None:
    first, _ = started(store)
    first.receive(job(), 0)
    out(first)  # the job has started; here the process dies
    second, later = started(store)
    second.receive(job(), 0)
    out(second)
    later.run()
    assert len(out(second, m.SchemaCandidate)) == 1


def test_a_job_that_is_done_is_not_done_again(store: MemoryStore) -> None:
    _, candidate = grown(store)
    restarted, later = started(store)
    restarted.receive(job(), 0)
    (again,) = out(restarted, m.SchemaCandidate)
    assert isinstance(again, m.SchemaCandidate)
    assert (again.version, again.data) == (candidate.version, candidate.data)
    assert later.jobs == 0


def test_a_job_asked_again_while_it_runs_is_heard_and_not_started_twice(store: MemoryStore) -> None:
    retrainer, later = started(store)
    for _ in range(2):
        retrainer.receive(job(), 0)
        heard = [p.stage for p in out(retrainer, m.TrainingProgress)]  # type: ignore[attr-defined]
        assert heard == ["starting"]
    assert later.jobs == 1


def test_another_job_takes_the_place_of_the_running_one(store: MemoryStore) -> None:
    retrainer, later = started(store)
    retrainer.receive(job("job-1"), 0)
    out(retrainer)
    retrainer.receive(job("job-2"), 0)
    out(retrainer)
    later.run()
    assert [c.job for c in out(retrainer, m.SchemaCandidate)] == ["job-2"]  # type: ignore[attr-defined]


def test_a_refusal_of_a_running_job_cancels_it(store: MemoryStore) -> None:
    retrainer, later = started(store)
    retrainer.receive(job(), 0)
    out(retrainer)
    retrainer.receive(m.SchemaVerdict(job="job-1", adopted=False, reason="cancelled"), 0)
    later.run()
    (failed,) = out(retrainer)
    assert isinstance(failed, m.TrainingProgress)
    assert (failed.stage, failed.text) == ("failed", "cancelled")
    assert store.names() == ["active", "v0001"]


@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (job(base_version=9), "version 9 is not stored"),
        (job(kind="dance"), "dance"),
        (job(motions=()), "0 samples"),
        (job(method="v"), "v"),
        (job(muscles=("a", "b", "c", "d")), "not one muscle more"),
        (job(kind="shrink"), "not fewer"),
        (job(kind="refit"), "no schema of"),
    ],
)
def test_a_job_that_cannot_be_done_fails_in_words(
    store: MemoryStore, bad: m.TrainingJob, words: str
) -> None:
    retrainer, later = started(store)
    out(retrainer)
    retrainer.receive(bad, 0)
    said = out(retrainer)
    later.run()
    said += out(retrainer)
    failed = said[-1]
    assert isinstance(failed, m.TrainingProgress)
    assert failed.stage == "failed"
    assert words in failed.text
    assert store.names() == ["active", "v0001"]


@pytest.mark.parametrize("harm", ["cut", "flip", "foreign"])
def test_a_corrupt_version_is_told_and_the_one_before_is_used(
    store: MemoryStore, harm: str
) -> None:
    retrainer, _ = grown(store)
    retrainer.receive(m.SchemaVerdict(job="job-1", adopted=True, reason=""), 0)
    blob = bytearray(store["v0002"])
    blob[-400] ^= 0x10
    bad = {"cut": store["v0002"][:-100], "flip": bytes(blob), "foreign": b"hello"}[harm]
    store["v0002"] = bad
    restarted, _ = started(store)
    said = out(restarted)
    assert [e.kind for e in said if isinstance(e, m.Event)] == ["schema_corrupt"] * 2
    assert [v.version for v in said if isinstance(v, m.SchemaVersion)] == [1]
    assert store["v0002"] == bad  # nothing is thrown away
    restarted.receive(job("job-2"), 0)
    later = started(store)[1]
    assert later.jobs == 0


def test_new_versions_never_take_a_corrupt_ones_number(store: MemoryStore) -> None:
    grown(store)
    store["v0002"] = b"hello"
    retrainer, later = started(store)
    retrainer.receive(job("job-2"), 0)
    out(retrainer)
    later.run()
    (candidate,) = out(retrainer, m.SchemaCandidate)
    assert isinstance(candidate, m.SchemaCandidate)
    assert candidate.version == 3


def test_when_all_is_corrupt_the_shipped_schema_serves(store: MemoryStore) -> None:
    started(store)
    store["v0001"] = b""
    versions = [v for v in out(started(store)[0]) if isinstance(v, m.SchemaVersion)]
    assert [(v.version, v.data) for v in versions] == [(2, SHIPPED)]


def test_a_crash_between_the_two_writes_of_an_adoption_is_mended(store: MemoryStore) -> None:
    grown(store)
    store["active"] = b"2"  # written first; v0002 still says candidate
    retrainer, _ = started(store)
    assert [v.version for v in out(retrainer, m.SchemaVersion)] == [2]  # type: ignore[attr-defined]
    assert "adopted" in retrainer.answer(m.SchemaRequest(action="list"), 0).data["2"]


def test_shrinking_and_a_muscle_that_comes_back(store: MemoryStore) -> None:
    retrainer, _ = grown(store)
    later = Later()
    retrainer = Retrainer(SETTINGS, store, SHIPPED, later)
    retrainer.receive(m.SchemaVerdict(job="job-1", adopted=True, reason=""), 0)
    rest = (body.MUSCLES[0], *body.MUSCLES[2:])
    retrainer.receive(job("less", "shrink", base_version=2, muscles=rest, motions=()), 0)
    out(retrainer)
    later.run()
    (less,) = out(retrainer, m.SchemaCandidate)
    assert isinstance(less, m.SchemaCandidate)
    assert (less.muscles, less.method) == (rest, "shrink")
    retrainer.receive(m.SchemaVerdict(job="less", adopted=True, reason=""), 0)
    back = (*rest, body.MUSCLES[1])  # columns of the motions are in this order
    whole = Schema.from_bytes(retrainer._versions.known[2].data)
    motion = _as_schema_says(whole, back, offset_m=0.01)
    retrainer.receive(job("back", "refit", base_version=3, muscles=back, motions=(motion,)), 0)
    out(retrainer)
    later.run()
    (again,) = out(retrainer, m.SchemaCandidate)
    assert isinstance(again, m.SchemaCandidate)
    assert (again.muscles, again.method, again.parent) == (back, "refit", 2)
    refitted = Schema.from_bytes(again.data)
    theta, f = np.array([0.7]), np.full(4, 30.0)
    order = [body.MUSCLES.index(name) for name in back]
    expected = whole.lengths(theta, f)[order] + [0.0, 0.0, 0.0, 0.01]
    np.testing.assert_allclose(refitted.lengths(theta, f), expected, atol=1e-6)


def _as_schema_says(schema: Schema, order: tuple[str, ...], offset_m: float) -> m.Motion:
    rng = np.random.default_rng(0)
    theta, f = rng.uniform(0, 2, (50, 1)), rng.uniform(8, 90, (50, len(order)))
    columns = [schema.muscles.index(name) for name in order]
    inverse = np.argsort(columns)
    length = schema.lengths(theta, f[:, inverse])[:, columns]
    length[:, -1] += offset_m
    return body.motion(theta, f, length, np.zeros(50, dtype=bool))
