"""A muscle's path as a body's file draws it."""

from __future__ import annotations

from typing import Any

from runtime.messages import MusclePath, Place

DOWN = (0.0, 0.0, -1.0)  # a body's file does not say where a wire leaves its module


def path_of_tendon(tendon: Any) -> MusclePath:
    """The path of one spatial tendon of a MuJoCo spec: sites on links, and geoms to wrap."""
    places = []
    for wrap in tendon.path:
        if wrap.type.name == "mjWRAP_SITE":
            x, y, z = (float(v) for v in wrap.target.pos)
            places.append(Place(link=wrap.target.parent.name, position_m=(x, y, z)))
        else:
            side = wrap.sidesite.name if wrap.sidesite else ""
            places.append(Place(wrap=wrap.target.name, side=side))
    return MusclePath(attachment=places[0], direction=DOWN, relays=tuple(places[1:]))
