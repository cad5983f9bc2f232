"""The body in MuJoCo, with wires that muscle modules wind.

Any MJCF with spatial tendons is a body. Each tendon becomes a wire: an elastic element (polynomial
tendon spring) whose rest length is MuJoCo *state* (`springyield`), which the motor writes; friction
of the wire on its guides is the tendon's friction loss, set each step from the tension. Muscle
actuators in the file are ignored. A muscle added while running is compiled in with the state kept.

Every attachment is displaced by an assembly error, as hands do: seeded by the wire's name, so that
a robot is the same robot each time, and for spares by the run's seed too.
"""

from __future__ import annotations

from typing import Any

import mujoco as mj
import numpy as np

from hardware_sim.grasp import Grasp
from hardware_sim.surprises import pad, put_ball, seeded, surprise
from hardware_sim.wire_drive import (
    Array,
    WireDrive,
    elastic_stretch_m,
    stretch_wires,
)
from runtime.coordinates import Coordinates
from runtime.messages import MusclePath, Place
from runtime.muscle_path import path_of_tendon
from runtime.settings import RobotSettings
from runtime.suggestion import suggestion

DT_S = 0.001
START_TENSION_N = 8.0
SLACK_M = 0.015  # of a wire that was just attached by hand
WARM_STEPS = 20  # windings take minutes to warm: looked at every 20 ms
STATE = mj.mjtState.mjSTATE_INTEGRATION  # with time and the solver's warm start


class Plant:
    """The simulated body. All arrays are matched by `joints` (N,) and `wires` (M,).

    Attributes:
        paths: nominal paths of the body file's own wires.
        grasp: what the hands hold.
    """

    def __init__(self, settings: RobotSettings, seed: int = 0) -> None:
        self.settings = settings
        self.seed = seed
        self.simulation = settings.simulation
        self.joints = settings.joints
        self.wires: list[str] = []
        self._spec = mj.MjSpec.from_file(str(settings.body_file))
        self._prepare()
        self.model = self._spec.compile()
        self.data = mj.MjData(self.model)
        self.drive = WireDrive(
            len(self.wires),
            settings.module.winding_speed_m_s,
            self.simulation,
        )
        self.ruptured: set[str] = set()
        self.grasp = Grasp(settings.payload)
        self._steps = 0
        self._bind()
        self._rest()

    # ── what really is ────────────────────────────────────────────────────────────────────────

    @property
    def angle_rad(self) -> Array:
        """True joint angles, shape (N,)."""
        return self._coordinates.read(self.data.qpos)

    @property
    def velocity_rad_s(self) -> Array:
        """True joint velocities, shape (N,)."""
        return self._coordinates.rates(self.data.qvel, self.data.qpos)

    @property
    def range_rad(self) -> Array:
        """Limits of the joints, shape (N, 2)."""
        return self._coordinates.range_rad

    @property
    def inertia_kg_m2(self) -> Array:
        """What each joint alone has to turn in the body's zero posture, shape (N,)."""
        return np.asarray(self.model.dof_M0[self._coordinates.dof])

    @property
    def wire_length_m(self) -> Array:
        """Wire paid out from each spool (the spring's rest length), shape (M,): no copy."""
        return self._rest_length

    @property
    def path_length_m(self) -> Array:
        """Geometric length of each wire's path at the last `sense`, shape (M,): no copy."""
        return self._path_length

    def wires_at(self, angle_rad: Array) -> tuple[Array, Array]:
        """Lengths of the true paths (M,) [m] and dl/dtheta (M, N), were the joints at a posture."""
        model, data = self.model, self._elsewhere
        self._coordinates.place(data.qpos, angle_rad)
        mj.mj_kinematics(model, data)
        mj.mj_comPos(model, data)
        mj.mj_tendon(model, data)
        dense = np.zeros((len(self.wires), model.nv))
        mj.mju_sparse2dense(
            dense, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
        )
        return data.ten_length.copy(), self._coordinates.pulled(dense, data.qpos)

    @property
    def elastic_n_m(self) -> list[tuple[float, float, float]]:
        """Each wire's true elastic curve, see `elastic_tension_n`."""
        a, b, c = self.simulation.elastic_n_m
        return [(k * a, k * b, k * c) for k in self._stiffer.tolist()]

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(self.data.time)

    def torque_nm(self, torque_nm: Array) -> None:
        """Disturb the joints by outside torques, shape (N,), until told otherwise."""
        self._coordinates.push(torque_nm, self.data.qpos, self.data.qfrc_applied)

    def payload_m(self, name: str) -> Array:
        """Where a payload truly is, shape (3,), in the world's frame."""
        return np.array(self.data.body(name).xpos)

    # ── stepping ──────────────────────────────────────────────────────────────────────────────

    def sense(self) -> Array:
        """First half of a step: positions are current.

        Returns:
            True tensions [N], shape (M,); the next call writes them anew.
        """
        mj.mj_step1(self.model, self.data)
        # the constraints are built already: a friction takes effect at the next step
        stretch_wires(*self._stretched)
        return self._tension_n

    def act(self, command_m_s: Array, tension_n: Array) -> None:
        """Second half of a step: motors follow winding speeds [m/s], the body moves on by 1 ms."""
        self.drive.step(DT_S, command_m_s, tension_n, self._rest_length)
        self._steps += 1
        if self._steps % WARM_STEPS == 0:
            self.drive.warm(WARM_STEPS * DT_S, tension_n)
        mj.mj_step2(self.model, self.data)

    # ── a body that changes ───────────────────────────────────────────────────────────────────

    def add_muscle(self, name: str, path: MusclePath) -> None:
        """Attach a wire along its nominal path, displaced by the assembly error; state is kept.

        Raises:
            ValueError: the name is taken, or the path names a link or geom the body lacks.
        """
        if name in self.wires:
            raise ValueError(f"muscle '{name}' is on the body already")
        rng = seeded(name if name in self.paths else f"{self.seed}/{name}")
        places = (path.attachment, *path.relays)
        self._check_path(places)
        soft_m = self.simulation.soft_part_m
        guided = any(place.wrap for place in places)
        tendon = self._spec.add_tendon(name=name)
        for k, place in enumerate(places):
            if place.wrap:
                geom = pad(self._spec, name, place.wrap, soft_m) if soft_m else place.wrap
                tendon.wrap_geom(geom, place.side)
                continue
            site = f"{name}/{k}"
            if soft_m and not guided and place is places[-1]:
                ball = put_ball(self._spec, self.model, name, places[k - 1], place, soft_m)
                tendon.wrap_geom(ball, "")
            position = np.asarray(place.position_m) + self._assembly_error(rng)
            self._spec.body(place.link).add_site(name=site, pos=position)
            tendon.wrap_site(site)
        self._as_wire(tendon)
        friction_n = self._friction_n.copy()
        try:
            self.model, self.data = self._spec.recompile(self.model, self.data)
        except ValueError as error:
            self._take_off(name)
            words = str(error).splitlines()[0].removeprefix("Error: ")
            raise ValueError(f"the wire of '{name}' cannot be led like that: {words}") from error
        self.wires.append(name)
        self.drive.add()
        self._bind()
        self._friction_n[:-1] = friction_n  # the other wires stick as they did
        mj.mj_fwdPosition(self.model, self.data)
        self._rest_length[-1] = self._path_length[-1] + SLACK_M

    def remove_muscle(self, name: str) -> None:
        """Take a wire off the body; everything else stays as it is."""
        index = self.wires.index(name)
        kept = np.delete(self._rest_length, index)
        friction_n = np.delete(self._friction_n, index)
        self._take_off(name)
        self.model, self.data = self._spec.recompile(self.model, self.data)
        self.wires.pop(index)
        self.drive.remove(index)
        self.ruptured.discard(name)
        self._bind()
        self._rest_length[:] = kept
        self._friction_n[:] = friction_n

    def rupture(self, name: str) -> None:
        """Break a wire: no tension from now on, its length runs free."""
        self.ruptured.add(name)
        self._bind()

    # ── state that survives the process ───────────────────────────────────────────────────────

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs, of plain types."""
        state = np.empty(mj.mj_stateSize(self.model, STATE))
        mj.mj_getState(self.model, self.data, state, STATE)
        return {
            "wires": list(self.wires),
            "steps": self._steps,
            "state": state.tolist(),
            "friction_n": self._friction_n.tolist(),
            "speed_m_s": self.drive.speed_m_s.tolist(),
            "temperature_degc": self.drive.temperature_degc.tolist(),
            "peak_speed_m_s": self.drive.peak_speed_m_s.tolist(),
            "peak_tension_n": self.drive.peak_tension_n.tolist(),
            "ruptured": sorted(self.ruptured),
            "held": dict(self.grasp.held),
        }

    def restore(self, snapshot: dict[str, Any], paths: dict[str, MusclePath]) -> None:
        """Take the state of a snapshot; `paths` are those of the muscles added since the start."""
        for name in list(self.wires):
            if name not in snapshot["wires"]:
                self.remove_muscle(name)
        for name in snapshot["wires"]:
            if name not in self.wires:
                self.add_muscle(name, paths[name])
        order = [self.wires.index(name) for name in snapshot["wires"]]
        if order != sorted(order):
            raise ValueError("the snapshot's wires are in another order than the body's")
        self.ruptured = set(snapshot["ruptured"])
        self._steps = snapshot["steps"]
        self.grasp.held = dict(snapshot.get("held", {}))
        self._bind()
        mj.mj_setState(self.model, self.data, np.array(snapshot["state"]), STATE)
        self._friction_n[:] = snapshot["friction_n"]
        self.drive.speed_m_s[:] = snapshot["speed_m_s"]
        self.drive.temperature_degc[:] = snapshot["temperature_degc"]
        self.drive.peak_speed_m_s[:] = snapshot["peak_speed_m_s"]
        self.drive.peak_tension_n[:] = snapshot["peak_tension_n"]
        mj.mj_fwdPosition(self.model, self.data)

    # ── inside ────────────────────────────────────────────────────────────────────────────────

    def _prepare(self) -> None:
        for actuator in list(self._spec.actuators):
            self._spec.delete(actuator)
        # before anything is displaced: wires may share a site
        self.paths = {tendon.name: path_of_tendon(tendon) for tendon in self._spec.tendons}
        for tendon in self._spec.tendons:
            rng = seeded(tendon.name)
            for wrap in tendon.path:
                if wrap.type == mj.mjtWrap.mjWRAP_SITE:
                    wrap.target.pos = wrap.target.pos + self._assembly_error(rng)
            self._as_wire(tendon)
            self.wires.append(tendon.name)
        surprise(self._spec, self.joints, self.simulation, self.seed)
        self._spec.option.timestep = DT_S
        self._spec.option.integrator = mj.mjtIntegrator.mjINT_EULER

    def _take_off(self, name: str) -> None:
        self._spec.delete(self._spec.tendon(name))
        for site in list(self._spec.sites):
            if site.name.startswith(f"{name}/"):
                self._spec.delete(site)
        for geom in list(self._spec.geoms):
            if geom.name.startswith(f"{name}/"):
                self._spec.delete(geom)

    def _as_wire(self, tendon: Any) -> None:
        tendon.stiffness = list(self.simulation.elastic_n_m)
        tendon.springlength = [0.0, 1.0]
        tendon.springyield = 1e6  # puts the rest length into state: it is the wire's length
        tendon.frictionloss = 1e-6  # not zero: the constraint has to be compiled in
        # stiff friction: a wire that sticks must not creep
        tendon.solref_friction = [0.002, 1.0]
        tendon.solimp_friction = [0.9999, 0.9999, 0.001, 0.5, 2.0]

    def _bind(self) -> None:
        self._coordinates = Coordinates(self.model, self.joints)
        if not (self.model.geom_contype.any() or self.model.npair):  # nothing here can touch
            self.model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_CONTACT
        if self.model.ntree == 1:  # MuJoCo need not look for parts that move on their own
            self.model.opt.disableflags |= mj.mjtDisableBit.mjDSBL_ISLAND
        self._elsewhere = mj.MjData(self.model)  # postures that are only asked about
        # Views, as finding them takes longer than using them. Rest length is the second of each
        # tendon's two plastic states.
        self._rest_length: Array = self.data.plastic.reshape(-1)[1::2]
        self._path_length: Array = self.data.ten_length
        self._friction_n = self.model.tendon_frictionloss
        self._tension_n = np.zeros(len(self.wires))
        added = self.simulation.spare_stiffness
        self._stiffer = np.array([1.0 if name in self.paths else added for name in self.wires])
        self.grasp.bind(self.model, self.data)
        whole = np.array([name not in self.ruptured for name in self.wires])
        scales = self._stiffer * whole
        self._stretched = (  # what `stretch_wires` is given in each step
            self._path_length,
            self._rest_length,
            scales,
            *self.simulation.elastic_n_m,
            float(np.sinh(self.simulation.wire_friction)),
            self._tension_n,
            self._friction_n,
        )
        stiffness = np.array(self.simulation.elastic_n_m)
        for index, scale in enumerate(scales.tolist()):
            self.model.tendon_stiffness[index] = scale * stiffness[0]
            self.model.tendon_stiffnesspoly[index] = scale * stiffness[1:]

    def _rest(self) -> None:
        rest_rad = np.radians([joint.rest_deg for joint in self.settings.joint])
        self._coordinates.place(self.data.qpos, rest_rad)
        mj.mj_forward(self.model, self.data)
        stretch = elastic_stretch_m(START_TENSION_N, self.simulation.elastic_n_m)
        self._rest_length[:] = self._path_length - stretch

    def _check_path(self, places: tuple[Place, ...]) -> None:
        bodies = {body.name for body in self._spec.bodies}
        geoms = {geom.name for geom in self._spec.geoms}
        for place in places:
            if place.wrap and place.wrap not in geoms:
                hint = suggestion(place.wrap, geoms - {""})
                raise ValueError(f"no geom '{place.wrap}' to wrap around on this body{hint}")
            if not place.wrap and (place.link not in bodies or place.position_m is None):
                hint = suggestion(place.link, bodies - {"world", ""})
                raise ValueError(f"no link '{place.link}' with a position on this body{hint}")

    def _assembly_error(self, rng: np.random.Generator) -> Array:
        return rng.normal(0.0, self.simulation.assembly_error_m / np.sqrt(3.0), 3)
