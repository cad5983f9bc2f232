"""The canvas that Rerun is: every verb as an archetype, into a file and a server."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dashboard.blueprint import TIMELINE
from dashboard.canvas import Floats, Shape, Wire
from dashboard.palette import Rgb
from dashboard.viewer import LOOPBACK

SERVER_MEMORY = "256MiB"
MODULE_RADIUS_M = 0.008


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
        blueprint: rrb.Blueprint,
        file: Path,
        port: int = 0,
    ) -> None:
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

    def lines(
        self, path: str, names: Sequence[str], colors: Sequence[Rgb], widths: Sequence[float]
    ) -> None:
        """Name and colour a vector's slots."""
        style = rr.SeriesLines(
            names=[name or "(free)" for name in names],
            colors=colors,
            widths=widths,
            visible_series=[bool(name) for name in names],
        )
        self._stream.log(path, style, static=True)

    def columns(self, path: str, times_s: Floats, values: Floats) -> None:
        """Rows (T, slots) of a vector."""
        times = rr.TimeColumn(TIMELINE, duration=times_s)
        self._stream.send_columns(path, [times], rr.Scalars.columns(scalars=values))

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
        """A link's primitives, once, grouped by kind."""
        by_kind = groupby(sorted(shapes, key=lambda s: s.kind), key=lambda s: s.kind)
        for kind, group in by_kind:
            for name, archetype in _archetypes(kind, list(group)).items():
                self._stream.log(f"/robot/{link}/{name}", archetype, static=True)

    def pose(self, time_s: float, link: str, position_m: Floats, quaternion_wxyz: Floats) -> None:
        """Where a link is."""
        self._stream.set_time(TIMELINE, duration=time_s)
        turn = rr.Quaternion(xyzw=np.roll(quaternion_wxyz, -1))
        self._stream.log(f"/robot/{link}", rr.Transform3D(translation=position_m, quaternion=turn))

    def wires(self, time_s: float, wires: Sequence[Wire]) -> None:
        """All wires as one entity, and the modules they come from as another."""
        self._stream.set_time(TIMELINE, duration=time_s)
        strips = rr.LineStrips3D(
            [wire.points_m for wire in wires],
            radii=[wire.radius_m for wire in wires],
            colors=[wire.color for wire in wires],
        )
        modules = rr.Points3D(
            [wire.points_m[0] for wire in wires],
            radii=[MODULE_RADIUS_M] * len(wires),
            colors=[wire.module_color for wire in wires],
            labels=[wire.label for wire in wires],
            show_labels=any(wire.label for wire in wires),
        )
        self._stream.log("/wires", strips)
        self._stream.log("/modules", modules)


def _archetypes(kind: str, shapes: Sequence[Shape]) -> dict[str, rr.AsComponents]:
    """MJCF sizes into Rerun's: radius, half length, half extents."""
    sizes = [shape.size_m for shape in shapes]
    centers = [shape.position_m for shape in shapes]
    turns = [np.roll(shape.quaternion_wxyz, -1) for shape in shapes]
    colors = [shape.color for shape in shapes]
    solid = rr.components.FillMode.Solid
    if kind == "mesh":
        return {
            f"mesh_{i}": rr.Mesh3D(
                vertex_positions=_placed(shape), triangle_indices=shape.faces, albedo_factor=color
            )
            for i, (shape, color) in enumerate(zip(shapes, colors, strict=True))
        }
    if kind == "capsule":
        # Rerun's capsules begin at their origin, MuJoCo's are centred.
        starts = [
            np.array(shape.position_m) - _turned(shape, np.array([0.0, 0.0, shape.size_m[1]]))
            for shape in shapes
        ]
        return {
            "capsules": rr.Capsules3D(
                lengths=[2.0 * size[1] for size in sizes],
                radii=[size[0] for size in sizes],
                translations=starts,
                quaternions=turns,
                colors=colors,
                fill_mode=solid,
            )
        }
    if kind == "cylinder":
        return {
            "cylinders": rr.Cylinders3D(
                lengths=[2.0 * size[1] for size in sizes],
                radii=[size[0] for size in sizes],
                centers=centers,
                quaternions=turns,
                colors=colors,
                fill_mode=solid,
            )
        }
    if kind == "box":
        boxes = rr.Boxes3D(
            half_sizes=sizes, centers=centers, quaternions=turns, colors=colors, fill_mode=solid
        )
        return {"boxes": boxes}
    halves = [(size[0],) * 3 if kind == "sphere" else size for size in sizes]
    ellipsoids = rr.Ellipsoids3D(
        half_sizes=halves, centers=centers, quaternions=turns, colors=colors, fill_mode=solid
    )
    return {kind: ellipsoids}


def _turned(shape: Shape, vectors: Floats) -> Floats:
    """Vectors (..., 3) turned by the shape's quaternion."""
    w, *xyz = shape.quaternion_wxyz
    axis: Floats = np.array(xyz)
    across: Floats = np.cross(axis, vectors)
    turned: Floats = vectors + 2.0 * (w * across + np.cross(axis, across))
    return turned


def _placed(shape: Shape) -> Floats:
    if shape.vertices_m is None:
        return np.zeros((0, 3))
    placed: Floats = _turned(shape, shape.vertices_m) + np.array(shape.position_m)
    return placed
