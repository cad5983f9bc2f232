"""The simulated robot: body, muscle modules and daisy chains, one millisecond at a time.

What goes in and out is what a robot has: bytes on the chains, and hands that plug a module in or
pull it off. Everything else (`truth`) is for scoring.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from functools import partial
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from hardware_sim.chain import Chain
from hardware_sim.faults import UNITS, ActiveFault, Faults
from hardware_sim.firmware import JointModule, MuscleModule
from hardware_sim.muscle_bank import MuscleBank
from hardware_sim.plant import DT_S, Plant
from hardware_sim.sensors import Sensors
from runtime import messages as m
from runtime.settings import RobotSettings
from runtime.suggestion import suggestion

Array = NDArray[np.float64]

STEP_NS = 1_000_000
MUSCLE_FAULTS = ("rupture", "overheat")  # what only a muscle can have


class PlugError(ValueError):
    """What was asked of the hands cannot be done; the text says why and what to do."""


class _Shelved(msgspec.Struct):
    """A module that was unplugged: it remembers its registers, and it may come back."""

    chain: str
    path: m.MusclePath
    module: dict[str, Any]


class SimulatedRobot:
    """Body, modules and chains under one clock. M muscles are in the order of `plant.wires`."""

    def __init__(self, settings: RobotSettings, seed: int = 0) -> None:
        self.settings = settings
        self.now_ns = 0
        self.plant = Plant(settings, seed)
        self.bank = MuscleBank()
        self.faults = Faults(seed)
        self.chains = {row.name: Chain(row.name, row.baud, self.faults) for row in settings.chain}
        self.sensors = Sensors(settings.simulation, np.random.default_rng([seed, 1]))
        self._modules: dict[str, MuscleModule] = {}
        self._chain_of: dict[str, str] = {}
        self._paths: dict[str, m.MusclePath] = {}  # nominal, of the muscles that are plugged in
        self._shelf: dict[str, _Shelved] = {}
        self._tension_n = np.zeros(0)
        self._assemble()

    # ── time ──────────────────────────────────────────────────────────────────────────────────

    def step(self) -> None:
        """One millisecond: sense, run the modules' loops, move."""
        plant, drive = self.plant, self.plant.drive
        tension = plant.sense()
        load, length = self.sensors.read(plant.wires, tension, plant.wire_length_m, drive.speed_m_s)
        degc = self._motor_temperature_degc() if self.faults.active else drive.temperature_degc
        speed = self.bank.step(DT_S, load, length, degc, self.now_ns)
        plant.act(speed, tension)
        self._tension_n = tension
        self.now_ns += STEP_NS

    def exchange(self, request: m.BusRequest) -> tuple[m.BusReply, int]:
        """What a chain answers to bytes, and the robot time at which the line is free again."""
        chain = self.chains[request.chain]
        self.bank.sent_ns = request.stamp_ns
        data = chain.receive(request.data, self.now_ns)
        reply = m.BusReply(
            stamp_ns=self.now_ns, chain=request.chain, sequence=request.sequence, data=data
        )
        return reply, self.now_ns + chain.reply_time_ns(request.data, data)

    # ── hands ─────────────────────────────────────────────────────────────────────────────────

    def plug(self, request: m.Plug) -> m.Event:
        """Fix a module to the body, lead its wire, and extend the chain at its tail.

        Raises:
            PlugError: unknown spare, muscle plugged already, unknown chain, impossible path.
        """
        name = request.muscle
        if name in self._modules:
            raise PlugError(f"muscle '{name}' is plugged in already")
        shelved = self._shelf.get(name)
        spare = next((s for s in self.settings.spare if s.name == name), None)
        path = request.path or (shelved.path if shelved else spare.path if spare else None)
        if path is None:
            hint = suggestion(name, {s.name for s in self.settings.spare} | self._shelf.keys())
            raise PlugError(f"no spare '{name}' in the robot file, and no path by --path{hint}")
        chain = (
            request.chain
            or (shelved.chain if shelved else spare.chain if spare else "")
            or next(iter(self.chains))
        )
        if chain not in self.chains:
            raise PlugError(f"no chain '{chain}'{suggestion(chain, self.chains)}")
        try:
            self.plant.add_muscle(name, path)
        except ValueError as error:
            raise PlugError(str(error)) from error
        self._shelf.pop(name, None)
        self._paths[name] = path
        serial = serial_number(self.settings.name, name)
        module = self._add_module(name, chain, serial, request.module_id)
        if shelved:  # switched on anew: it knows its id, and its encoder begins at zero again
            module.restore(shelved.module)
            module.reboot()
        self.sensors.begin_at(self.plant.wire_length_m[-1])
        return m.Event(
            stamp_ns=self.now_ns,
            process="world",
            level="info",
            kind="plugged",
            text=f"muscle '{name}' was plugged into chain '{chain}'",
            data={
                "muscle": name,
                "chain": chain,
                "serial": str(serial),
                "path": msgspec.json.encode(path).decode(),
            },
        )

    def unplug(self, request: m.Unplug) -> m.Event:
        """Pull a module off its chain and its wire off the body.

        Raises:
            PlugError: no such muscle is plugged in.
        """
        name = request.muscle
        if name not in self._modules:
            hint = suggestion(name, self._modules)
            raise PlugError(f"no muscle '{name}' is plugged in{hint}")
        module = self._modules.pop(name)
        chain = self._chain_of.pop(name)
        self.chains[chain].unplug(module.serial)
        self._shelf[name] = _Shelved(chain=chain, path=self._paths.pop(name), module=module.save())
        index = self.plant.wires.index(name)
        self.bank.remove(index)
        self.plant.remove_muscle(name)
        self.faults.clear("rupture", name)  # should it come back, it has a wire again
        self.sensors.remove(index)
        self._tension_n = np.delete(self._tension_n, index)
        return m.Event(
            stamp_ns=self.now_ns,
            process="world",
            level="info",
            kind="unplugged",
            text=f"muscle '{name}' was pulled off chain '{chain}'",
            data={"muscle": name, "chain": chain},
        )

    def fault(self, request: m.Fault) -> m.Event:
        """Break something, or mend it; amount 0 mends, too, where that makes sense.

        Raises:
            PlugError: no such kind of fault or nothing of that name that can have it; or nothing is
                broken that could be mended.
        """
        if request.action == "mend":
            return self._mend(request)
        if request.action != "break":
            raise PlugError(f"a fault can be to break or to mend something, not '{request.action}'")
        name = request.target
        targets = [*self._modules]
        if request.kind not in MUSCLE_FAULTS:
            targets += self.plant.joints
        if request.kind not in (*MUSCLE_FAULTS, "stuck"):
            targets += self.chains
        if name not in targets:
            what = f"nothing called '{name}' can have that" if name else "say what shall have it"
            raise PlugError(f"{what}{suggestion(name, targets)}")
        try:
            self.faults.set(request.kind, name, request.amount)
        except ValueError as error:
            raise PlugError(str(error)) from error
        if request.kind == "rupture":
            self.plant.rupture(name)
        elif request.kind == "stuck":
            self._hold_readings()
        broken = ActiveFault(request.kind, name, request.amount)
        text = ", ".join(filter(None, (f"{request.kind} on '{name}'", self.degree(broken))))
        return self._told_fault("warning", text, name)

    def degree(self, fault: ActiveFault) -> str:
        """How badly it is broken, in words; "" where the kind says it all."""
        pulled = fault.kind == "cable" and fault.target in self.chains
        unit = "modules left" if pulled else UNITS.get(fault.kind, "")
        return f"{fault.amount:g} {unit}" if unit else ""

    def _mend(self, request: m.Fault) -> m.Event:
        """Mend all that is asked for but torn wires, which a hand has to lead anew."""
        asked = self.faults.matching(request.kind, request.target)
        torn = [fault.target for fault in asked if fault.kind == "rupture"]
        mended = [fault for fault in asked if fault.kind != "rupture"]
        if torn and not mended:
            raise PlugError(f"the wire of '{torn[0]}' is torn: unplug the muscle and plug it in")
        if not mended:
            broken = _list(f"{fault.kind} on {fault.target}" for fault in self.faults.active)
            raise PlugError(f"that is not broken; there is: {broken or 'nothing'}")
        for fault in mended:
            self.faults.clear(fault.kind, fault.target)
        self._hold_readings()
        text = _list(f"{fault.kind} on '{fault.target}'" for fault in mended)
        for name in dict.fromkeys(fault.target for fault in mended):
            if name in self._modules and self._modules[name].alert:
                text += f"; '{name}' reports its error until it is unplugged and plugged in"
        return self._told_fault("info", f"mended: {text}", request.target)

    def _hold_readings(self) -> None:
        """Keep what each stuck sensor read when it got stuck."""
        held = self.sensors.stuck
        stuck = [fault.target for fault in self.faults.matching("stuck")]
        self.sensors.stuck = {x: held[x] if x in held else self._reading(x) for x in stuck}

    def _told_fault(self, level: str, text: str, target: str) -> m.Event:
        return m.Event(
            stamp_ns=self.now_ns,
            process="world",
            level=level,
            kind="fault",
            text=text,
            data={"target": target},
        )

    def hand(self, command: m.HandCommand) -> m.HandState:
        """The robot's own hand opens, or closes on a payload; says what it holds then.

        Raises:
            PlugError: there is no such payload, or nothing to hold it with.
        """
        grasp, model, data = self.plant.grasp, self.plant.model, self.plant.data
        for name, payload in grasp.payloads.items():
            if payload.link == command.hand and name != command.holds:
                grasp.open(model, data, name)
        try:
            held = bool(command.holds) and grasp.close(model, data, command.holds)
        except ValueError as error:
            raise PlugError(str(error)) from error
        return m.HandState(
            stamp_ns=self.now_ns,
            hand=command.hand,
            asked=command.holds,
            holds=command.holds if held else "",
        )

    # ── what really is ────────────────────────────────────────────────────────────────────────

    def truth(self) -> m.WorldTruth:
        """True state and greatest values so far, for scoring only."""
        return m.WorldTruth(
            stamp_ns=self.now_ns,
            joints=self.plant.joints,
            angle_rad=tuple(self.plant.angle_rad.tolist()),
            muscles=tuple(self.plant.wires),
            tension_n=tuple(self._tension_n.tolist()),
            length_m=tuple(self.plant.wire_length_m.tolist()),
            peak_tension_n=tuple(self.plant.drive.peak_tension_n.tolist()),
            peak_speed_m_s=tuple(self.plant.drive.peak_speed_m_s.tolist()),
            peak_target_speed_m_s=tuple(self.bank.peak_target_speed_m_s.tolist()),
        )

    def snapshot(self) -> dict[str, Any]:
        """Everything that `restore` needs, of plain types."""
        return {
            "now_ns": self.now_ns,
            "plant": self.plant.snapshot(),
            "paths": msgspec.to_builtins(self._paths),
            "shelf": msgspec.to_builtins(self._shelf),
            "chain_of": dict(self._chain_of),
            "order": {
                name: [module.serial for module in chain.modules]
                for name, chain in self.chains.items()
            },
            "modules": {name: module.save() for name, module in self._modules.items()},
            "cell_offset_n": self.sensors.cell_offset_n.tolist(),
            "encoder_offset_m": self.sensors.encoder_offset_m.tolist(),
            "tension_n": self._tension_n.tolist(),
            "faults": [tuple(fault) for fault in self.faults.active],
            "stuck": dict(self.sensors.stuck),
        }

    def restore(self, snapshot: dict[str, Any], now_ns: int) -> None:
        """Be as the snapshot was, at a robot time that is not before it."""
        paths = msgspec.convert(snapshot["paths"], dict[str, m.MusclePath])
        there, wanted = list(self._modules), list(snapshot["modules"])
        same = 0  # wires that are in place already; the others are put on in the saved order
        while same < min(len(there), len(wanted)) and there[same] == wanted[same]:
            same += 1
        for name in reversed(there[same:]):
            self.unplug(m.Unplug(muscle=name))
        self._shelf.clear()
        for name in wanted[same:]:
            chain = snapshot["chain_of"][name]
            self.plug(m.Plug(muscle=name, chain=chain, path=paths[name]))
        self.plant.restore(snapshot["plant"], paths)
        for name, state in snapshot["modules"].items():
            self._modules[name].restore(state)
        for name, order in snapshot["order"].items():
            self.chains[name].modules.sort(key=lambda module: order.index(module.serial))
        self._shelf = msgspec.convert(snapshot["shelf"], dict[str, _Shelved])
        self._paths = paths
        self.sensors.restore(snapshot["cell_offset_n"], snapshot["encoder_offset_m"])
        self._tension_n = np.array(snapshot["tension_n"])
        self.faults.clear()
        for kind, target, amount in snapshot["faults"]:
            self.faults.set(kind, target, amount)
        self.sensors.stuck = dict(snapshot["stuck"])
        # the modules heard their master when the snapshot was taken
        self.bank.heard_ns += now_ns - snapshot["now_ns"]
        self.now_ns = now_ns

    # ── inside ────────────────────────────────────────────────────────────────────────────────

    def _assemble(self) -> None:
        settings = self.settings
        by_name = {muscle.name: muscle for muscle in settings.muscle}
        missing = [name for name in self.plant.wires if name not in by_name]
        if missing:
            raise PlugError(
                f"tendon '{missing[0]}' of {settings.body_file.name} has no [[muscle]] in "
                f"{settings.file}; add one"
            )
        rest_m = self.plant.wire_length_m.copy()
        for index, name in enumerate(self.plant.wires):
            muscle = by_name[name]
            serial = serial_number(settings.name, name)
            self._add_module(name, muscle.chain, serial, muscle.id)
            self._paths[name] = self.plant.paths[name]
            # calibrated when it was built: zero length at the rest posture, load cell tared
            self.bank.length_zero_m[index] = rest_m[index]
            self.bank.tension_tare_n[index] = self.sensors.cell_offset_n[index]
        for number, joint in enumerate(settings.joint):
            self.chains[joint.chain].plug(
                JointModule(
                    serial_number(settings.name, joint.name),
                    partial(self._angle_reading, number),
                    joint.id,
                    joint.name,
                )
            )

    def _motor_temperature_degc(self) -> Array:
        extra = [self.faults.amount("overheat", name) or 0.0 for name in self.plant.wires]
        return np.asarray(self.plant.drive.temperature_degc + extra)

    def _reading(self, name: str) -> float:
        """What a muscle's load cell [N] or a joint's angle sensor [rad] reads, raw."""
        if name not in self._modules:
            return self._angle_reading(self.plant.joints.index(name))
        index = self.plant.wires.index(name)
        return float(self.bank.tension_n[index] + self.bank.tension_tare_n[index])

    def _angle_reading(self, number: int) -> float:
        return self.sensors.read_angle(self.plant.joints[number], self.plant.angle_rad.item(number))

    def _add_module(self, name: str, chain: str, serial: int, module_id: int) -> MuscleModule:
        limits = self.settings.module
        index = self.bank.add(
            tension_limit_n=limits.tension_limit_n,
            winding_speed_limit_m_s=limits.winding_speed_m_s,
            temperature_limit_degc=limits.temperature_limit_degc,
            spool_radius_m=limits.spool_radius_m,
            temperature_degc=self.settings.simulation.ambient_degc,
        )
        module = MuscleModule(self.bank, index, serial, module_id, name)
        self.chains[chain].plug(module)
        self._modules[name] = module
        self._chain_of[name] = chain
        self.sensors.add(serial)
        self._tension_n = np.append(self._tension_n, 0.0)
        return module


def _list(names: Iterable[str]) -> str:
    return ", ".join(names)


def serial_number(robot: str, name: str) -> int:
    """The serial number burnt into a module: the same in every run."""
    return (zlib.crc32(robot.encode()) << 16 | zlib.crc32(name.encode()) & 0xFFFF) or 1
