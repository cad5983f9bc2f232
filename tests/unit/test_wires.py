"""Wires as a table, in a schema's bytes, of some muscles, for encoders that began elsewhere."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
import pytest

from runtime.messages import MusclePath, Place
from services.body_schema.motions import refit
from services.body_schema.schema import Schema, SchemaError
from services.body_schema.wires import STRETCH_TERMS, Wires, fixed_places, stretch_terms
from tests.unit import analytic_body as body
from tests.unit.schemas import untrained


def path(*places: Place) -> MusclePath:
    return MusclePath(attachment=places[0], direction=(0.0, 0.0, -1.0), relays=places[1:])


def site(link: str, x: float) -> Place:
    return Place(link=link, position_m=(x, 0.0, 0.0))


PATHS = (
    path(site("upper", 0.01), Place(wrap="pulley", side="front"), site("lower", 0.02)),
    path(site("upper", 0.03), site("lower", 0.04)),
    path(site("upper", 0.05), site("upper", 0.06), site("lower", 0.07)),
)
MUSCLES = body.MUSCLES[:3]


def wires() -> Wires:
    rng = np.random.default_rng(0)
    return Wires(
        MUSCLES,
        PATHS,
        rng.normal(0.0, 0.1, (7, 3)),
        rng.normal(0.0, 0.1, 3),
        rng.uniform(0.0, 0.01, (3, STRETCH_TERMS)),
    )


def same(a: Wires | None, b: Wires) -> None:
    assert a is not None
    assert (a.muscles, a.paths) == (b.muscles, b.paths)
    for name in ("sites_m", "offset_m", "stretch_m"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def plain(wires: Wires) -> Any:
    """Its table, as it comes out of a file."""
    return json.loads(json.dumps(wires.to_table()))


# ── tables ────────────────────────────────────────────────────────────────────────────────────


def test_a_table_brings_all_back_bit_for_bit() -> None:
    same(Wires.from_table(plain(wires())), wires())


def without(key: str) -> Any:
    table = plain(wires())
    del table[key]
    return table


def other(**fields: Any) -> Any:
    return plain(wires()) | fields


TABLE = plain(wires())
BAD = {
    "nothing": None,
    "a list": [],
    "a word": "wires",
    "a number": 3,
    **{f"no {key}": without(key) for key in TABLE},
    "muscles a word": other(muscles="abc"),
    "muscles numbers": other(muscles=[1, 2, 3]),
    "a muscle too few": other(muscles=TABLE["muscles"][:2]),
    "a muscle too many": other(muscles=[*TABLE["muscles"], "wing"]),
    "a muscle twice": other(muscles=[*TABLE["muscles"][:2], TABLE["muscles"][0]]),
    "paths a word": other(paths="abc"),
    "a path too few": other(paths=TABLE["paths"][:2]),
    "a path without relays": other(paths=[*TABLE["paths"][:2], {"attachment": {}}]),
    "a path of an unknown field": other(paths=[{**TABLE["paths"][0], "x": 1}] * 3),
    "a site too few": other(sites_m=TABLE["sites_m"][:-1]),
    "a site too many": other(sites_m=[*TABLE["sites_m"], [0.0, 0.0, 0.0]]),
    "sites of two numbers": other(sites_m=[row[:2] for row in TABLE["sites_m"]]),
    "uneven sites": other(sites_m=[*TABLE["sites_m"][:-1], [0.0]]),
    "sites words": other(sites_m=[["a", "b", "c"]] * 7),
    "a site of infinity": other(sites_m=[[np.inf, 0.0, 0.0]] * 7),
    "an offset too few": other(offset_m=TABLE["offset_m"][:2]),
    "an offset not a number": other(offset_m=[0.0, np.nan, 0.0]),
    "an offset beyond numbers": other(offset_m=[0, 0, 10**400]),
    "an offset of nothing": other(offset_m=[0.0, None, 0.0]),
    "one number for offsets": other(offset_m=0.0),
    "a table for offsets": other(offset_m={}),
    "a stretch term too few": other(stretch_m=[row[:3] for row in TABLE["stretch_m"]]),
    "stretch flat": other(stretch_m=[0.0] * 12),
    "stretch of infinity": other(stretch_m=[[-np.inf] * 4] * 3),
}


@pytest.mark.parametrize("table", BAD.values(), ids=BAD)
def test_bad_tables_are_refused_in_words(table: Any) -> None:
    with pytest.raises(ValueError, match="wires"):
        Wires.from_table(table)


# ── of others, from elsewhere ─────────────────────────────────────────────────────────────────


def test_wires_of_some_muscles_in_another_order() -> None:
    all_of_them = wires()
    some = all_of_them.of((MUSCLES[2], MUSCLES[0]))
    assert some.muscles == (MUSCLES[2], MUSCLES[0])
    assert some.paths == (PATHS[2], PATHS[0])
    np.testing.assert_array_equal(some.sites_m, all_of_them.sites_m[[4, 5, 6, 0, 1]])
    np.testing.assert_array_equal(some.offset_m, all_of_them.offset_m[[2, 0]])
    np.testing.assert_array_equal(some.stretch_m, all_of_them.stretch_m[[2, 0]])
    assert some.first_site.tolist() == [0, 3, 5]
    with pytest.raises(ValueError):
        all_of_them.of(("wing",))


def test_an_encoder_that_began_elsewhere_shifts_the_offset_alone() -> None:
    before = wires()
    after = before.shifted({MUSCLES[1]: 0.012, "wing": 1.0})
    np.testing.assert_allclose(after.offset_m - before.offset_m, [0.0, 0.012, 0.0], atol=1e-15)
    same(replace(after, offset_m=before.offset_m), before)


def test_paths_that_were_found_have_their_sites_moved_and_the_rest_as_drawn() -> None:
    assert [fixed_places(p) for p in PATHS] == [2, 2, 3]
    found = wires().moved_paths()
    assert tuple(found) == MUSCLES
    sites = iter(wires().sites_m.tolist())
    for name, drawn in zip(MUSCLES, PATHS, strict=True):
        was = (drawn.attachment, *drawn.relays)
        now = (found[name].attachment, *found[name].relays)
        assert found[name].direction == drawn.direction
        for a, b in zip(was, now, strict=True):
            there = a if a.wrap else msgspec.structs.replace(a, position_m=tuple(next(sites)))
            assert b == there
    assert next(sites, None) is None


def test_stretch_grows_with_tension_ever_more_slowly() -> None:
    f = np.array([[0.0, 1.0], [10.0, 20.0], [50.0, 100.0]])
    terms = stretch_terms(f)
    assert terms.shape == (3, 2, STRETCH_TERMS)
    assert not terms[0, 0].any()
    assert terms[2, 1, 0] == pytest.approx(1.0)
    flat = np.array([stretch_terms(np.array([x]))[0] for x in (5.0, 10.0, 15.0)])
    first, second = np.diff(flat, axis=0)
    assert (first > 0).all() and (second[1:] < first[1:]).all()
    assert second[0] == pytest.approx(first[0])


# ── in a schema ───────────────────────────────────────────────────────────────────────────────


def test_a_schemas_bytes_carry_its_wires() -> None:
    schema = untrained()
    assert Schema.from_bytes(schema.to_bytes()).wires is None
    data = schema.with_wires(wires()).to_bytes()
    back = Schema.from_bytes(data)
    same(back.wires, wires())
    assert back.to_bytes() == data
    assert schema.wires is None  # a schema never changes


def test_bytes_with_bad_wires_are_no_schema() -> None:
    bad = untrained().with_wires(replace(wires(), offset_m=np.zeros(2))).to_bytes()
    with pytest.raises(SchemaError, match="wires' numbers do not fit"):
        Schema.from_bytes(bad)


def test_a_muscle_that_came_back_shifts_its_wire_as_much_as_its_network() -> None:
    schema = untrained().with_wires(wires())
    rng = np.random.default_rng(3)
    theta, f = rng.uniform(0.0, 2.0, (40, 1)), rng.uniform(5.0, 100.0, (40, 3))
    length = schema.lengths(theta, f) + rng.normal(0.0, 1e-4, (40, 3))
    length += [0.0, 0.02, 0.001]
    motion = body.motion(theta, f, length, np.ones(40, dtype=bool))
    again = refit(schema, [motion], (MUSCLES[1],), limit_m=3e-3)
    shift = again.length_reference_m - schema.length_reference_m
    assert shift[1] == pytest.approx(0.02, abs=1e-4)
    assert shift[0] == shift[2] == 0.0  # those that stayed kept their zero
    assert again.wires is not None and schema.wires is not None
    np.testing.assert_allclose(again.wires.offset_m - schema.wires.offset_m, shift, atol=1e-15)
    assert refit(untrained(), [motion], MUSCLES, limit_m=3e-3).wires is None
