"""The dashboard's charts: how muscles share their work, and loss by epoch and method."""

from __future__ import annotations

import numpy as np
import pytest

from dashboard.canvas import Chart
from dashboard.charts import JOBS, NAMED, POINTS, WIDE, Learning, Sharing
from dashboard.palette import ESTIMATED, LIMIT, slot_color
from dashboard.tracks import Slots
from runtime import messages as m
from tests.made_up_run import FIRST
from tests.unit.paper_canvas import SECOND, PaperCanvas, chain_state

TICK = (235, 235, 235)


def shared(messages: list[m.Message], slots: Slots, now_ns: int = SECOND) -> Chart:
    canvas, sharing = PaperCanvas(), Sharing(slots, limit_n=150.0)
    for message in messages:
        sharing.receive(message, now_ns)
    sharing.draw(canvas, now_ns)
    (chart,) = canvas.charts["/sharing"]
    return chart


def length(chart: Chart, slot: int) -> float:
    (bar,) = [strip for strip in chart.strips if strip.color == slot_color(slot)]
    return bar.points[1][0] - bar.points[0][0]


def test_bars_are_as_long_as_tension_and_ticks_stand_at_the_plan() -> None:
    plan = m.ExecutiveState(stage="hold", muscles=FIRST[:2], planned_tension_n=(10.0, 22.0))
    chart = shared([chain_state(SECOND), plan], Slots(16, FIRST))
    assert length(chart, 1) / length(chart, 0) == pytest.approx(1.1)
    ticks = [strip for strip in chart.strips if strip.color == TICK]
    assert len(ticks) == 2, "nobody planned for the third"
    bars = [strip for strip in chart.strips if strip.color in (slot_color(0), slot_color(1))]
    assert ticks[0].points[0][0] == pytest.approx(bars[0].points[1][0]), "felt as planned"
    assert ticks[1].points[0][0] > bars[1].points[1][0]
    assert [label.text for label in chart.labels] == [
        "triceps  10 N",
        "biceps_1  11 N",
        "biceps_2  12 N",
    ]
    assert not any(strip.color == LIMIT for strip in chart.strips), "the limit is far off"


def test_the_limit_is_drawn_once_the_scale_reaches_it() -> None:
    chart = shared([chain_state(SECOND, tension_n=140.0)], Slots(16, FIRST))
    (limit,) = [strip for strip in chart.strips if strip.color == LIMIT]
    assert limit.points[0][0] > max(
        strip.points[1][0] for strip in chart.strips if strip is not limit
    )


def test_seventy_four_bars_fit_and_have_no_names() -> None:
    names = tuple(f"m{i}" for i in range(74))
    chart = shared([chain_state(SECOND, names)], Slots(86, names))
    assert len(chart.strips) == 74
    assert [label.text for label in chart.labels] == ["full width 100 N"]
    assert NAMED < 74
    points = [point for strip in chart.strips for point in strip.points]
    assert all(0.0 <= x <= WIDE and 0.0 <= y <= 1.0 for x, y in points)


def test_a_muscle_that_fell_silent_has_no_bar_and_an_empty_chart_is_one() -> None:
    chart = shared([chain_state(SECOND)], Slots(16, FIRST), now_ns=3 * SECOND)
    assert chart == Chart([], [])


def progress(job: str, epoch: int, method: str = "iv", loss: float = 0.01) -> m.TrainingProgress:
    return m.TrainingProgress(
        job=job, stage="training", method=method, epoch=epoch, epochs=10, loss=loss, loss_new=loss
    )


def learned(*messages: m.TrainingProgress) -> Chart:
    canvas, learning = PaperCanvas(), Learning()
    for message in messages:
        learning.receive(message, SECOND)
    learning.draw(canvas, SECOND)
    learning.draw(canvas, 2 * SECOND)
    (chart,) = canvas.charts["/training"]
    return chart


def test_loss_goes_right_by_epoch_and_down_by_decade() -> None:
    chart = learned(*(progress("a", epoch, "ii", 10.0**-epoch) for epoch in (1, 2, 3)))
    (curve,) = [strip for strip in chart.strips if strip.color == ESTIMATED]
    steps = np.diff(np.array(curve.points), axis=0)
    assert steps[0] == pytest.approx(steps[1])
    assert (steps > 0.0).all()
    words = [label.text for label in chart.labels]
    assert {"method ii", "new motions  0.001", "0.1", "0.001", "epoch 0", "epoch 10"} <= set(words)


def test_older_jobs_fade_and_the_oldest_go() -> None:
    chart = learned(*(progress(f"job-{i}", epoch) for i in range(5) for epoch in (1, 2)))
    colors = [strip.color for strip in chart.strips]
    assert colors.count(ESTIMATED) == 1
    faded = tuple(round(0.45 * part) for part in ESTIMATED)
    assert colors.count(faded) == JOBS - 1


def test_a_job_that_begins_anew_begins_its_curve_anew_and_none_grows_for_ever() -> None:
    chart = learned(*(progress("a", epoch) for epoch in (1, 2, 3, 1, 2)))
    (curve,) = [strip for strip in chart.strips if strip.color == ESTIMATED]
    assert len(curve.points) == 2
    chart = learned(*(progress("a", epoch) for epoch in range(3 * POINTS)))
    (curve,) = [strip for strip in chart.strips if strip.color == ESTIMATED]
    assert len(curve.points) == POINTS


def test_before_anything_was_relearned_the_chart_says_so() -> None:
    assert [label.text for label in learned().labels] == ["nothing was relearned yet"]
