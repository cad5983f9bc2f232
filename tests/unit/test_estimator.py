"""The estimator: joins chains by muscle name, says how sure it is, and survives bad schemas."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from runtime.messages import (
    ChainState,
    Event,
    JointEstimate,
    Message,
    SchemaCandidate,
    SchemaVersion,
)
from runtime.settings import Chain, Joint, Muscle, Robot, RobotSettings
from services.body_schema.network import NetworkConfig
from services.body_schema.posture import posture
from services.body_schema.schema import Schema
from services.logic.estimator import STALE_NS, Estimator

MS = 1_000_000
JOINTS = ("elbow", "wrist")
MUSCLES = ("triceps", "biceps", "flexor", "extensor")
CHAIN_OF = {"triceps": "upper", "biceps": "upper", "flexor": "lower", "extensor": "lower"}

SETTINGS = RobotSettings(
    robot=Robot(name="toy", body="toy.xml"),
    chain=(Chain(name="upper"), Chain(name="lower")),
    joint=tuple(Joint(name=name, chain="upper", id=100 + i) for i, name in enumerate(JOINTS)),
    muscle=tuple(
        Muscle(name=name, chain=CHAIN_OF[name], id=2 + i) for i, name in enumerate(MUSCLES)
    ),
)


def tiny_schema(seed: int = 0, joints: tuple[str, ...] = JOINTS) -> Schema:
    n, m = len(joints), len(MUSCLES)
    random = np.random.default_rng(seed)
    sizes = NetworkConfig(joints=n, muscles=m).sizes
    weights = tuple(
        (random.normal(0, 1 / math.sqrt(a), (b, a)), random.normal(0, 0.1, b))
        for a, b in itertools.pairwise(sizes)
    )
    return Schema(
        joints=joints,
        muscles=MUSCLES,
        weights=weights,
        theta_scale_rad=np.full(n, 1.0),
        tension_scale_n=np.full(m, 50.0),
        length_scale_m=np.full(m, 0.02),
        length_reference_m=np.linspace(0.1, 0.2, m),
        length_sigma_m=np.linspace(0.001, 0.002, m),
        angle_sigma_rad=np.linspace(0.01, 0.02, n),
        theta_range_rad=np.tile([-1.0, 1.0], (n, 1)),
        tension_range_n=np.tile([0.0, 100.0], (m, 1)),
    )


def version(schema: Schema, number: int = 1) -> SchemaVersion:
    return SchemaVersion(
        version=number,
        joints=schema.joints,
        muscles=schema.muscles,
        method="shipped",
        data=schema.to_bytes(),
    )


def state(chain: str, stamp_ns: int, names: tuple[str, ...] = (), **change: float) -> ChainState:
    """A chain's readings; `change` puts another length in place of a muscle's."""
    names = names or tuple(name for name in MUSCLES if CHAIN_OF[name] == chain)
    zeros = (0.0,) * len(names)
    return ChainState(
        stamp_ns=stamp_ns,
        chain=chain,
        muscles=names,
        length_m=tuple(change.get(name, 0.1 + 0.01 * MUSCLES.index(name)) for name in names),
        tension_n=tuple(10.0 + MUSCLES.index(name) for name in names),
        temperature_degc=zeros,
        target_length_m=zeros,
        mode="follow",
    )


def told(estimator: Estimator, now_ns: int, *messages: Message) -> list[Message]:
    for message in messages:
        estimator.receive(message, now_ns)
    return list(estimator.tick(now_ns))


def test_joins_chains_by_name_whatever_the_order() -> None:
    schema = tiny_schema()
    estimator = Estimator(SETTINGS)
    shuffled = state("lower", 7 * MS, ("extensor", "flexor"))
    (made,) = told(estimator, 10 * MS, version(schema), state("upper", 9 * MS), shuffled)
    f = 10.0 + np.arange(4.0)
    length = 0.1 + 0.01 * np.arange(4.0)
    found = posture(schema, f, length)
    theta = found.angle_rad
    assert isinstance(made, JointEstimate)
    assert made.joints == JOINTS
    assert made.muscles == MUSCLES
    assert made.stamp_ns == 7 * MS  # as old as its oldest reading
    np.testing.assert_allclose(made.angle_rad, theta)
    np.testing.assert_allclose(made.confidence_rad, found.sigma_rad)
    np.testing.assert_allclose(made.predicted_length_m, schema.lengths(theta, f))
    np.testing.assert_allclose(made.predicted_tension_n, schema.tensions(theta, length))


def test_muscles_unknown_to_the_schema_are_left_out() -> None:
    estimator = Estimator(SETTINGS)
    lower = state("lower", 0, ("flexor", "extensor"))
    more = msgspec.structs.replace(
        lower,
        muscles=("fresh", *lower.muscles),
        length_m=(9.0, *lower.length_m),
        tension_n=(9.0, *lower.tension_n),
    )
    (plain,) = told(Estimator(SETTINGS), 0, version(tiny_schema()), state("upper", 0), lower)
    (made,) = told(estimator, 0, version(tiny_schema()), state("upper", 0), more)
    assert made == plain


def test_one_estimate_for_each_complete_set() -> None:
    estimator = Estimator(SETTINGS)
    assert told(estimator, 0, version(tiny_schema()), state("upper", 0)) == []
    assert len(told(estimator, 1 * MS, state("lower", 1 * MS))) == 1
    assert told(estimator, 2 * MS) == []
    assert told(estimator, 10 * MS, state("upper", 10 * MS)) == []
    assert len(told(estimator, 11 * MS, state("lower", 11 * MS))) == 1


def test_a_hundred_estimates_a_second_whatever_the_rate_of_the_chains() -> None:
    estimator = Estimator(SETTINGS)
    told(estimator, 0, version(tiny_schema()))
    made: list[Message] = []
    for now_ns in range(0, 1000 * MS, 5 * MS):
        late = now_ns + now_ns // MS % 3 * MS // 4  # stamps are never quite regular
        made += told(estimator, late, state("upper", late), state("lower", late))
    assert len(made) == 100


def test_goes_on_when_robot_time_begins_again() -> None:
    estimator = Estimator(SETTINGS)
    late = 1000 * MS
    assert told(estimator, late, version(tiny_schema()), state("upper", late), state("lower", late))
    assert told(estimator, 1, state("upper", 1), state("lower", 1))


def test_silent_without_schema_and_at_once_with_it() -> None:
    estimator = Estimator(SETTINGS)
    assert told(estimator, 0, state("upper", 0), state("lower", 0)) == []
    assert len(told(estimator, 0, version(tiny_schema()))) == 1


def test_stale_chain_ends_the_estimates() -> None:
    estimator = Estimator(SETTINGS)
    told(estimator, 0, version(tiny_schema()), state("lower", 0))
    late = STALE_NS + 1
    assert told(estimator, late, state("upper", late)) == []
    assert len(told(estimator, late, state("lower", late - STALE_NS))) == 1


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_reading_that_is_no_number_gives_no_estimate(bad: float) -> None:
    estimator = Estimator(SETTINGS)
    odd = state("lower", 0, flexor=bad)
    assert told(estimator, 0, version(tiny_schema()), state("upper", 0), odd) == []
    assert len(told(estimator, 1, state("upper", 1), state("lower", 1))) == 1


def test_anomaly_points_to_the_muscle() -> None:
    schema = tiny_schema()
    estimator = Estimator(SETTINGS)
    made = told(
        estimator, 0, version(schema), state("upper", 0), state("lower", 0, flexor=5.0)
    ).pop()
    assert isinstance(made, JointEstimate)
    assert max(made.anomaly) == made.anomaly[MUSCLES.index("flexor")] > 100
    measured = np.array([0.10, 0.11, 5.0, 0.13])
    expected = np.abs(measured - made.predicted_length_m) / schema.length_sigma_m
    np.testing.assert_allclose(made.anomaly, expected)
    np.testing.assert_allclose(made.length_error_m, measured - made.predicted_length_m)


def test_zero_sigma_gives_finite_anomaly() -> None:
    sharp = dataclasses.replace(tiny_schema(), length_sigma_m=np.zeros(4))
    made = told(Estimator(SETTINGS), 0, version(sharp), state("upper", 0), state("lower", 0)).pop()
    assert isinstance(made, JointEstimate)
    assert np.isfinite(made.anomaly).all()


def truncated(good: SchemaVersion) -> SchemaVersion:
    return msgspec.structs.replace(good, version=2, data=good.data[:-100])


def foreign(good: SchemaVersion) -> SchemaVersion:
    return version(tiny_schema(joints=("hip", "knee")), 2)


@pytest.mark.parametrize("spoil", [truncated, foreign])
def test_bad_schema_is_told_once_and_the_former_kept(
    spoil: Callable[[SchemaVersion], SchemaVersion],
) -> None:
    good = version(tiny_schema())
    estimator = Estimator(SETTINGS)
    (before,) = told(estimator, 0, good, state("upper", 0), state("lower", 0))
    (event,) = told(estimator, 1, spoil(good))
    assert isinstance(event, Event)
    assert (event.kind, event.level, event.data["version"]) == ("schema_refused", "error", "2")
    assert told(estimator, 2, spoil(good)) == []
    later = told(estimator, 10 * MS, state("upper", 10 * MS), state("lower", 10 * MS))
    assert later == [msgspec.structs.replace(before, stamp_ns=10 * MS)]


def test_candidate_is_not_used() -> None:
    good, other = version(tiny_schema()), tiny_schema(seed=1)
    candidate = msgspec.convert(
        {**msgspec.structs.asdict(version(other, 2)), "train_s": 1.0}, SchemaCandidate
    )
    estimator = Estimator(SETTINGS)
    (before,) = told(estimator, 0, good, state("upper", 0), state("lower", 0))
    for number, kind in enumerate((candidate, version(other, 2)), start=1):
        now_ns = number * 10 * MS
        (made,) = told(estimator, now_ns, kind, state("upper", now_ns), state("lower", now_ns))
        same = made == msgspec.structs.replace(before, stamp_ns=now_ns)
        assert same == isinstance(kind, SchemaCandidate)
