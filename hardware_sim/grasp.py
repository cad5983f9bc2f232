"""What the hands of a simulated robot hold: welds, switched on and off as hands close and open.

A payload is a free body of the body file, with a weld between it and the hand:
`<weld body1="hand" body2="dumbbell" active="false"/>`. A hand closes on what lies within its reach
and holds it as it lies: nothing jumps.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.settings import Payload

Array = NDArray[np.float64]

REACH_M = 0.06  # of a hand around the place where it holds the payload's centre
WELD = 1  # mjEQ_WELD
POSE = slice(3, 10)  # of a weld's data: where body 2 is seen from body 1, position and quaternion


class Grasp:
    """The payloads of one robot, and which of them are held.

    Attributes:
        held: payload -> its pose in the hand, (7,), position [m] and quaternion.
    """

    def __init__(self, payloads: tuple[Payload, ...]) -> None:
        self.payloads = {payload.name: payload for payload in payloads}
        self.held: dict[str, list[float]] = {}

    def close(self, model: Any, data: Any, name: str) -> bool:
        """Hold the payload, if it lies within reach.

        Raises:
            ValueError: there is no such payload, or the body has no weld for it.
        """
        payload = self.payloads.get(name)
        if payload is None:
            known = ", ".join(self.payloads) or "none"
            raise ValueError(f"no payload '{name}' in the robot file; there are: {known}")
        weld = next(self._welds(model, payload), None)
        if weld is None:
            raise ValueError(
                f"the body has no weld from '{payload.link}' to '{name}' to grasp it with"
            )
        if name in self.held:
            return True
        hand, thing = model.body(payload.link).id, model.body(name).id
        to_hand = np.asarray(data.xmat[hand]).reshape(3, 3).T
        position_m = to_hand @ (data.xpos[thing] - data.xpos[hand])
        if np.linalg.norm(position_m - payload.position_m) > REACH_M:
            return False
        turn = _product(_inverse(data.xquat[hand]), data.xquat[thing])
        self.held[name] = [*position_m.tolist(), *turn.tolist()]
        self._switch(model, data, weld, self.held[name])
        return True

    def open(self, model: Any, data: Any, name: str) -> None:
        """Let go of a payload of the robot file."""
        self.held.pop(name, None)
        for weld in self._welds(model, self.payloads[name]):
            data.eq_active[weld] = 0

    def bind(self, model: Any, data: Any) -> None:
        """Hold in a model that was compiled anew, or restored, what is held."""
        for name, payload in self.payloads.items():
            pose = self.held.get(name)
            for weld in self._welds(model, payload):
                if pose is None:
                    data.eq_active[weld] = 0
                else:
                    self._switch(model, data, weld, pose)

    def _welds(self, model: Any, payload: Payload) -> Iterator[int]:
        pair = (model.body(payload.link).id, model.body(payload.name).id)
        for index in range(model.neq):
            found = (int(model.eq_obj1id[index]), int(model.eq_obj2id[index]))
            if model.eq_type[index] == WELD and found == pair:
                yield index

    def _switch(self, model: Any, data: Any, weld: int, pose: list[float]) -> None:
        model.eq_data[weld, :3] = 0.0  # anchored at the payload's own origin
        model.eq_data[weld, POSE] = pose
        data.eq_active[weld] = 1


def _inverse(quaternion: Array) -> Array:
    return np.asarray(quaternion) * (1.0, -1.0, -1.0, -1.0)


def _product(a: Array, b: Array) -> Array:
    """Hamilton product of two quaternions (w, x, y, z)."""
    turned = a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])
    return np.concatenate(((a[0] * b[0] - a[1:] @ b[1:],), turned))
