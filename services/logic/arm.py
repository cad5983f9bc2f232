"""The arm as the executive has it: what its modules last said, and how a posture becomes commands.

Postures are planned on the body schema (`body_schema/control.py`). Whenever control begins anew,
after a silence or with another schema, commands start from what the arm does at that moment and
cross-fade to the plan, so that nothing jumps. Muscles that the schema does not know are guests:
they follow with a small tension and never hold the posture.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from runtime.messages import (
    ChainBody,
    ChainCommand,
    ChainState,
    JointState,
    Message,
    ModuleInfo,
    Motion,
)
from runtime.settings import RobotSettings
from services.body_schema.control import Plan, plan
from services.body_schema.model import BodyModel
from services.body_schema.motions import SLACK_N
from services.body_schema.schema import Schema
from services.logic.guests import Guests
from services.logic.motion import Path, min_jerk
from services.logic.skeleton import Skeleton
from services.logic.wiring import served

Array = NDArray[np.float64]

AUTHOR = "executive"
STALE_NS = 100_000_000  # sensor data older than this are silence
LEASE_NS = 200_000_000
FADE_S = 0.8
FELT_S = 0.1  # time constant of what the model is found to be off by
CORRECT_S = 0.5  # in which that comes into effect, or goes
WIND_IN_M_S = 0.03  # a wire that hangs slack meanwhile
NO_SCHEMA = "waiting for a body schema: 'myograft learn' makes one"


class Arm:
    """Sensors in, commands out, for all chains of one robot. Joints (N,) are in file order."""

    def __init__(self, settings: RobotSettings, skeleton: Skeleton) -> None:
        self.settings = settings
        self.skeleton = skeleton
        self.schema: BodyModel | None = None
        self.path: Path | None = None
        self.plan: Plan | None = None
        self._asked: tuple[bytes, ...] = ()  # what the plan was made for
        self.excluded: set[str] = set()  # schema muscles that must not be relied on
        self.corrected = False  # whether lengths follow what the model is found to be off by
        self.drawn = False  # the model is the body file's: lengths always follow
        self.guests = Guests(settings, skeleton)
        self._bodies: dict[str, ChainBody] = {}
        self._muscles: dict[str, ModuleInfo] = {}  # by name, the first on the chains
        self._states: dict[str, ChainState] = {}
        self._felt: dict[str, tuple[float, float]] | None = None  # what they say, once asked for
        self._angles: dict[str, tuple[float, int]] = {}  # joint -> angle [rad], stamp
        self._off_m: dict[str, float] = {}  # length that is felt, less what the model says
        self._correction = 0.0  # how much of that is in effect, 0 to 1
        self._offset_m: dict[str, float] | None = None  # of targets from the plan, fading out
        self._fade_s = 0.0
        self._target_m: dict[str, float] = {}

    # ── sensing ───────────────────────────────────────────────────────────────────────────────

    def receive(self, message: Message) -> None:
        """Take in what the drivers say."""
        if isinstance(message, ChainState):
            self._states[message.chain] = message
            self._felt = None
        elif isinstance(message, JointState):
            for name, angle in zip(message.joints, message.angle_rad, strict=True):
                self._angles[name] = (angle, message.stamp_ns)
        elif isinstance(message, ChainBody):
            self._bodies[message.chain] = message
            self._muscles = {
                x.name: x for x in reversed(list(self.modules())) if x.kind == "muscle"
            }

    def silent(self, now_ns: int) -> str:
        """What is missing to move the arm, in words; empty when nothing is."""
        for chain in self.settings.chain:
            state = self._states.get(chain.name)
            if state is None or now_ns - state.stamp_ns > STALE_NS:
                return f"chain '{chain.name}' is silent"
            if chain.name not in self._bodies:
                return f"chain '{chain.name}' has not said who is plugged in"
        for joint in self.settings.joints:
            if joint not in self._angles or now_ns - self._angles[joint][1] > STALE_NS:
                return f"joint '{joint}' is silent"
        if self.schema is None:
            there = self.felt()
            missing = [name for name in self.settings.muscles if name not in there]
            return f"muscle '{missing[0]}' is not there" if missing else NO_SCHEMA
        return ""

    @property
    def stopped(self) -> bool:
        """Whether a stop is latched on any chain."""
        return any(state.mode in ("stopping", "stopped") for state in self._states.values())

    @property
    def angle_rad(self) -> Array:
        """Measured joint angles, shape (N,)."""
        return np.array([self._angles[name][0] for name in self.settings.joints])

    def felt(self) -> dict[str, tuple[float, float]]:
        """Length [m] and tension [N] of every muscle that is there."""
        if self._felt is None:
            self._felt = {
                name: (state.length_m[i], state.tension_n[i])
                for state in self._states.values()
                for i, name in enumerate(state.muscles)
            }
        return self._felt

    def modules(self) -> Iterator[ModuleInfo]:
        """All modules on all chains."""
        for body in self._bodies.values():
            yield from body.modules

    def module(self, muscle: str) -> ModuleInfo | None:
        """The module of one muscle, if a chain knows it."""
        return self._muscles.get(muscle)

    # ── moving ────────────────────────────────────────────────────────────────────────────────

    def served(self, schema: Schema) -> BodyModel:
        """What a schema has to control by: its wires, if they are all there, else its network."""
        return served(schema, self.settings.body_file, self.settings.joints)

    def use(self, schema: BodyModel) -> None:
        """Control by this from now on; commands cross-fade."""
        self.schema = schema
        self.drawn = False
        self.excluded &= set(schema.muscles)
        self.guests.take_in(schema.muscles)
        self.plan = None
        if self.path is not None:
            theta, _ = self.path.now()
            self.path = Path.between(theta, theta, self._floor(), self._floor(), 1.0)
        self._fade()

    def anchor(self) -> None:
        """Begin from what the arm does now: the next commands change nothing, then fade to plan."""
        self._target_m.clear()  # of before the silence: the arm need not be there any more
        self._fade()

    def _fade(self) -> None:
        self._offset_m = None
        self._fade_s = 0.0
        self._off_m.clear()  # part of what the arm does now: it comes in anew
        self._correction = 0.0

    def drop(self) -> None:
        """Forget where the arm was going: after a stop it stays where it is."""
        self.path = None
        self.plan = None
        self.anchor()

    def go(
        self, goal_rad: Array, extra_floor_n: Array | float = 0.0, speed_deg_s: float = 0.0
    ) -> None:
        """Set out for a posture (N,), every schema muscle at least at floor + extra (M,) there."""
        start, floor = (self.angle_rad, self._floor()) if self.path is None else self.path.now()
        low, high = self.skeleton.range_rad.T
        speed = np.radians(speed_deg_s or self.settings.control.joint_speed_deg_s)
        self.path = Path.between(
            start, np.clip(goal_rad, low, high), floor, self._floor() + extra_floor_n, speed
        )

    @property
    def reference_rad(self) -> Array:
        """Where the joints should be now, shape (N,)."""
        return self.angle_rad if self.path is None else self.path.now()[0]

    def resting_s(self) -> float:
        """How long the reference has stood at its goal with fading over; negative before."""
        if self.path is None:
            return -1.0
        return min(self.path.arrived_s, self._fade_s - FADE_S)

    def step(self, dt_s: float) -> None:
        """Let time pass and plan this moment."""
        assert self.schema is not None
        if self.path is None:
            self.go(self.angle_rad)
        assert self.path is not None
        self.path.advance(dt_s)
        felt = self.felt()
        theta, floor = self.path.now()
        usable = self._usable(felt)
        ceiling = self._ceiling(usable)
        self.guests.feel(self.schema, self.angle_rad, felt, dt_s)
        self.plan = self.planned(theta, np.minimum(floor, ceiling), ceiling)
        self._feel_errors(felt, dt_s)
        self._aim(felt, usable, dt_s)

    def planned(self, theta: Array, floor_n: Array, ceiling_n: Array) -> Plan:
        """Tensions and lengths for a posture (N,) between floor and ceiling, both (M,)."""
        assert self.schema is not None
        torque = self.skeleton.gravity_torque_nm(theta) - self.guests.torque_nm
        asked = tuple(x.tobytes() for x in (theta, torque, floor_n, ceiling_n))
        if self.plan is not None and self.plan.converged and asked == self._asked:
            return self.plan  # at rest: planning goes on from the last plan and would find it again
        self._asked = asked
        start = None if self.plan is None else self.plan.tension_n
        sharing = self.settings.control.sharing
        return plan(self.schema, theta, torque, floor_n, ceiling_n, start, sharing)

    def missing_nm(self, theta: Array) -> Array:
        """Torque (N,) that the muscles cannot give to hold a posture (N,); 0: it can be held."""
        if self.schema is None:
            return np.zeros(len(theta))
        ceiling = self._ceiling(set(self.schema.muscles) - self.excluded)
        torque = self.skeleton.gravity_torque_nm(theta) - self.guests.torque_nm
        sharing = self.settings.control.sharing
        floor = np.minimum(self._floor(), ceiling)
        return plan(self.schema, theta, torque, floor, ceiling, sharing=sharing).missing_nm

    def _feel_errors(self, felt: dict[str, tuple[float, float]], dt_s: float) -> None:
        """What the model's lengths are off by where the arm is now.

        A schema that is wrong by millimetres makes tension: 20 N for each, at 20 N/mm. While
        motions are collected, joints are measured, and targets follow what is found here. The
        length of a slack wire says nothing, and to follow it would pay out more: it is wound in.
        """
        step = dt_s / CORRECT_S if self.corrected or self.drawn else -dt_s / CORRECT_S
        self._correction = min(max(self._correction + step, 0.0), 1.0)
        if self._correction == 0.0:
            self._off_m.clear()
            return
        assert self.schema is not None
        names = [name for name in self.schema.muscles if name in felt]
        if len(names) < len(self.schema.muscles):
            return
        tension = np.array([max(felt[name][1], 0.0) for name in names])
        model = self.schema.lengths(self.angle_rad, tension)
        share = min(dt_s / FELT_S, 1.0)
        slack_n = max(SLACK_N, 0.5 * self.settings.control.tension_floor_n)
        for name, length in zip(names, model.tolist(), strict=True):
            off = felt[name][0] - length
            last = self._off_m.get(name, off)
            if felt[name][1] < slack_n:
                self._off_m[name] = last - WIND_IN_M_S * dt_s
            else:
                self._off_m[name] = last + (off - last) * share

    def _aim(self, felt: dict[str, tuple[float, float]], usable: set[str], dt_s: float) -> None:
        """Targets for all muscles: the plan, the fading offset, and never faster than the motor."""
        assert self.schema is not None and self.plan is not None
        stiffness = self.settings.control.stiffness_n_m
        plans = zip(self.plan.tension_n.tolist(), self.plan.length_m.tolist(), strict=True)
        planned = {
            name: plan
            for name, plan in zip(self.schema.muscles, plans, strict=True)
            if name in usable
        }
        if self._offset_m is None:
            # f_ref = f_plan + k (l - target) shall equal the tension that is there now
            self._offset_m = {
                name: felt[name][0] + (f - felt[name][1]) / stiffness - length
                for name, (f, length) in planned.items()
            }
        self._fade_s += dt_s
        share = 1.0 - min_jerk(self._fade_s / FADE_S)
        reach = self.settings.module.target_speed_m_s * dt_s
        targets: dict[str, float] = {}
        for name in felt:
            if name not in planned:
                targets[name] = felt[name][0]  # without stiffness it means nothing: follow
                self.guests.lead(name, felt[name][1], dt_s)
                continue
            target = planned[name][1] + share * self._offset_m.get(name, 0.0)
            target += self._correction * self._off_m.get(name, 0.0)
            last = self._target_m.get(name, target)
            targets[name] = min(max(target, last - reach), last + reach)
        self._target_m = targets

    def commands(self, now_ns: int) -> Iterator[ChainCommand]:
        """What `step` decided, one message a chain."""
        assert self.schema is not None and self.plan is not None
        planned = dict(zip(self.schema.muscles, self.plan.tension_n.tolist(), strict=True))
        for name in self.excluded:
            planned.pop(name, None)
        stiffness = self.settings.control.stiffness_n_m
        for chain, state in self._states.items():
            yield ChainCommand(
                stamp_ns=now_ns,
                chain=chain,
                author=AUTHOR,
                lease_ns=LEASE_NS,
                muscles=state.muscles,
                bias_n=tuple(
                    [
                        planned[name] if name in planned else self.guests.tension_n(name)
                        for name in state.muscles
                    ]
                ),
                stiffness_n_m=tuple(
                    [stiffness if name in planned else 0.0 for name in state.muscles]
                ),
                target_length_m=tuple([self._target_m[name] for name in state.muscles]),
            )

    def _usable(self, felt: dict[str, tuple[float, float]]) -> set[str]:
        assert self.schema is not None
        return (set(self.schema.muscles) & set(felt)) - self.excluded

    def _ceiling(self, usable: set[str]) -> Array:
        assert self.schema is not None
        most_n = self.settings.control.tension_ceiling_n
        return np.array([most_n if name in usable else 0.0 for name in self.schema.muscles])

    def _floor(self) -> Array:
        assert self.schema is not None
        return np.full(len(self.schema.muscles), self.settings.control.tension_floor_n)


class MotionRecorder:
    """Collects what the sensors say during one motion, as (T, N) and (T, M) rows."""

    def __init__(self, muscles: tuple[str, ...]) -> None:
        self.muscles = muscles
        self._rows: list[tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...], bool]] = []

    def sample(self, arm: Arm, settled: bool) -> None:
        """Take one row; a moment at which a muscle is missing is left out."""
        felt = arm.felt()
        if any(name not in felt for name in self.muscles):
            return
        self._rows.append(
            (
                tuple(arm.angle_rad.tolist()),
                tuple(felt[name][1] for name in self.muscles),
                tuple(felt[name][0] for name in self.muscles),
                settled,
            )
        )

    def motion(self) -> Motion:
        """All rows taken so far."""
        theta, f, length, settled = zip(*self._rows, strict=True) if self._rows else ((),) * 4
        return Motion(angle_rad=theta, tension_n=f, length_m=length, settled=settled)
