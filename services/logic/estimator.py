"""Where are the joints? Answered from muscle tension and length alone, by the body schema.

Mask 011 gives a first answer, which is refined (`body_schema/posture.py`).

One estimate is made for each complete set of readings, about 100 times a second: every chain that
has muscles of the schema has said something new. It carries the stamp of the oldest reading in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from runtime.messages import (
    ChainState,
    Event,
    JointEstimate,
    Message,
    Reply,
    SchemaCandidate,
    SchemaVersion,
)
from runtime.settings import RobotSettings
from services.body_schema.posture import posture
from services.body_schema.schema import Schema, SchemaError

STALE_NS = 100_000_000  # a reading older than this tells nothing about now
EVERY_NS = 9_000_000  # readings sooner than this after those of the last estimate are passed over


class Estimator:
    """`ChainState` and `SchemaVersion` in, `JointEstimate` out.

    anomaly         |measured - predicted length| of a muscle, over its usual size
    confidence_rad  standard deviation, from the muscles' usual residuals and how they tell on the
                    joints; readings that do not fit the schema widen it in proportion
    """

    inputs: tuple[type[Message], ...] = (ChainState, SchemaVersion)
    requests: tuple[type[Message], ...] = ()
    outputs: tuple[type[Message], ...] = (JointEstimate,)
    period_ns = 100_000_000  # acts on what arrives; nothing falls due by itself

    def __init__(self, settings: RobotSettings) -> None:
        self._joints = settings.joints
        self._schema: Schema | None = None
        self._refused = ""  # said once: a retained schema comes again
        self._events: list[Event] = []
        self._states: dict[str, ChainState] = {}  # the newest of each chain
        self._unused: set[str] = set()  # chains heard from since the last estimate
        self._last_ns = -EVERY_NS  # stamp of that

    def receive(self, message: Message, now_ns: int) -> None:
        """Keep a chain's newest state; take a schema into use if it is whole and ours."""
        match message:
            case ChainState() if abs(message.stamp_ns - self._last_ns) >= EVERY_NS:
                self._states[message.chain] = message
                self._unused.add(message.chain)
            case SchemaCandidate():
                pass  # a kind of version that held-out motion has not passed yet
            case SchemaVersion():
                self._take(message, now_ns)

    def answer(self, request: Message, now_ns: int) -> Reply:
        """Nothing can be asked of the estimator."""
        return Reply(ok=False, text=f"the estimator answers no {type(request).__name__}")

    def tick(self, now_ns: int) -> Iterator[Message]:
        """One estimate, if a complete and fresh set of readings has come together."""
        yield from self._events
        self._events.clear()
        if self._schema is not None and self._unused:
            estimate = self._estimate(self._schema, now_ns)
            if estimate is not None:
                yield estimate

    def _take(self, message: SchemaVersion, now_ns: int) -> None:
        try:
            schema = Schema.from_bytes(message.data)
            if set(schema.joints) != set(self._joints):
                raise SchemaError(
                    f"it knows the joints {', '.join(schema.joints)};"
                    f" this robot has {', '.join(self._joints)}"
                )
        except ValueError as error:
            self._complain(message, str(error), now_ns)
        else:
            self._schema = schema
            self._refused = ""

    def _complain(self, message: SchemaVersion, reason: str, now_ns: int) -> None:
        kept = "the former one stays in use" if self._schema else "there is no estimate without one"
        text = f"schema version {message.version} refused: {reason}; {kept}"
        if text != self._refused:
            self._refused = text
            event = Event(
                stamp_ns=now_ns,
                process="estimator",
                level="error",
                kind="schema_refused",
                text=text,
                data={"version": str(message.version)},
            )
            self._events.append(event)

    def _estimate(self, schema: Schema, now_ns: int) -> JointEstimate | None:
        """None while the set is partial, or a muscle is missing, stale or unreadable."""
        at = {
            muscle: (state, tension, length)
            for state in self._states.values()
            if now_ns - state.stamp_ns <= STALE_NS
            for muscle, tension, length in zip(
                state.muscles, state.tension_n, state.length_m, strict=True
            )
        }
        if not at.keys() >= set(schema.muscles):
            return None
        readings = [at[muscle] for muscle in schema.muscles]
        if not {state.chain for state, _, _ in readings} <= self._unused:
            return None
        self._unused.clear()
        f = np.array([tension for _, tension, _ in readings])
        length = np.array([length for _, _, length in readings])
        if not math.isfinite(f.dot(length)):
            return None
        self._last_ns = min([state.stamp_ns for state, _, _ in readings])
        found = posture(schema, f, length)
        return JointEstimate(
            stamp_ns=self._last_ns,
            joints=schema.joints,
            angle_rad=tuple(found.angle_rad.tolist()),
            confidence_rad=tuple(found.sigma_rad.tolist()),
            muscles=schema.muscles,
            predicted_length_m=tuple(found.length_m.tolist()),
            predicted_tension_n=tuple(schema.tensions(found.angle_rad, length).tolist()),
            anomaly=tuple(np.abs(found.residual).tolist()),
            length_error_m=tuple((length - found.length_m).tolist()),
        )
