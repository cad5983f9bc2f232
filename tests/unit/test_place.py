"""The search for places of wires."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.place import Search, write_sites
from runtime.settings import load_robot


def test_the_search_only_improves_and_stays_in_its_boxes() -> None:
    elbow = load_robot("elbow")
    search = Search(elbow, box_m=0.01, load=1.2, seed=1)
    start, drawn = search.score, search.places_m()
    scores = []
    for _ in range(30):
        search.trial()
        scores.append(search.score)
    assert scores == sorted(scores, reverse=True)
    assert scores[-1] < start
    places = search.places_m()
    assert places.keys() == drawn.keys()
    for site, place in places.items():
        assert np.abs(place - drawn[site]).max() <= 0.01 + 1e-12
    assert search.check().share == 1.0


def test_places_are_written_and_nothing_else_changes(tmp_path: Path) -> None:
    source = load_robot("elbow").body_file
    file = tmp_path / "elbow.xml"
    before = source.read_text()
    file.write_text(before)
    write_sites(file, {"triceps_origin": np.array([0.1, -0.2, 0.30001])})
    old, new = before.splitlines(), file.read_text().splitlines()
    changed = [i for i, (a, b) in enumerate(zip(old, new, strict=True)) if a != b]
    assert len(changed) == 1
    assert '<site name="triceps_origin" pos="0.1000 -0.2000 0.3000"/>' in new[changed[0]]
    with pytest.raises(ValueError, match="0 sites 'nowhere'"):
        write_sites(file, {"nowhere": np.zeros(3)})


def test_the_right_half_follows_the_left_and_what_is_kept_stays() -> None:
    robot = load_robot("musashi_w")
    kept = ("left_biceps", "left_triceps")
    search = Search(robot, box_m=0.01, load=1.0, seed=3, keep=kept)
    drawn = search.places_m()
    for _ in range(25):
        search.trial()
    places = search.places_m()
    moved = {site for site in places if (places[site] != drawn[site]).any()}
    assert moved
    assert not [site for site in moved if site.removeprefix("left_").startswith(("biceps", "tric"))]
    for site, place in places.items():
        if site.startswith("left_"):
            mirrored = places["right_" + site.removeprefix("left_")]
            assert mirrored == pytest.approx(place * (1, -1, 1), abs=1e-12)


def test_wires_to_keep_have_to_be_there() -> None:
    elbow = load_robot("elbow")
    with pytest.raises(ValueError, match=r"no wire 'bicep'; did you mean 'biceps_[12]'"):
        Search(elbow, 0.01, 1.0, 0, keep=["bicep"])
    with pytest.raises(ValueError, match="nothing is left to move"):
        Search(elbow, 0.01, 1.0, 0, keep=elbow.muscles)
