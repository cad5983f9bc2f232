"""The control loops of all muscle modules of one robot, vectorised: tension and length to speed.

Each module runs the paper's muscle stiffness control, f_ref = f_bias + k_stiff (l - l_ref), and a
tension loop that winds or pays out wire until the load cell reads f_ref. Around it stand what keeps
a wire whole: limits of tension, speed and temperature, the bus watchdog, and the latched stop.
What a module is told and what it answers stands in `firmware.py`.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware_sim.muscle_rows import ROWS, Array, MuscleRows
from runtime.wire.registers import HardwareError, Status

# The elastic element stiffens with tension, so the loop's gain falls with it: a slack wire is wound
# in quickly, and gain x stiffness x (motor lag + 1 ms) stays near 0.2 from slack to the limit.
GAIN_M_S_N = 0.006
GAIN_HALVES_AT_N = 40.0
GUARD_GAIN_M_S_N = 0.01  # 15 N above the guard pays out 0.15 m/s; x 40 kN/m x 1 ms = 0.4
LOOK_AHEAD_S = 0.002  # the guard looks at the tension that comes, as the motor lags behind
GUARD = 0.88  # of the tension limit: no reference above it, and the guard pays out from there
# A slack side is paid out at up to GAIN x 25 N = 0.15 m/s: with f_ref >= 0 it would lag behind the
# joint, as there is no tension left for the loop to see.
SLACK_REFERENCE_N = -25.0
STOP_SPEED_M_S = 0.05
STOP_TENSION_N = 3.0  # below, a stopping wire is slack ...
RESUME_TENSION_N = 6.0  # ... above, a stopped one carries the sinking arm again: pay out more
OVERLOAD_S = 0.1
LOAD_CELL_N = (-25.0, 2.0)  # impossible: below this, or above so many tension limits
COOLED_DEGC = 5.0  # below the limit: full tension is allowed again
DERATE_1_S = 0.1  # an overheated module gives up a tenth of its reference's limit a second
DERATE_MIN = 0.3
CHECK_NS = 5_000_000  # watchdog and temperatures are slow: looked at every 5 ms
# A target's speed is measured by the packets' stamps, over at least this long.
TARGET_WINDOW_NS = 10_000_000

# numpy takes an array of no dimension at half the price of a float
_SLACK_REFERENCE_N = np.array(SLACK_REFERENCE_N)
_GAIN_HALVES_AT_N = np.array(GAIN_HALVES_AT_N)
_LOAD_CELL_LOW_N = np.array(LOAD_CELL_N[0])
_NOTHING, _ONE = np.array(0.0), np.array(1.0)


class Mode(IntEnum):
    """What a module does with its wire. The values are those of the `status` register."""

    OFF = 0  # torque off: braked
    FOLLOWING = Status.FOLLOWING
    HOLDING = Status.HOLDING  # watchdog or load cell: braked, tension capped
    STOPPING = Status.STOPPING
    STOPPED = Status.STOPPED


class MuscleBank(MuscleRows):
    """Firmware of M muscle modules, in the order in which they were added.

    Attributes, each of shape (M,); lengths and tensions are as the module reports them, with its
    length zero and its tare taken off:
        bias_n, stiffness_n_m, target_length_m: goals.
        tension_limit_n, winding_speed_limit_m_s, temperature_limit_degc: limits.
        tension_n, length_m, temperature_degc: as last measured.
        length_zero_m, tension_tare_n: taken off the raw readings.
        mode: a `Mode` each.
        hardware_error: bits of `HardwareError`, latched until reboot.
        peak_target_speed_m_s: fastest that the target moved over some 10 ms, obeyed all the time.
    """

    def __init__(self) -> None:
        self.now_ns = 0
        self.sent_ns = 0  # when the packet that is being obeyed was sent, if that is known
        self._next_check_ns = 0
        super().__init__()

    def set_column(self, index: int, column: dict[str, Any]) -> None:
        """As `MuscleRows.set_column`; the loop goes on in the mode that was saved."""
        super().set_column(index, column)
        self._limits_changed()
        self._drive(index)

    def step(
        self,
        dt_s: float,
        tension_n: Array,
        length_m: Array,
        temperature_degc: Array,
        now_ns: int,
    ) -> Array:
        """One run of all control loops.

        Args:
            dt_s: since the last call; the loops are made for 1 ms.
            tension_n, length_m, temperature_degc: raw readings, each (M,).
            now_ns: robot time.

        Returns:
            Winding speeds [m/s], (M,), positive pays out wire; overwritten by the next call.
        """
        self.now_ns = now_ns
        tension, length = self.tension_n, self.length_m
        reference, speed, guard, divisor = self._buffers
        ahead = LOOK_AHEAD_S / dt_s
        np.multiply(tension, -GUARD_GAIN_M_S_N * ahead, out=guard)
        np.subtract(tension_n, self.tension_tare_n, out=tension)
        np.subtract(length_m, self.length_zero_m, out=length)
        if now_ns >= self._next_check_ns:
            self.temperature_degc[:] = temperature_degc
            self._check(now_ns)

        np.subtract(length, self.target_length_m, out=reference)
        reference *= self.stiffness_n_m
        reference += self.bias_n
        np.minimum(reference, self._ceiling_n, out=reference)
        np.maximum(reference, _SLACK_REFERENCE_N, out=reference)
        np.subtract(tension, reference, out=speed)
        speed *= self._gain
        np.add(tension, _GAIN_HALVES_AT_N, out=divisor)
        np.maximum(divisor, _GAIN_HALVES_AT_N, out=divisor)
        speed /= divisor
        if self._stops:
            speed += self._pay_out_m_s

        # gain (f + ahead (f - f_before) - guard), f_before's part is there already
        np.multiply(tension, GUARD_GAIN_M_S_N * (1.0 + ahead), out=divisor)
        guard += divisor
        guard -= self._guard_m_s
        np.maximum(speed, guard, out=speed)  # in every mode: a brake slips, too
        np.minimum(speed, self.winding_speed_limit_m_s, out=speed)
        np.maximum(speed, self._winding_limit_m_s, out=speed)
        if self._stops:
            self._watch_stop()
        return speed

    def capped(self, index: int) -> bool:
        """Whether the stiffness law asks for more tension than is allowed."""
        stretch = self.length_m.item(index) - self.target_length_m.item(index)
        wanted = self.bias_n.item(index) + self.stiffness_n_m.item(index) * stretch
        return wanted > self._ceiling_n.item(index)

    # ── what a module is told ────────────────────────────────────────────────────────────────

    def set_target(self, index: int, length_m: float) -> None:
        """A new target length; how fast it moved is measured where it was obeyed."""
        obeyed = self.mode.item(index) == Mode.FOLLOWING and self.stiffness_n_m.item(index) > 0.0
        since_ns = self.target_since_ns.item(index)
        sent_ns = self.sent_ns or self.now_ns
        if not obeyed:
            self.target_since_ns[index] = -1
        elif since_ns < 0:
            self.target_since_ns[index], self.target_from_m[index] = sent_ns, length_m
        elif sent_ns - since_ns >= TARGET_WINDOW_NS:
            elapsed_s = (sent_ns - since_ns) * 1e-9
            speed = abs(length_m - self.target_from_m.item(index)) / elapsed_s
            if speed > self.peak_target_speed_m_s.item(index):
                self.peak_target_speed_m_s[index] = speed
            self.target_since_ns[index], self.target_from_m[index] = sent_ns, length_m
        self.target_length_m[index] = length_m

    def set_limit(self, index: int, row: str, value: float) -> None:
        """Write a limit or a zero; the reading moves with its zero at once."""
        if row == "length_zero_m":
            self.length_m[index] += self.length_zero_m[index] - value
        elif row == "tension_tare_n":
            self.tension_n[index] += self.tension_tare_n[index] - value
        getattr(self, row)[index] = value
        self._limits_changed()

    def set_torque(self, index: int, on: bool) -> None:
        """Obey goals, or brake."""
        self.torque[index] = on
        self.heard_ns[index] = self.now_ns
        self._drive(index)

    def set_stop(self, index: int, on: bool) -> None:
        """Latch the stop, whatever the mode was, or clear it."""
        if on != bool(self.stop[index]):
            self.stop[index] = on
            self._drive(index)

    def set_watchdog(self, index: int, timeout_s: float) -> None:
        """Silence on the line after which the module holds; 0: never. Clears a tripped one."""
        self.watchdog_s[index] = timeout_s
        self.tripped[index] = 0.0
        self.heard_ns[index] = self.now_ns
        self._drive(index)

    def reboot(self, index: int) -> None:
        """Forget goals, errors and latches; torque off."""
        for name in ("bias_n", "stiffness_n_m", "target_length_m", "torque", "stop", "tripped",
                     "watchdog_s", "hardware_error", "derating", "overload_s",
                     "target_since_ns"):  # fmt: skip
            getattr(self, name)[index] = ROWS[name]
        self._limits_changed()
        self._drive(index)

    # ── inside ───────────────────────────────────────────────────────────────────────────────

    def _use(self, table: Array) -> None:
        super()._use(table)
        count = len(self)
        self._buffers = tuple(np.zeros((4, count)))
        self._gain, self._pay_out_m_s, self._patience_ns = np.zeros((3, count))
        self._limits_changed()
        for index in range(count):
            self._set_drive(index)
            self._set_patience(index)
        self._count_stops()

    def _limits_changed(self) -> None:
        self._guard_n = GUARD * self.tension_limit_n
        self._guard_m_s = GUARD_GAIN_M_S_N * self._guard_n
        self._ceiling_n = self._guard_n * self.derating
        self._winding_limit_m_s = -self.winding_speed_limit_m_s

    def _drive(self, index: int) -> None:
        """Find the mode from its causes, the gravest first, and set the loop to it."""
        before = self.mode[index]
        if self.stop[index]:
            mode = Mode.STOPPED if before == Mode.STOPPED else Mode.STOPPING
        elif not self.torque[index]:
            mode = Mode.OFF
        elif self.tripped[index] or int(self.hardware_error[index]) & HardwareError.LOAD_CELL:
            mode = Mode.HOLDING
        else:
            mode = Mode.FOLLOWING
        self.mode[index] = mode
        self._set_patience(index)
        if mode == Mode.FOLLOWING and before != Mode.FOLLOWING:
            self._start_following(index)
        self._set_drive(index)
        self._count_stops()

    def _start_following(self, index: int) -> None:
        """Begin at the tension that is there, so that enabling torque moves nothing.

        The X series does the like: enabling torque sets the goal to the present position.
        """
        stiffness = self.stiffness_n_m[index]
        tension = min(max(self.tension_n[index], 0.0), self._ceiling_n[index])
        stretch = (tension - self.bias_n[index]) / stiffness if stiffness > 0.0 else 0.0
        self.target_length_m[index] = self.length_m[index] - stretch
        self.target_since_ns[index] = -1

    def _set_drive(self, index: int) -> None:
        mode = self.mode[index]
        gain = GAIN_M_S_N * GAIN_HALVES_AT_N  # to be divided by 40 N and the tension
        self._gain[index] = gain if mode == Mode.FOLLOWING else 0.0
        self._pay_out_m_s[index] = STOP_SPEED_M_S if mode == Mode.STOPPING else 0.0

    def _set_patience(self, index: int) -> None:
        watched = self.watchdog_s[index] and self.torque[index] and not self.tripped[index]
        self._patience_ns[index] = self.watchdog_s[index] * 1e9 if watched else np.inf

    def _count_stops(self) -> None:
        self._stops = bool(self.stop.any())

    def _watch_stop(self) -> None:
        for index in np.flatnonzero(self.stop).tolist():
            tension = self.tension_n[index]
            if self.mode[index] == Mode.STOPPING and tension < STOP_TENSION_N:
                self.mode[index] = Mode.STOPPED
            elif self.mode[index] == Mode.STOPPED and tension > RESUME_TENSION_N:
                self.mode[index] = Mode.STOPPING
            self._set_drive(index)

    def _check(self, now_ns: int) -> None:
        self._next_check_ns = now_ns + CHECK_NS
        silent = now_ns - self.heard_ns > self._patience_ns
        if any(silent.tolist()):
            for index in np.flatnonzero(silent).tolist():
                self.tripped[index] = 1.0
                self._drive(index)
        odd = self.temperature_degc > self.temperature_limit_degc
        odd |= self.derating < _ONE
        odd |= self.tension_n > self.tension_limit_n
        odd |= self.tension_n < _LOAD_CELL_LOW_N
        odd |= self.overload_s > _NOTHING
        if any(odd.tolist()):
            self._judge()

    def _judge(self) -> None:
        """Act on what is too hot, pulls too hard or reads what cannot be."""
        elapsed_s = CHECK_NS * 1e-9
        hot = self.temperature_degc > self.temperature_limit_degc
        cool = self.temperature_degc < self.temperature_limit_degc - COOLED_DEGC
        if hot.any() or (self.derating < 1.0).any():
            change = DERATE_1_S * elapsed_s * (cool.astype(float) - hot)
            np.minimum(np.maximum(self.derating + change, DERATE_MIN), 1.0, out=self.derating)
            self._ceiling_n = self._guard_n * self.derating
            self._raise(hot, HardwareError.OVERHEATING)

        over = self.tension_n > self.tension_limit_n
        self.overload_s[:] = np.where(over, self.overload_s + elapsed_s, 0.0)
        if over.any():
            self._raise(self.overload_s > OVERLOAD_S, HardwareError.OVERLOAD)
        low, limits = LOAD_CELL_N
        broken = (self.tension_n < low) | (self.tension_n > limits * self.tension_limit_n)
        if broken.any():
            self._raise(broken, HardwareError.LOAD_CELL)

    def _raise(self, where: NDArray[np.bool_], error: HardwareError) -> None:
        for index in np.flatnonzero(where).tolist():
            bits = int(self.hardware_error[index])
            if not bits & error:
                self.hardware_error[index] = bits | error
                self._drive(index)
