"""Bars of long work: what is over looks over."""

from __future__ import annotations

import io
import sys

import pytest

from experiments.progress import bars
from experiments.sequence import GrowthProgress
from runtime import messages as m


def test_a_stage_of_growth_that_is_over_is_told_as_full() -> None:
    told: list[tuple[str, int, int]] = []
    progress = GrowthProgress(lambda *step: told.append(step))

    def in_stage(stage: str, step: int) -> m.ExecutiveState:
        return m.ExecutiveState(stage=stage, step=step, steps=9, growing="biceps_3")

    def trained(epoch: int) -> m.TrainingProgress:
        return m.TrainingProgress(job="grow", stage="training", epoch=epoch, epochs=100)

    progress.see(in_stage("join", 0))
    progress.see(in_stage("join", 0))
    progress.see(in_stage("collect", 0))
    progress.see(in_stage("collect", 6))
    progress.see(in_stage("waiting", 6))
    progress.see(in_stage("relearn", 7))
    progress.see(trained(50))
    progress.see(in_stage("relearn", 9))
    progress.see(in_stage("adopt", 9))
    progress.see(trained(98))  # late: on its way while the schema was being checked
    progress.see(in_stage("resume", 9))
    progress.see(m.Event(process="executive", kind="grow_done", text="", level="info"))
    assert told == [
        ("join", 0, 1),
        ("join", 1, 1),
        ("collect", 0, 9),
        ("collect", 6, 9),
        ("collect", 7, 9),
        ("relearn", 50, 100),
        ("collect", 9, 9),
        ("relearn", 100, 100),
        ("adopt", 0, 1),
        ("adopt", 1, 1),
        ("resume", 0, 1),
        ("resume", 1, 1),
    ]


def test_a_full_bar_says_done_and_the_same_work_once_more_begins_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")

    def last(title: str) -> str:
        return [line for line in terminal.getvalue().splitlines() if title in line][-1]

    with bars() as narrate:
        narrate("join", 0, 1)
        narrate("join", 1, 1)
        narrate("collect", 7, 9)
    assert "1/1" in last("join") and "done" in last("join")
    assert "7/9" in last("collect") and "left" in last("collect")
    with bars() as narrate:
        narrate("join", 1, 1)
        narrate("join", 0, 1)
    assert "0/1" in last("join") and "left" in last("join"), "a second seed's"
