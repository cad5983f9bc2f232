"""What one muscle module is told, f_ref = bias + stiffness (length - target), and its limits.

Whoever takes over a muscle that is already pulling begins with the reference that gives the
tension that is there: the same thing that a module does by itself when its torque is enabled.
"""

from __future__ import annotations

from dataclasses import dataclass

from runtime.settings import Module as Limits
from runtime.wire.registers import GOAL_BLOCK, GOALS

DERATE_1_S = 0.1  # an overheated muscle gives up a tenth of its tension limit a second, to a third
DERATE_MIN = 0.3
COOLED_DEGC = 5.0  # below the limit: full tension is allowed again
LONGEST_M = 2000.0  # what fits the register
JOIN_BIAS_N = 5.0  # winds slack in and moves no joint

_BIAS_N, _STIFFNESS_N_M, _TARGET_M = (register.scale for register in GOALS)  # of one count


@dataclass(slots=True)
class Reference:
    """The goals of one muscle: `bias_n`, `stiffness_n_m` and `target_m` are what it is told."""

    limits: Limits
    bias_n: float = 0.0
    stiffness_n_m: float = 0.0
    target_m: float = 0.0
    wanted_m: float = 0.0  # where the target is going, no faster than the motor winds
    derating: float = 1.0
    hot: bool = False
    over: bool = False  # measured tension is above the limit

    def encode(self) -> bytes:
        """What the block of goal registers shall hold."""
        target_m = min(max(self.target_m, -LONGEST_M), LONGEST_M)
        return GOAL_BLOCK.pack_raw(
            round(self.bias_n / _BIAS_N),
            round(self.stiffness_n_m / _STIFFNESS_N_M),
            round(target_m / _TARGET_M),
        )

    @property
    def ceiling_n(self) -> float:
        """No more than this is asked of the muscle."""
        return self.limits.tension_limit_n * self.derating

    def hold(self, length_m: float, tension_n: float) -> None:
        """Ask for the tension that is there, at the length that is there."""
        tension = min(max(tension_n, 0.0), self.ceiling_n)
        if self.stiffness_n_m > 0.0:
            self.target_m = length_m - (tension - self.bias_n) / self.stiffness_n_m
        else:
            self.bias_n, self.target_m = tension, length_m
        self.wanted_m = self.target_m

    def slacken(self, length_m: float) -> None:
        """Follow with the small tension that takes up slack and cannot hold."""
        self.bias_n, self.stiffness_n_m = JOIN_BIAS_N, 0.0
        self.target_m = self.wanted_m = length_m

    def want(self, bias_n: float, stiffness_n_m: float, target_m: float, length_m: float) -> None:
        """Take a command. Another stiffness begins with the tension that was asked for so far."""
        ceiling_n = self.ceiling_n
        bias = min(max(bias_n, 0.0), ceiling_n)
        stiffness = min(max(stiffness_n_m, 0.0), 60_000.0)
        if stiffness != self.stiffness_n_m and stiffness > 0.0:
            asked = self.bias_n + self.stiffness_n_m * (length_m - self.target_m)
            asked = min(max(asked, 0.0), ceiling_n)
            self.target_m = length_m - (asked - bias) / stiffness
        self.bias_n, self.stiffness_n_m, self.wanted_m = bias, stiffness, target_m

    def freeze(self) -> None:
        """The target stays where it is."""
        self.wanted_m = self.target_m

    def step(self, dt_s: float, length_m: float, tension_n: float, temperature_degc: float) -> None:
        """Let the target move for `dt_s`, and keep the limits."""
        limits = self.limits
        limit_degc = limits.temperature_limit_degc
        self.hot = temperature_degc > limit_degc - (COOLED_DEGC if self.hot else 0.0)
        if self.hot or self.derating < 1.0:
            change = -DERATE_1_S * dt_s if self.hot else DERATE_1_S * dt_s
            self.derating = min(max(self.derating + change, DERATE_MIN), 1.0)
            self.bias_n = min(self.bias_n, self.ceiling_n)
        reach = limits.target_speed_m_s * dt_s
        self.over = tension_n > limits.tension_limit_n
        if self.over:
            self.target_m += reach
            self.wanted_m = max(self.wanted_m, self.target_m)
            return
        low, high = self.target_m - reach, self.target_m + reach
        target = self.wanted_m
        if not low <= target <= high:
            target = low if target < low else high
        if self.stiffness_n_m > 0.0:
            lowest = length_m - (self.ceiling_n - self.bias_n) / self.stiffness_n_m
            if target < lowest:
                target = min(lowest, high)
        self.target_m = target
