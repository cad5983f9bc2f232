"""What the executive has to remember over its own death: task, posture, growth, known modules."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from runtime.logic import Store
from runtime.messages import MusclePath
from services.logic.growth import GrowthRecord

BLOB = "memory"


class Memory(msgspec.Struct):
    """What outlives the process."""

    task: str = ""
    step: int = 0
    goal_rad: tuple[float, ...] = ()  # posture that is held or aimed at
    holding: str = ""  # payload in the hand
    growth: GrowthRecord | None = None
    paths: dict[str, MusclePath] = {}  # how plugged muscles nominally run, as their hands said
    known: dict[str, int] = {}  # muscle -> serial number of modules that a schema has learned
    refused: list[str] = []  # muscles whose growth failed; tried again when plugged anew


class Notebook:
    """A `Memory` and where it is kept.

    Args:
        store: of the executive.
        steps: task -> number of its targets; a memory of another robot file's task is void.
        joints: how many the robot has.
    """

    def __init__(self, store: Store, steps: Mapping[str, int], joints: int) -> None:
        self._store = store
        self.memory = _fitting(_read(store), steps, joints)

    def save(self) -> None:
        """Keep the memory as it is now."""
        self._store.save(BLOB, msgspec.msgpack.encode(self.memory))


def _read(store: Store) -> Memory:
    data = store.load(BLOB)
    if data is None:
        return Memory()
    try:
        return msgspec.msgpack.decode(data, type=Memory)
    except msgspec.DecodeError:
        return Memory()  # a torn file is no reason not to hold the arm


def _fitting(memory: Memory, steps: Mapping[str, int], joints: int) -> Memory:
    task_fits = not memory.task or memory.step < steps.get(memory.task, 0)
    if task_fits and len(memory.goal_rad) in (0, joints):
        return memory
    # the robot file was changed
    return Memory(known=memory.known, holding=memory.holding, paths=memory.paths)
