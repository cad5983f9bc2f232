"""The canvas that Rerun is: every verb as an archetype, into a file and a server."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from dashboard.blueprint import TIMELINE
from dashboard.canvas import Angles, Axis, Chart, Floats, Muscles, Poses, Shape, Wires
from dashboard.columns import (
    Times,
    column,
    field_names,
    flags,
    packed_colors,
    scalars,
    strips,
    table,
    vectors,
    words,
)
from dashboard.palette import Rgb
from dashboard.shapes import archetypes
from dashboard.viewer import LOOPBACK

SERVER_MEMORY = "64MiB"  # of the newest data, for who joins late; all of it is in the file
MODULE_RADIUS_M = 0.008
_ROOT = "tf#/"  # Rerun's name for the frame of the entity `/`


def segment_file(run_dir: Path, robot: str) -> Path:
    """Where this process writes: a restarted one begins a new file, `elbow-2.rrd`."""
    path, count = run_dir / f"{robot}.rrd", 1
    while path.exists():
        count += 1
        path = run_dir / f"{robot}-{count}.rrd"
    return path


class RerunCanvas:
    """Draws on Rerun. Files of one `run` have one recording id, so a viewer shows one run."""

    def __init__(
        self,
        robot: str,
        run: str,
        axes: Sequence[Axis],
        blueprint: rrb.Blueprint,
        file: Path,
        port: int = 0,
    ) -> None:
        self._fields = list(field_names([axis.joint for axis in axes]).values())
        self._scales = np.array([axis.scale for axis in axes])
        self._stream = rr.RecordingStream(f"myograft {robot}", recording_id=f"{robot}-{run}")
        sinks: list[rr.FileSink | rr.GrpcServerSink] = [
            # No footer: without one the file can be read after the process was killed.
            rr.FileSink(str(file), write_footer=False)
        ]
        if port:
            sinks.append(rr.GrpcServerSink(LOOPBACK, port, server_memory_limit=SERVER_MEMORY))
        self._stream.set_sinks(*sinks, default_blueprint=blueprint)
        self._stream.send_recording_name(f"{robot} {run}")
        self.url = f"rerun+http://{LOOPBACK}:{port}/proxy" if port else ""

    def close(self) -> None:
        """Write out what waits, and end server and file."""
        self._stream.flush(timeout_sec=2.0)
        self._stream.disconnect()

    def _send(self, path: str, times_s: Floats, *columns: rr.ComponentColumn) -> None:
        self._stream.send_columns(path, [Times(TIMELINE, times_s)], columns)

    def lines(
        self, path: str, names: Sequence[str], colors: Sequence[Rgb], widths: Sequence[float]
    ) -> None:
        """Name and colour a vector's slots."""
        style = rr.SeriesLines(
            names=[name or "free slot" for name in names],
            colors=colors,
            widths=widths,
            visible_series=[bool(name) for name in names],
        )
        self._stream.log(path, style, static=True)

    def columns(self, path: str, times_s: Floats, values: Floats) -> None:
        """Rows (T, slots) of a vector."""
        flat = pa.array(np.ascontiguousarray(values).ravel())
        self._send(path, times_s, column(rr.Scalars.descriptor_scalars(), flat, len(values)))

    def muscles(self, times_s: Floats, muscles: Muscles) -> None:
        """Rows of all muscles: one entity, so that many muscles cost little more than few."""
        shown = {
            "tension_n": muscles.tension_n,
            "planned_n": muscles.planned_n,
            "length_error_mm": muscles.length_error_m * 1e3,
            "anomaly": muscles.anomaly,
        }
        columns = [
            column(rr.ComponentDescriptor(f"muscle:{name}"), scalars(values.ravel()), len(values))
            for name, values in shown.items()
        ]
        self._send("/muscle", times_s, *columns)

    def angles(self, times_s: Floats, angles: Angles) -> None:
        """Rows of all joints: in radians as they came, and as a person reads them.

        One entity for all joints, a field each; the blueprint tells each plot which field is its.
        """
        columns = []
        for name, values in zip(angles._fields, angles, strict=True):
            shown = values * self._scales
            if values is angles.confidence_rad:
                shown *= shown  # as a variance: so Rerun draws a band of one standard deviation
            for kind, array in (("rad", values), ("shown", shown)):
                descriptor = rr.ComponentDescriptor(f"{kind}:{name.removesuffix('_rad')}")
                columns.append(column(descriptor, table(array, self._fields)))
        self._send("/joint", times_s, *columns)

    def chart(self, path: str, time_s: float, chart: Chart) -> None:
        """Lines and words of a chart. A word is the label of a line without length."""
        lines = [*(strip.points for strip in chart.strips), *((x.point,) for x in chart.labels)]
        colors = [strip.color for strip in chart.strips] + [x.color for x in chart.labels]
        widths = [strip.width for strip in chart.strips] + [0.0] * len(chart.labels)
        texts = [""] * len(chart.strips) + [label.text for label in chart.labels]
        points = np.array([point for line in lines for point in line], dtype=float)
        counts = np.array([len(line) for line in lines], dtype=np.int32)
        self._send(
            path,
            np.array([time_s]),
            column(rr.LineStrips2D.descriptor_strips(), strips(points.reshape(-1, 2), counts), 1),
            column(rr.LineStrips2D.descriptor_radii(), scalars(np.array(widths) / 2.0), 1),
            column(
                rr.LineStrips2D.descriptor_colors(),
                packed_colors(np.array(colors, dtype=np.uint8)),
                1,
            ),
            column(rr.LineStrips2D.descriptor_labels(), words(texts), 1),
            column(rr.LineStrips2D.descriptor_show_labels(), flags([True]), 1),
        )

    def lane(self, path: str, colors: dict[str, Rgb]) -> None:
        """Say which states a lane knows."""
        known = rr.StateConfiguration(values=list(colors), colors=list(colors.values()))
        self._stream.log(path, known, static=True)

    def state(self, path: str, time_s: float, state: str) -> None:
        """A lane changes its state."""
        self._stream.set_time(TIMELINE, duration=time_s)
        self._stream.log(path, rr.StateChange(state=state))

    def text(self, time_s: float, text: str, level: str) -> None:
        """One line of the log."""
        self._stream.set_time(TIMELINE, duration=time_s)
        self._stream.log("/event", rr.TextLog(text, level=level))

    def status(self, time_s: float, markdown: str) -> None:
        """What a person should know now."""
        self._stream.set_time(TIMELINE, duration=time_s)
        self._stream.log("/status", rr.TextDocument(markdown, media_type="text/markdown"))

    def shapes(self, link: str, shapes: Sequence[Shape]) -> None:
        """A link's primitives, once, grouped by kind, in the link's frame."""
        by_kind = groupby(sorted(shapes, key=lambda s: s.kind), key=lambda s: s.kind)
        frame = [] if link == "world" else [rr.CoordinateFrame(link)]
        for kind, group in by_kind:
            for name, archetype in archetypes(kind, list(group)).items():
                self._stream.log(f"/robot/{link}/{name}", archetype, *frame, static=True)

    def poses(self, time_s: float, links: Sequence[str], poses: Poses) -> None:
        """Where all links are: one entity, as ROS has its `/tf`."""
        self._send(
            "/robot/frames",
            np.full(len(links), time_s),
            column(rr.Transform3D.descriptor_translation(), vectors(poses.position_m)),
            column(
                rr.Transform3D.descriptor_quaternion(),
                vectors(np.roll(poses.quaternion_wxyz, -1, axis=1)),
            ),
            column(rr.Transform3D.descriptor_child_frame(), words(links)),
            column(rr.Transform3D.descriptor_parent_frame(), words([_ROOT] * len(links))),
        )

    def wires(self, time_s: float, wires: Wires) -> None:
        """All wires and the modules that they come from as one entity."""
        starts = np.cumsum(wires.counts) - wires.counts
        line, module = rr.LineStrips3D, rr.Points3D
        self._send(
            "/wires",
            np.array([time_s]),
            column(line.descriptor_strips(), strips(wires.points_m, wires.counts), 1),
            column(line.descriptor_radii(), scalars(wires.radius_m), 1),
            column(line.descriptor_colors(), packed_colors(wires.colors), 1),
            column(module.descriptor_positions(), vectors(wires.points_m[starts]), 1),
            column(module.descriptor_radii(), scalars(np.array([MODULE_RADIUS_M])), 1),
            column(module.descriptor_colors(), packed_colors(wires.module_colors), 1),
            column(module.descriptor_labels(), words(wires.labels), 1),
            column(module.descriptor_show_labels(), flags([any(wires.labels)]), 1),
        )
