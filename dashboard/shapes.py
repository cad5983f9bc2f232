"""A link's primitives as Rerun draws them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from dashboard.canvas import Floats, Shape


def archetypes(kind: str, shapes: Sequence[Shape]) -> dict[str, rr.AsComponents]:
    """Shapes of one kind as what Rerun draws, by the entity's name: MJCF's sizes into its own."""
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
