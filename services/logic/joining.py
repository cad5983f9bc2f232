"""Taking one muscle module into service, in either of two ways.

`take_over`: its wire is under tension already, by brake or by control; it goes on holding what it
holds. `join`: its wire has just been attached and is slack; the load cell is tared, the slack is
wound in with a small tension, and the length at which that comes to rest becomes zero.
Registers that are kept can be written only while torque is off; the motor's brake holds the wire.
"""

from __future__ import annotations

from collections import deque

from runtime.settings import Chain
from runtime.wire.registers import GOAL_BLOCK, PRESENT_BLOCK, block
from services.logic.conversation import (
    Conversation,
    RefusedError,
    read,
    read_block,
    read_bytes,
    write,
    write_bytes,
)
from services.logic.reference import JOIN_BIAS_N
from services.logic.roster import Module

STOP_AND_GOALS = block("stop", "bias_tension", "stiffness", "target_length")
LIMITS = block("tension_limit", "winding_speed_limit")
ZEROS = block("length_zero", "tension_tare")

TARE_SAMPLES = 10
SLACK_N = 5.0  # a wire with less than that is slack
STEADY_NS = 200_000_000
STEADY_M = 3e-4  # length changes by less than that while steady
WIND_IN_NS = 30_000_000_000  # so small a tension winds in about a centimetre a second


def write_limits(module: Module) -> Conversation[bool]:
    """Set its limits where they differ; True: it had to switch torque off for that."""
    limits = module.reference.limits
    wanted = {
        "tension_limit": limits.tension_limit_n,
        "winding_speed_limit": limits.winding_speed_m_s,
    }
    present = yield from read_block(module.id, LIMITS)
    hottest = yield from read(module.id, "temperature_limit")
    same = LIMITS.encode(present) == LIMITS.encode(wanted)
    if same and hottest == round(limits.temperature_limit_degc):
        return False
    yield from write(module.id, "torque_enable", 0)
    yield from write_bytes(module.id, LIMITS.address, LIMITS.encode(wanted))
    yield from write(module.id, "temperature_limit", limits.temperature_limit_degc)
    return True


def take_over(module: Module, chain: Chain, stiffness_n_m: float) -> Conversation[bool]:
    """Hold what the module holds, without a jump. True: a stop is latched in it.

    Args:
        module: in its `reference` stands afterwards what it was told.
        chain: its chain.
        stiffness_n_m: for a module that has just been switched on and has none.
    """
    goals = yield from read_block(module.id, STOP_AND_GOALS)
    torque = yield from read(module.id, "torque_enable")
    yield from write(module.id, "bus_watchdog", 0)
    if (yield from write_limits(module)):
        torque = 0
    module.take((yield from read_bytes(module.id, PRESENT_BLOCK)))
    reference = module.reference
    reference.bias_n = min(goals["bias_tension"], reference.ceiling_n)
    reference.stiffness_n_m = goals["stiffness"]
    if not torque and not reference.stiffness_n_m:
        reference.stiffness_n_m = stiffness_n_m
    reference.hold(module.reading, module.tension_n)
    yield from write_bytes(module.id, GOAL_BLOCK.address, reference.encode())
    if not torque:
        yield from write(module.id, "torque_enable", 1)
    yield from write(module.id, "bus_watchdog", chain.watchdog_ms * 1e-3)
    return bool(goals["stop"])


def prepare_slack(module: Module, chain: Chain) -> Conversation[None]:
    """Limits and tare of a module whose wire is slack; then let it begin to wind in.

    Raises:
        RefusedError: its load cell reads more than a tare can be.
    """
    yield from write(module.id, "bus_watchdog", 0)
    yield from write(module.id, "torque_enable", 0)
    yield from write_limits(module)
    zeros = yield from read_block(module.id, ZEROS)
    total = 0.0
    for _ in range(TARE_SAMPLES):
        present = yield from read_block(module.id, PRESENT_BLOCK)
        total += present["present_tension"]
        yield None
    tare = zeros["tension_tare"] + total / TARE_SAMPLES
    if abs(tare) > 20.0:
        raise RefusedError(
            f"its load cell reads {tare:.1f} N with a slack wire: check the load cell"
        )
    yield from write(module.id, "tension_tare", tare)
    module.take((yield from read_bytes(module.id, PRESENT_BLOCK)))
    module.reference.slacken(module.reading)
    yield from write_bytes(module.id, GOAL_BLOCK.address, module.reference.encode())
    yield from write(module.id, "torque_enable", 1)
    yield from write(module.id, "bus_watchdog", chain.watchdog_ms * 1e-3)


class WindIn:
    """Whether the slack is wound in: tension is up and the length has come to rest."""

    def __init__(self, now_ns: int) -> None:
        self._began_ns = now_ns
        self._lengths: deque[tuple[int, float]] = deque()

    def done(self, module: Module, now_ns: int) -> bool:
        """Look once more. Raises RefusedError when it takes too long."""
        if now_ns - self._began_ns > WIND_IN_NS:
            raise RefusedError("its wire stays slack: check that its end is attached")
        if module.tension_n < JOIN_BIAS_N / 2:
            self._lengths.clear()
            return False
        self._lengths.append((now_ns, module.reading))
        if now_ns - self._lengths[0][0] < STEADY_NS:
            return False
        while now_ns - self._lengths[1][0] >= STEADY_NS:
            self._lengths.popleft()
        lengths = [length for _, length in self._lengths]
        return max(lengths) - min(lengths) < STEADY_M


def zero_length(module: Module) -> Conversation[None]:
    """Make the present length zero, with the wire held by the brake meanwhile."""
    yield from write(module.id, "torque_enable", 0)
    zeros = yield from read_block(module.id, ZEROS)
    present = yield from read_block(module.id, PRESENT_BLOCK)
    zero = zeros["length_zero"] + present["present_length"]
    yield from write(module.id, "length_zero", zero)
    module.reading = 0.0
    module.reference.slacken(0.0)
    yield from write_bytes(module.id, GOAL_BLOCK.address, module.reference.encode())
    yield from write(module.id, "torque_enable", 1)
