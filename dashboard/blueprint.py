"""The layout made for this work.

The body on the left, what its wires do on the right, and below who is in which state and what
happened. Plots show the last seconds and follow; ids of views stay the same over restarts.
"""

from __future__ import annotations

import uuid
from collections.abc import Mapping

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint import encodings

from dashboard.canvas import Floats

TIMELINE = "robot time"
WINDOW_S = 30.0
LANES_S = 60.0
_VIEWS = uuid.UUID("6d796f67-7261-6674-0000-000000000000")  # view ids stay over restarts


def layout(
    ranges_deg: Mapping[str, tuple[float, float] | None],
    low_m: Floats,
    high_m: Floats,
    role: str = "",
) -> rrb.Blueprint:
    """The whole screen for a robot with these joints whose body fills this box (m).

    With `role`, the tensions of that role's muscles come first.
    """
    roles = [_plot(f"Tension of {role} (N)", "/role", "/limit/zero")] if role else []
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Vertical(
                    _named("body", _body(low_m, high_m)),
                    _named(
                        "now",
                        rrb.TextDocumentView(origin="/status", name="Now"),
                    ),
                    row_shares=[3.4, 1],
                ),
                rrb.Vertical(
                    _angles(ranges_deg),
                    rrb.Tabs(
                        *roles,
                        _plot("Tension (N)", "/tension", "/limit/tension", "/limit/zero"),
                        _plot("Planned tension (N)", "/planned", "/limit/zero"),
                        name="tension",
                    ),
                    rrb.Tabs(
                        _plot(
                            "Length error, target - measured (mm)", "/length_error", "/limit/zero"
                        ),
                        _plot("Anomaly (times usual residual)", "/anomaly", "/limit/anomaly"),
                        _plot("Training loss (log10)", "/training", window_s=120.0),
                        _plot("Temperature (°C)", "/temperature", window_s=300.0),
                        _plot("CPU (% of a core)", "/load/cpu", window_s=120.0),
                        _plot("Memory (MB)", "/load/memory", window_s=300.0),
                        _plot("Real-time factor", "/factor", window_s=120.0),
                        name="more",
                    ),
                ),
                column_shares=[1, 1.7],
            ),
            rrb.Horizontal(
                rrb.Tabs(
                    _lanes("What the robot does", "/lane/executive", "/lane/module/**"),
                    _lanes("Processes", "/lane/process/**"),
                    name="states",
                ),
                _named("log", _log()),
                column_shares=[1.35, 1],
            ),
            row_shares=[2.6, 1],
        ),
        rrb.TopPanel(state="collapsed"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="Following"),
        auto_views=False,
        auto_layout=False,
    )


def _named(key: str, view: rrb.View) -> rrb.View:
    view.id = uuid.uuid5(_VIEWS, key)
    return view


def _window(seconds: float) -> rr.TimeRange:
    cursor = rrb.TimeRangeBoundary.cursor_relative
    return rr.TimeRange(start=cursor(seconds=-seconds), end=cursor(seconds=0.0))


def _visible(seconds: float) -> rrb.VisibleTimeRange:
    cursor = rrb.TimeRangeBoundary.cursor_relative
    return rrb.VisibleTimeRange(TIMELINE, start=cursor(seconds=-seconds), end=cursor())


def _plot(
    name: str,
    *paths: str,
    window_s: float = WINDOW_S,
    shown: tuple[float, float] | None = None,
) -> rrb.View:
    """Curves over the last seconds; `shown` is the range of values that is worth the height."""
    return _named(
        paths[0],
        rrb.TimeSeriesView(
            origin="/",
            contents=list(paths),
            name=name,
            axis_x=rrb.TimeAxis(view_range=_window(window_s), zoom_lock=True),
            axis_y=rrb.ScalarAxis(range=shown),
            time_ranges=[_visible(window_s)],
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        ),
    )


def _angles(
    ranges_deg: Mapping[str, tuple[float, float] | None],
) -> rrb.View | rrb.Container:
    plots = [
        _plot(f"Angle of {joint} (deg)", f"/angle/{joint}", shown=shown)
        for joint, shown in ranges_deg.items()
    ]
    return plots[0] if len(plots) == 1 else rrb.Tabs(*plots, name="angles")


def _lanes(name: str, *paths: str) -> rrb.View:
    return _named(
        name,
        rrb.StateTimelineView(
            origin="/lane",
            contents=list(paths),
            name=name,
            time_view=rrb.TimeAxis(view_range=_window(LANES_S), zoom_lock=True),
        ),
    )


def _log() -> rrb.View:
    column, kind = encodings.TextLogColumn, encodings.TextLogColumnKind
    return rrb.TextLogView(
        origin="/event",
        name="Events",
        columns=rrb.TextLogColumns(
            text_log_columns=[
                column(kind.EntityPath, visible=False),
                column(kind.LogLevel, visible=True),
                column(kind.Body, visible=True),
            ]
        ),
    )


def _body(low_m: Floats, high_m: Floats) -> rrb.View:
    center = (low_m + high_m) / 2.0
    reach = float(max(high_m - low_m))
    return rrb.Spatial3DView(
        origin="/",
        contents=["/robot/**", "/wires", "/modules"],
        name="Body at the measured angles, wires coloured by tension",
        background=(28, 30, 34),
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=center + reach * np.array([0.6, -0.75, 0.15]),
            look_target=center,
            eye_up=(0.0, 0.0, 1.0),
        ),
    )
