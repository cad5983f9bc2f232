"""Who does not hear whom: told twice before it counts, and once before it is news."""

from __future__ import annotations

from runtime.hearing import Hearing
from runtime.messages import Health


def health(process: str, *hears: str) -> Health:
    return Health(
        process=process, pid=1, tick_hz=1.0, cpu_percent=1.0, memory_mb=1.0, dropped=0, hears=hears
    )


def test_a_link_counts_as_lost_when_two_reports_on_end_miss_it() -> None:
    hearing = Hearing()
    there = {"a", "b", "c"}
    assert hearing.lost(health("a", "a", "c"), there) == ([], [])
    assert hearing.lost(health("a", "a", "c"), there) == (["b"], ["b"])
    assert hearing.lost(health("a", "a", "c"), there) == (["b"], [])  # no news, but still so
    assert hearing.lost(health("a", "a", "b", "c"), there) == ([], [])
    assert hearing.lost(health("a", "a", "c"), there) == ([], [])
    assert hearing.lost(health("a", "a", "c"), there) == (["b"], ["b"])  # news again


def test_whom_the_hub_does_not_hear_either_is_not_missed() -> None:
    hearing = Hearing()
    assert hearing.lost(health("a"), {"a", "b"}) == ([], [])
    assert hearing.lost(health("a"), {"a"}) == ([], [])
    assert hearing.lost(health("a"), {"a", "b"}) == ([], [])  # came back: one report is none


def test_each_process_is_heard_for_itself() -> None:
    hearing = Hearing()
    there = {"a", "b"}
    assert hearing.lost(health("a"), there) == ([], [])
    assert hearing.lost(health("b"), there) == ([], [])
    assert hearing.lost(health("b"), there) == (["a"], ["a"])
    assert hearing.lost(health("a"), there) == (["b"], ["b"])
