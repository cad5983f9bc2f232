"""An arm that is told what it feels: the elbow's, by its shipped schema, without a simulator."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from experiments.rig import shipped_schema
from runtime.messages import ChainBody, ChainCommand, ChainState, JointState, ModuleInfo
from runtime.settings import load_robot
from services.body_schema.schema import Schema
from services.logic.arm import Arm
from services.logic.skeleton import Skeleton

MS = 1_000_000
DT_S = 0.01
SETTINGS = load_robot("elbow")
SKELETON = Skeleton(SETTINGS.body_file, SETTINGS.joints)
K = SETTINGS.control.stiffness_n_m


def shipped() -> Schema:
    data = shipped_schema(SETTINGS)
    assert data is not None
    return Schema.from_bytes(data)


@dataclass
class Bench:
    """Says what chain and joint say; lengths are as the shipped schema has them, plus a shift."""

    muscles: tuple[str, ...] = SETTINGS.muscles
    angle_rad: float = 0.5
    tension_n: dict[str, float] = field(default_factory=dict)
    shift_m: dict[str, float] = field(default_factory=dict)  # of lengths from what h expects
    now_ns: int = 1_000 * MS
    mode: str = "follow"
    kind: type[Arm] = Arm

    def __post_init__(self) -> None:
        self.arm = self.kind(SETTINGS, SKELETON)
        self.schema = shipped()
        self.arm.use(self.schema)
        self.tension_n = {name: 12.0 for name in self.muscles} | self.tension_n
        self.feel()

    def feel(self) -> None:
        """The chain and the joint speak."""
        known = self.schema.muscles
        f = np.array([self.tension_n.get(name, 0.0) for name in known])
        length = dict(zip(known, self.schema.lengths(np.array([self.angle_rad]), f), strict=True))
        modules = tuple(
            ModuleInfo(name=name, kind="muscle", module_id=2 + k, serial=50 + k, state="up")
            for k, name in enumerate(self.muscles)
        )
        self.arm.receive(ChainBody(chain="arm", modules=modules))
        self.arm.receive(
            ChainState(
                stamp_ns=self.now_ns,
                chain="arm",
                muscles=self.muscles,
                length_m=tuple(
                    float(length.get(name, 0.0)) + self.shift_m.get(name, 0.0)
                    for name in self.muscles
                ),
                tension_n=tuple(self.tension_n[name] for name in self.muscles),
                temperature_degc=tuple(25.0 for _ in self.muscles),
                target_length_m=tuple(0.0 for _ in self.muscles),
                mode=self.mode,
            )
        )
        joint = JointState(
            stamp_ns=self.now_ns, source="arm", joints=("elbow",), angle_rad=(self.angle_rad,)
        )
        self.arm.receive(joint)

    def step(self) -> ChainCommand:
        """One tick later."""
        self.now_ns += 10 * MS
        self.feel()
        self.arm.step(DT_S)
        (command,) = self.arm.commands(self.now_ns)
        return command

    def run(self, seconds: float) -> ChainCommand:
        for _ in range(round(seconds / DT_S) - 1):
            self.step()
        return self.step()

    def reference_n(self, command: ChainCommand) -> dict[str, float]:
        """The tension that a command asks for, by the law that modules obey (paper, eq. 1)."""
        felt = self.arm.felt()
        rows = zip(
            command.muscles,
            command.bias_n,
            command.stiffness_n_m,
            command.target_length_m,
            strict=True,
        )
        return {name: f + k * (felt[name][0] - target) for name, f, k, target in rows}
