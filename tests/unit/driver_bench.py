"""A bench for one driver: real firmware and chain, and wires that are springs on a wall."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from hardware_sim.chain import Chain
from hardware_sim.firmware import JointModule, MuscleModule
from hardware_sim.muscle_bank import MuscleBank
from runtime import messages as m
from runtime.logic import MemoryStore
from runtime.messages import Message, Reply
from runtime.settings import Chain as ChainSettings
from runtime.settings import Joint, Muscle, Robot, RobotSettings
from services.logic.muscle_driver import MuscleDriver

WIRE_N_M = 20_000.0  # stiffness of the wires
PRELOAD_N = 30.0  # of the wires that are there from the start
MS = 1_000_000

SETTINGS = RobotSettings(
    robot=Robot(name="bench", body="none.xml"),
    chain=(ChainSettings(name="arm", max_modules=5),),
    joint=(Joint(name="elbow", chain="arm", id=100),),
    muscle=tuple(Muscle(name=f"m{i}", chain="arm", id=i) for i in (2, 3)),
)

Tamper = Callable[[m.BusReply], m.BusReply | None]


class Bench:
    """Muscles m2 and m3 on ids 2 and 3, a joint module on id 100, and their driver."""

    def __init__(self, settings: RobotSettings = SETTINGS) -> None:
        self.settings = settings
        self.now_ns = 1_000 * MS
        self.bank = MuscleBank()
        self.chain = Chain("arm")
        self.store = MemoryStore()
        self.wire_m: list[float] = []  # paid out
        self.path_m: list[float] = []  # from module to wall
        self.cell_n: list[float] = []  # what the load cell reads with a slack wire
        self.heat_degc: list[float] = []
        self.angle_rad = 0.5
        self.events: list[m.Event] = []
        self.states: list[m.ChainState] = []
        self.joints: list[m.JointState] = []
        self.bodies: list[m.ChainBody] = []
        self.requests: list[m.BusRequest] = []
        self.tamper: Tamper | None = None
        for muscle in settings.muscle:
            self.plug(muscle.name, 1000 + muscle.id, muscle.id, slack_m=-PRELOAD_N / WIRE_N_M)
        self.chain.plug(JointModule(9, lambda: self.angle_rad, 100, "elbow"))
        self.driver = self.new_driver()

    def new_driver(self) -> MuscleDriver:
        """A driver that has just started, with what its predecessor kept."""
        self.driver = MuscleDriver(self.settings, "arm", self.store)
        return self.driver

    # ── hands ─────────────────────────────────────────────────────────────────────────────────

    def plug(
        self, name: str, serial: int, module_id: int = 1, slack_m: float = 0.02, cell_n: float = 0.0
    ) -> MuscleModule:
        """Add a muscle module at the tail."""
        self.wire_m.append(0.3 + slack_m)
        self.path_m.append(0.3)
        self.cell_n.append(cell_n)
        self.heat_degc.append(25.0)
        module = MuscleModule(self.bank, self.bank.add(), serial, module_id, name)
        self.chain.plug(module)
        return module

    def replug(self, module: MuscleModule, slack_m: float = 0.02) -> None:
        """Bring a module back that was unplugged: it was without power, its wire is new."""
        module.reboot()
        self.wire_m[module.index] = self.path_m[module.index] + slack_m
        self.chain.plug(module)

    def announce(self, name: str, serial: int) -> None:
        """Say which muscle was plugged in."""
        data = {"muscle": name, "chain": "arm", "serial": str(serial)}
        event = m.Event(process="world", level="info", kind="plugged", text="", data=data)
        self.driver.receive(event, self.now_ns)

    def module(self, name: str) -> MuscleModule:
        """One muscle module by name."""
        (found,) = (x for x in self.chain.modules if x.name == name)
        assert isinstance(found, MuscleModule)
        return found

    # ── time ──────────────────────────────────────────────────────────────────────────────────

    def run(self, seconds: float, driver: bool = True) -> None:
        """Let robot time pass, with the driver or without."""
        for _ in range(round(seconds * 1000)):
            self._move()
            if driver and self.now_ns % self.driver.period_ns == 0:
                self.tick()

    def run_until(self, condition: Callable[[], bool], limit_s: float = 8.0) -> None:
        """Let robot time pass until something holds."""
        for _ in range(round(limit_s * 1000)):
            if condition():
                return
            self.run(0.001)
        raise AssertionError(f"did not come to hold within {limit_s} s; events: {self.kinds()}")

    def tick(self) -> None:
        """Tick the driver until it has nothing more to say."""
        for _ in range(20):
            heard = False
            for message in self.driver.tick(self.now_ns):
                heard |= self._publish(message)
            if not heard:
                return

    def command(self, **goals: tuple[float, float, float]) -> None:
        """A valid command: muscle=(bias, stiffness, target)."""
        self.send(self.make_command(**goals))

    def make_command(self, **goals: tuple[float, float, float]) -> m.ChainCommand:
        columns = list(zip(*goals.values(), strict=True)) or [(), (), ()]
        return m.ChainCommand(
            stamp_ns=self.now_ns,
            chain="arm",
            author="executive",
            lease_ns=200 * MS,
            muscles=tuple(goals),
            bias_n=columns[0],
            stiffness_n_m=columns[1],
            target_length_m=columns[2],
        )

    def send(self, command: m.ChainCommand) -> None:
        """Give the driver a command."""
        self.driver.receive(command, self.now_ns)

    def ask(self, request: Message) -> Reply:
        """Put a request and let the driver tick, as it does right after."""
        reply = self.driver.answer(request, self.now_ns)
        self.tick()
        return reply

    # ── what happened ─────────────────────────────────────────────────────────────────────────

    def kinds(self) -> list[str]:
        """Kinds of all events so far."""
        return [event.kind for event in self.events]

    def event(self, kind: str) -> m.Event:
        """The only event of that kind."""
        (found,) = (event for event in self.events if event.kind == kind)
        return found

    def info(self, name: str) -> m.ModuleInfo:
        """What the newest chain body says of a module."""
        (found,) = (info for info in self.bodies[-1].modules if info.name == name)
        return found

    def felt(self, name: str) -> tuple[float, float, float]:
        """Length, tension and target of one muscle in the newest state."""
        state = self.states[-1]
        i = state.muscles.index(name)
        return state.length_m[i], state.tension_n[i], state.target_length_m[i]

    # ── inside ────────────────────────────────────────────────────────────────────────────────

    def _move(self) -> None:
        wire, path = np.array(self.wire_m), np.array(self.path_m)
        tension = WIRE_N_M * np.maximum(path - wire, 0.0) + np.array(self.cell_n)
        speed = self.bank.step(0.001, tension, wire, np.array(self.heat_degc), self.now_ns)
        self.wire_m = (wire + speed * 0.001).tolist()
        self.now_ns += MS

    def _publish(self, message: Message) -> bool:
        if isinstance(message, m.BusRequest):
            self.requests.append(message)
            data = self.chain.receive(message.data, self.now_ns)
            reply = m.BusReply(
                stamp_ns=self.now_ns, chain="arm", sequence=message.sequence, data=data
            )
            given = self.tamper(reply) if self.tamper else reply
            if given is not None:
                self.driver.receive(given, self.now_ns)
            return given is not None
        # what is published must survive the wire
        assert msgspec.convert(msgspec.to_builtins(message), type(message)) == message
        if isinstance(message, m.Event):
            self.events.append(message)
        elif isinstance(message, m.ChainState):
            self.states.append(message)
        elif isinstance(message, m.JointState):
            self.joints.append(message)
        elif isinstance(message, m.ChainBody):
            self.bodies.append(message)
        return False
