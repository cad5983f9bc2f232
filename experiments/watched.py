"""A task in the rig as the robot's estimator sees it, and what truly was beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from experiments.collect import Array
from experiments.rig import Rig
from experiments.sequence import TASK_LIMIT_S
from experiments.session import RigSession
from runtime import messages as m
from runtime.messages import Message
from services.body_schema.schema import Schema


@dataclass(frozen=True, eq=False)
class Watched:
    """T estimates of N joints from M muscles, columns as in the schema that made them."""

    time_s: Array  # (T,) robot time
    tension_n: Array  # (T, M) as read
    length_m: Array  # (T, M) as read
    estimate_rad: Array  # (T, N) as published
    sigma_rad: Array  # (T, N) confidence, as published
    true_rad: Array  # (T, N) when the readings were made
    resting: NDArray[np.bool_]  # (T,) where the executive called the arm settled


class _Witness:
    """Keeps what comes by during one task."""

    def __init__(self, task: str) -> None:
        self.rows: list[tuple[m.JointEstimate, Array, bool]] = []
        self.truth: list[m.WorldTruth] = []
        self._task = task
        self._chains: dict[str, m.ChainState] = {}
        self._state: m.ExecutiveState | None = None

    def see(self, message: Message) -> None:
        """Take in a message."""
        match message:
            case m.ChainState():
                self._chains[message.chain] = message
            case m.ExecutiveState():
                self._state = message
            case m.WorldTruth():
                self.truth.append(message)
            case m.JointEstimate() if self._state and self._state.task == self._task:
                read = {
                    name: (state.tension_n[i], state.length_m[i])
                    for state in self._chains.values()
                    for i, name in enumerate(state.muscles)
                }
                readings = np.array([read[name] for name in message.muscles])
                self.rows.append((message, readings, self._state.settled))


def watch_task(rig: Rig, schema: Schema, task: str, stuck: str = "") -> Watched:
    """Run a task on a rig that holds, its estimator asking `schema`; `stuck` names a load cell.

    Raises:
        SessionError: the task was refused or did not end.
    """
    rig.estimator.receive(
        m.SchemaVersion(
            version=1,
            joints=schema.joints,
            muscles=schema.muscles,
            method="shipped",
            data=schema.to_bytes(),
        ),
        rig.now_ns,
    )
    session, witness = RigSession(rig), _Witness(task)
    if stuck:
        session.ask(m.Fault(kind="stuck", target=stuck, amount=1.0))
    rig.watchers.append(witness.see)
    session.ask(m.Task(name=task))
    session.wait(
        lambda x: isinstance(x, m.Event) and x.kind == "task_done", TASK_LIMIT_S, f"task '{task}'"
    )
    rig.watchers.remove(witness.see)
    estimates, readings, settled = zip(*witness.rows, strict=True)
    stamp_ns = np.array([x.stamp_ns for x in estimates])
    true_ns = np.array([x.stamp_ns for x in witness.truth])
    true_rad = np.array([x.angle_rad for x in witness.truth])
    order = [witness.truth[0].joints.index(name) for name in schema.joints]
    read = np.array(readings)
    return Watched(
        time_s=stamp_ns * 1e-9,
        tension_n=read[:, :, 0],
        length_m=read[:, :, 1],
        estimate_rad=np.array([x.angle_rad for x in estimates]),
        sigma_rad=np.array([x.confidence_rad for x in estimates]),
        true_rad=np.stack([np.interp(stamp_ns, true_ns, true_rad[:, k]) for k in order], axis=1),
        resting=np.array(settled),
    )
