"""The layout made for this work.

The body on the left and how its muscles share the work, what joints and wires do on the right, and
below who is in which state and what happened. Plots show the last seconds and follow; ids of views
stay the same over restarts.
"""

from __future__ import annotations

import uuid
from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint import encodings
from rerun.blueprint.api import VisualizerLike

from dashboard.canvas import Axis, Floats
from dashboard.charts import WIDE
from dashboard.columns import field_names
from dashboard.palette import ESTIMATED, MEASURED, REFERENCE

TIMELINE = "robot time"
WINDOW_S = 30.0
LANES_S = 60.0
SMALL = 12  # joints; so many are also shown side by side
_VIEWS = uuid.UUID("6d796f67-7261-6674-0000-000000000000")  # view ids stay over restarts
_DARK = (28, 30, 34)


def layout(
    axes: Sequence[Axis],
    low_m: Floats,
    high_m: Floats,
    limit_n: float,
    role: str = "",
    many: bool = False,
) -> rrb.Blueprint:
    """The whole screen for a robot.

    Args:
        axes: its joints.
        low_m: lowest corner of the box that the body fills.
        high_m: highest corner.
        limit_n: of tension.
        role: the tensions of this role's muscles come first.
        many: there are so many muscles that they need room.
    """
    roles = [_plot(f"Tension, {role} (N)", "/role", "/limit/zero")] if role else []
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Vertical(
                    _named("body", _body(low_m, high_m)),
                    _chart("Load now: felt (bar), planned (tick)", "/sharing"),
                    _named("now", rrb.TextDocumentView(origin="/status", name="Now")),
                    row_shares=[2.6, 2.0, 1.0] if many else [3.0, 1.5, 1.0],
                ),
                rrb.Vertical(
                    _angles(axes),
                    rrb.Tabs(
                        *roles,
                        _muscles(
                            f"Tension (N), limit {limit_n:g}",
                            "tension_n",
                            "/limit/tension",
                            "/limit/zero",
                        ),
                        _muscles("Planned tension (N)", "planned_n", "/limit/zero"),
                        name="tension",
                    ),
                    rrb.Tabs(
                        _muscles(
                            "Length error: felt - predicted (mm)",
                            "length_error_mm",
                            "/limit/zero",
                        ),
                        _muscles("Anomaly (x usual)", "anomaly", "/limit/anomaly"),
                        _plot(
                            "Temperature (°C)",
                            "/temperature",
                            "/limit/temperature",
                            window_s=300.0,
                        ),
                        _chart("Loss by epoch", "/training"),
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
                    _lanes("What the robot does", "/executive", "/module/**"),
                    _lanes("Processes", "/process/**"),
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
    lines: Sequence[VisualizerLike] = (),
    legend: bool = True,
) -> rrb.View:
    """Curves over the last seconds.

    Args:
        name: of the view; also what its id is made of.
        paths: entities; with `lines` one, which these draw instead of what would by itself.
        window_s: how far back.
        shown: the range of values that is worth the height.
        lines: what to draw of which of an entity's fields.
        legend: whether there is room for one.
    """
    return _named(
        f"{paths[0]} {name}",
        rrb.TimeSeriesView(
            origin="/",
            contents=list(paths),
            name=name,
            axis_x=rrb.TimeAxis(view_range=_window(window_s), zoom_lock=True),
            axis_y=rrb.ScalarAxis(range=shown) if shown else None,
            time_ranges=[_visible(window_s)],
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=legend),
            overrides={paths[0]: lines} if lines else None,
        ),
    )


def _muscles(name: str, value: str, *paths: str) -> rrb.View:
    """One of the values of all muscles; their names and colours stand beside them."""
    line = rr.SeriesLines().visualizer(mappings=[_of("Scalars:scalars", f"muscle:{value}")])
    return _plot(name, "/muscle", *paths, lines=[line])


def _of(target: str, component: str, field: str = "") -> encodings.VisualizerComponentMapping:
    """What a line is drawn of: a component of the entity, or one field of it."""
    return encodings.VisualizerComponentMapping(
        target=target,
        source_kind=encodings.ComponentSourceKind.SourceComponent,
        source_component=component,
        selector=f".{field}" if field else None,
    )


def _angles(axes: Sequence[Axis]) -> rrb.View | rrb.Container:
    """A plot a joint; of several, all side by side first."""
    fields = field_names([axis.joint for axis in axes])
    if len(axes) == 1:
        return _angle(axes[0], fields[axes[0].joint], "Angle of {joint} ({unit})")
    plots: list[rrb.View | rrb.Container] = [
        _angle(axis, fields[axis.joint], "{joint} ({unit})") for axis in axes
    ]
    if len(axes) <= SMALL:
        same = len({axis.unit for axis in axes}) == 1
        units = f" ({axes[0].unit})" if same else ""
        small = [_angle(axis, fields[axis.joint], "{joint}", legend=False) for axis in axes]
        plots.insert(0, rrb.Grid(*small, grid_columns=min(len(axes), 5), name=f"All joints{units}"))
    return rrb.Tabs(*plots, name="joints")


def _angle(axis: Axis, field: str, name: str, legend: bool = True) -> rrb.View:
    """Wanted, measured, and estimated with a band of one standard deviation."""

    def line(words: str, value: str, color: Sequence[int], width: float) -> VisualizerLike:
        style = rr.SeriesLines(names=[words], colors=[color], widths=[width])
        return style.visualizer(mappings=[_of("Scalars:scalars", f"shown:{value}", field)])

    estimated = rr.Measurements(
        [], names=["estimated from the wires ± 1 σ"], colors=[ESTIMATED], widths=[1.2]
    ).visualizer(
        mappings=[
            _of("Measurements:values", "shown:estimated", field),
            _of("Measurements:variances", "shown:confidence", field),
        ]
    )
    words = name.format(joint=axis.joint, unit=axis.unit)
    lines = (
        estimated,
        line("reference", "reference", REFERENCE, 1.2),
        line("measured", "measured", MEASURED, 4.0),
    )
    return _plot(words, "/joint", shown=axis.shown, lines=lines, legend=legend)


def _chart(name: str, path: str) -> rrb.View:
    bounds = rrb.VisualBounds2D(x_range=[0.0, WIDE], y_range=[0.0, 1.0])
    view = rrb.Spatial2DView(origin=path, name=name, background=_DARK, visual_bounds=bounds)
    return _named(path, view)


def _lanes(name: str, *paths: str) -> rrb.View:
    return _named(
        name,
        rrb.StateTimelineView(
            origin="/",
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
        contents=["/robot/**", "/wires"],
        name="Body at the measured angles, wires coloured by tension",
        background=_DARK,
        line_grid=rrb.LineGrid3D(visible=False),
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=center + reach * np.array([0.6, -0.75, 0.15]),
            look_target=center,
            eye_up=(0.0, 0.0, 1.0),
        ),
    )
