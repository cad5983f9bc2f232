"""The schema answers as its network does, survives the wire, and refuses what is not one."""

from __future__ import annotations

import dataclasses
import json
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load, save

from services.body_schema.network import ANGLES, LENGTHS, MASKS, TENSIONS, Mask, forward
from services.body_schema.schema import Schema, SchemaError
from tests.unit.schemas import untrained

SCHEMA = untrained(("a", "b", "c"), ("shoulder", "elbow"))
BLOB = SCHEMA.to_bytes()
THETA = np.array([0.4, 1.2])
F = np.array([10.0, 60.0, 90.0])
LENGTH = np.array([0.01, -0.03, 0.02])


def by_definition(mask: Mask) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the paper writes: h((theta, f, l) * m, m), scaled in and out without any folding."""
    groups = (
        THETA / SCHEMA.theta_scale_rad,
        F / SCHEMA.tension_scale_n,
        (LENGTH - SCHEMA.length_reference_m) / SCHEMA.length_scale_m,
    )
    x = np.concatenate([g * on for g, on in zip(groups, mask, strict=True)] + [np.array(mask)])
    y = forward(SCHEMA.weights, x[None])[0]
    return (
        y[:2] * SCHEMA.theta_scale_rad,
        y[2:5] * SCHEMA.tension_scale_n,
        y[5:] * SCHEMA.length_scale_m + SCHEMA.length_reference_m,
    )


def test_each_question_is_answered_as_the_network_would() -> None:
    close: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-14}
    np.testing.assert_allclose(SCHEMA.lengths(THETA, F), by_definition(LENGTHS)[2], **close)
    np.testing.assert_allclose(SCHEMA.estimate(F, LENGTH), by_definition(ANGLES)[0], **close)
    np.testing.assert_allclose(SCHEMA.tensions(THETA, LENGTH), by_definition(TENSIONS)[1], **close)
    for mask in MASKS:
        whole = SCHEMA.reconstruct(THETA, F, LENGTH, mask)
        for got, wanted in zip(whole, by_definition(mask), strict=True):
            np.testing.assert_allclose(got, wanted, **close)


def test_a_batch_is_answered_as_each_of_its_samples() -> None:
    rng = np.random.default_rng(0)
    theta, f = rng.uniform(0, 2, (7, 2)), rng.uniform(5, 100, (7, 3))
    batch = SCHEMA.lengths(theta, f)
    assert batch.shape == (7, 3)
    for i in range(7):
        np.testing.assert_allclose(batch[i], SCHEMA.lengths(theta[i], f[i]), rtol=1e-12)
    assert SCHEMA.estimate(f, batch).shape == (7, 2)
    assert SCHEMA.tensions(theta, batch).shape == (7, 3)


def test_the_jacobian_is_the_slope() -> None:
    length, jacobian = SCHEMA.lengths_and_jacobian(THETA, F)
    assert jacobian.shape == (3, 2)
    np.testing.assert_allclose(length, SCHEMA.lengths(THETA, F), rtol=1e-12)
    np.testing.assert_array_equal(jacobian, SCHEMA.lengths_jacobian(THETA, F))
    for joint, step in enumerate(np.eye(2) * 1e-6):
        slope = (SCHEMA.lengths(THETA + step, F) - SCHEMA.lengths(THETA - step, F)) / 2e-6
        np.testing.assert_allclose(jacobian[:, joint], slope, rtol=1e-6, atol=1e-9)


def test_bytes_and_back() -> None:
    schema = dataclasses.replace(SCHEMA, meta={"method": "iii", "note": "größer"})
    again = Schema.from_bytes(schema.to_bytes())
    assert (again.joints, again.muscles, again.meta) == (
        schema.joints,
        schema.muscles,
        schema.meta,
    )
    np.testing.assert_array_equal(again.lengths(THETA, F), schema.lengths(THETA, F))
    np.testing.assert_array_equal(again.estimate(F, LENGTH), schema.estimate(F, LENGTH))
    assert again.to_bytes() == schema.to_bytes()


def test_a_schema_cannot_be_changed_by_accident() -> None:
    scale = np.ones(3)
    schema = dataclasses.replace(SCHEMA, tension_scale_n=scale)
    scale[0] = 7.0
    assert schema.tension_scale_n[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        schema.tension_scale_n[0] = 7.0


@given(st.integers(0, len(BLOB) - 1))
def test_a_truncated_blob_is_refused(size: int) -> None:
    with pytest.raises(SchemaError):
        Schema.from_bytes(BLOB[:size])


@given(st.binary(max_size=200))
def test_foreign_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(SchemaError):
        Schema.from_bytes(data)


@given(st.integers(0, len(BLOB) - 1), st.integers(1, 255))
def test_a_damaged_blob_is_refused_or_gives_finite_numbers(at: int, flip: int) -> None:
    damaged = bytearray(BLOB)
    damaged[at] ^= flip
    try:
        schema = Schema.from_bytes(bytes(damaged))
    except SchemaError:
        return
    assert all(np.isfinite(a).all() for layer in schema.weights for a in layer)


def other(**header: object) -> bytes:
    """The blob with another header."""
    plain = {"format": "body-schema-1", "joints": ["shoulder", "elbow"], "muscles": ["a", "b", "c"]}
    return save(load(BLOB), {"myograft": json.dumps({**plain, "meta": {}, **header})})


@pytest.mark.parametrize(
    "header",
    [
        {"format": "body-schema-2"},
        {"joints": []},
        {"joints": "elbow"},
        {"muscles": ["a", "b", "b"]},
        {"muscles": ["a", "b"]},
        {"muscles": ["a", "b", "c", "d"]},
        {"muscles": ["a", "b", 3]},
        {"meta": 3},
    ],
)
def test_a_header_that_does_not_fit_is_refused(header: dict[str, object]) -> None:
    Schema.from_bytes(other())  # the test's own blob is good
    with pytest.raises(SchemaError):
        Schema.from_bytes(other(**header))


def test_other_peoples_safetensors_are_refused() -> None:
    with pytest.raises(SchemaError, match="format"):
        Schema.from_bytes(save({"weight": np.zeros(3)}))
    with pytest.raises(SchemaError):
        Schema.from_bytes(struct.pack("<Q", 2) + b"[]")


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("theta_scale_rad", np.ones(3), "shape"),
        ("tension_scale_n", np.array([1.0, np.nan, 1.0]), "not finite"),
        ("length_scale_m", np.array([1.0, 0.0, 1.0]), "positive"),
        ("length_sigma_m", np.array(["a", "b", "c"]), "no numbers"),
        ("length_correlation", np.eye(2), "shape"),
        ("length_correlation", np.diag([1.0, 1.0, 2.0]), "no matrix of correlations"),
        ("length_correlation", 2.0 - np.eye(3) * 1.0, "no matrix of correlations"),
        ("weights", SCHEMA.weights[:-1], "5 layers"),
        ("weights", (*SCHEMA.weights[:-1], (np.zeros((3, 3)), np.zeros(3))), "shape"),
        ("muscles", ("a", "b"), "shape"),
        ("muscles", ("a", "b", "elbow"), "name of its own"),
    ],
)
def test_numbers_that_cannot_be_are_refused(name: str, value: Any, words: str) -> None:
    with pytest.raises(SchemaError, match=words):
        dataclasses.replace(SCHEMA, **{name: value})
