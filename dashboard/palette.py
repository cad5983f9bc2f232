"""The dashboard's colours: one for each slot, state and tension, in all views."""

from __future__ import annotations

import colorsys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.growing import LEFT_OUT, OUTSIDE, TAKEN_IN

Rgb = tuple[int, int, int]

# Okabe and Ito's colours first, then lighter ones of Paul Tol's: told apart by colour-blind eyes,
# legible on dark and on light.
_SLOTS: tuple[Rgb, ...] = (
    (86, 180, 233),
    (0, 170, 125),
    (204, 121, 167),
    (230, 159, 0),
    (70, 130, 220),
    (213, 94, 0),
    (221, 204, 60),
    (150, 150, 150),
    (136, 204, 238),
    (68, 170, 153),
    (190, 90, 190),
    (221, 204, 119),
    (136, 119, 221),
    (204, 102, 119),
    (90, 180, 80),
    (190, 190, 190),
)
REFERENCE: Rgb = (170, 170, 170)
MEASURED: Rgb = (86, 180, 233)
ESTIMATED: Rgb = (230, 159, 0)
CONFIDENCE: Rgb = (140, 105, 40)
LIMIT: Rgb = (220, 60, 50)

# Pictures on light ground, for pages: Okabe and Ito's darker colours first.
INK, FAINT = "#33373d", "#9aa0a8"
ON_PAPER = ("#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#8c8c8c", "#44AA99", "#AA4499", "#332288")
STRONGEST = "#D55E00"  # what a picture is about
PAPER_STYLE: dict[Any, object] = {  # matplotlib's settings
    "font.size": 10.0,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": INK,
    "ytick.color": INK,
    "text.color": INK,
}

_GREY, _BLUE, _GREEN = (120, 120, 120), (70, 130, 200), (40, 150, 95)
_AMBER, _RED = (215, 150, 20), (205, 55, 45)
STAGE_COLORS: dict[str, Rgb] = {
    "waiting": _GREY,
    "hold": (80, 100, 125),
    "move": _BLUE,
    "join": (230, 190, 60),
    "collect": _AMBER,
    "relearn": (175, 90, 190),
    "adopt": (110, 95, 215),
    "resume": _GREEN,
    "park": _GREY,
    "stopped": _RED,
}
MODULE_COLORS: dict[str, Rgb] = {
    "joining": _AMBER,
    "up": _GREEN,
    OUTSIDE: _AMBER,
    TAKEN_IN: _AMBER,
    LEFT_OUT: _AMBER,
    "lost": _GREY,
    "fault": _RED,
    "stopped": _RED,
    "unplugged": (70, 70, 70),
}
PROCESS_COLORS: dict[str, Rgb] = {
    "starting": _AMBER,
    "ready": _GREEN,
    "backoff": (225, 120, 40),
    "failed": _RED,
    "stopped": _GREY,
}


def slot_color(slot: int) -> Rgb:
    """The colour of a slot. Past the sixteenth they are computed, and still never repeat."""
    if slot < len(_SLOTS):
        return _SLOTS[slot]
    red, green, blue = colorsys.hsv_to_rgb(slot * 0.618034 % 1.0, 0.55, 0.9)
    return round(red * 255), round(green * 255), round(blue * 255)


def tension_colors(fraction: NDArray[np.float64]) -> NDArray[np.uint8]:
    """From a slack wire's cool grey over amber to red at `fraction` 1: (W,) to (W, 3)."""
    steps = np.array([0.0, 0.5, 1.0])
    colors = np.array([(125, 150, 175), (240, 190, 60), (225, 45, 35)])
    parts = [np.interp(fraction, steps, part) for part in colors.T]
    return np.round(np.stack(parts, axis=-1)).astype(np.uint8)
