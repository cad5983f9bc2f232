"""The control loops of all muscle modules of one robot: tension and length to speed.

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

from hardware_sim.compiled import INTEGER, NUMBER, VECTOR, compiled, records
from hardware_sim.muscle_rows import MUSCLE, ROWS, Array, MuscleRows, picker
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


class Mode(IntEnum):
    """What a module does with its wire. The values are those of the `status` register."""

    OFF = 0  # torque off: braked
    FOLLOWING = Status.FOLLOWING
    HOLDING = Status.HOLDING  # watchdog or load cell: braked, tension capped
    STOPPING = Status.STOPPING
    STOPPED = Status.STOPPED


_FOLLOWING, _TENSION_CAPPED = int(Mode.FOLLOWING), int(Status.TENSION_CAPPED)
_PRESENT = picker(
    "bias_n",
    "stiffness_n_m",
    "target_length_m",
    "tension_limit_n",
    "tension_n",
    "length_m",
    "temperature_degc",
    "mode",
    "derating",
)


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
            Winding speeds [m/s], (M,), positive pays out wire; the next call writes them anew.
        """
        self.now_ns = now_ns
        if now_ns >= self._next_check_ns:
            self._next_check_ns = now_ns + CHECK_NS
            self.temperature_degc[:] = temperature_degc
            if _odd(self._table, tension_n, now_ns):
                self._judge(tension_n - self.tension_tare_n)
        _run_loops(self._table, dt_s, tension_n, length_m, self._speed_m_s)
        return self._speed_m_s

    def present(self, index: int) -> tuple[float, float, float, int]:
        """Length [m], tension [N], temperature [degC] and `Status` of one module."""
        bias, stiffness, target, limit, tension, length, temperature, mode, derating = (
            _PRESENT.unpack_from(self._memory, index * _PRESENT.size)
        )
        # the stiffness law asks for more tension than is allowed
        capped = bias + stiffness * (length - target) > GUARD * limit * derating
        return length, tension, temperature, int(mode) | (_TENSION_CAPPED if capped else 0)

    # ── what a module is told ────────────────────────────────────────────────────────────────

    def set_target(self, index: int, length_m: float) -> None:
        """A new target length; how fast it moved is measured where it was obeyed."""
        obeyed = self.mode.item(index) == _FOLLOWING and self.stiffness_n_m.item(index) > 0.0
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
        self._drive(index)

    # ── inside ───────────────────────────────────────────────────────────────────────────────

    def _use(self, table: NDArray[np.void]) -> None:
        super()._use(table)
        self._speed_m_s = np.zeros(len(table))

    def _ceiling_n(self, index: int) -> float:
        return GUARD * self.tension_limit_n.item(index) * self.derating.item(index)

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
        if mode == Mode.FOLLOWING and before != Mode.FOLLOWING:
            self._start_following(index)

    def _start_following(self, index: int) -> None:
        """Begin at the tension that is there, so that enabling torque moves nothing.

        The X series does the like: enabling torque sets the goal to the present position.
        """
        stiffness = self.stiffness_n_m[index]
        tension = min(max(self.tension_n[index], 0.0), self._ceiling_n(index))
        stretch = (tension - self.bias_n[index]) / stiffness if stiffness > 0.0 else 0.0
        self.target_length_m[index] = self.length_m[index] - stretch
        self.target_since_ns[index] = -1

    def _judge(self, tension_n: Array) -> None:
        """Act on who has not been spoken to, is too hot, pulls too hard or reads what cannot be."""
        silent = self.now_ns - self.heard_ns > self.watchdog_s * 1e9
        silent &= (self.watchdog_s > 0.0) & (self.torque > 0.0) & (self.tripped == 0.0)
        for index in np.flatnonzero(silent).tolist():
            self.tripped[index] = 1.0
            self._drive(index)

        elapsed_s = CHECK_NS * 1e-9
        hot = self.temperature_degc > self.temperature_limit_degc
        cool = self.temperature_degc < self.temperature_limit_degc - COOLED_DEGC
        if hot.any() or (self.derating < 1.0).any():
            change = DERATE_1_S * elapsed_s * (cool.astype(float) - hot)
            np.minimum(np.maximum(self.derating + change, DERATE_MIN), 1.0, out=self.derating)
            self._raise(hot, HardwareError.OVERHEATING)

        over = tension_n > self.tension_limit_n
        self.overload_s[:] = np.where(over, self.overload_s + elapsed_s, 0.0)
        if over.any():
            self._raise(self.overload_s > OVERLOAD_S, HardwareError.OVERLOAD)
        low, limits = LOAD_CELL_N
        broken = (tension_n < low) | (tension_n > limits * self.tension_limit_n)
        if broken.any():
            self._raise(broken, HardwareError.LOAD_CELL)

    def _raise(self, where: NDArray[np.bool_], error: HardwareError) -> None:
        for index in np.flatnonzero(where).tolist():
            bits = int(self.hardware_error[index])
            if not bits & error:
                self.hardware_error[index] = bits | error
                self._drive(index)


@compiled(records(MUSCLE), VECTOR, INTEGER)
def _odd(muscles: Any, load_n: Array, now_ns: int) -> bool:
    """Whether `_judge` has to look at any of the muscles."""
    for i in range(len(muscles)):
        muscle = muscles[i]
        tension = load_n[i] - muscle.tension_tare_n
        watched = muscle.watchdog_s > 0.0 and muscle.torque > 0.0 and muscle.tripped == 0.0
        if (
            (watched and now_ns - muscle.heard_ns > muscle.watchdog_s * 1e9)
            or muscle.temperature_degc > muscle.temperature_limit_degc
            or muscle.derating < 1.0
            or tension > muscle.tension_limit_n
            or tension < LOAD_CELL_N[0]
            or muscle.overload_s > 0.0
        ):
            return True
    return False


@compiled(records(MUSCLE), NUMBER, VECTOR, VECTOR, VECTOR)
def _run_loops(
    muscles: Any, dt_s: float, load_n: Array, encoder_m: Array, speed_m_s: Array
) -> None:
    """Readings in, winding speeds out."""
    ahead = LOOK_AHEAD_S / dt_s
    for i in range(len(muscles)):
        muscle = muscles[i]
        before = muscle.tension_n
        tension = load_n[i] - muscle.tension_tare_n
        length = encoder_m[i] - muscle.length_zero_m
        muscle.tension_n, muscle.length_m = tension, length
        guard = GUARD * muscle.tension_limit_n
        mode = int(muscle.mode)

        speed = 0.0
        if mode == Mode.FOLLOWING:
            reference = muscle.stiffness_n_m * (length - muscle.target_length_m) + muscle.bias_n
            reference = max(min(reference, guard * muscle.derating), SLACK_REFERENCE_N)
            loop = GAIN_M_S_N * GAIN_HALVES_AT_N * (tension - reference)
            speed = loop / max(tension + GAIN_HALVES_AT_N, GAIN_HALVES_AT_N)
        elif mode == Mode.STOPPING:
            speed = STOP_SPEED_M_S

        # gain (f + ahead (f - f_before) - guard), in every mode: a brake slips, too
        slip = GUARD_GAIN_M_S_N * (1.0 + ahead) * tension - GUARD_GAIN_M_S_N * ahead * before
        speed = max(speed, slip - GUARD_GAIN_M_S_N * guard)
        limit = muscle.winding_speed_limit_m_s
        speed_m_s[i] = max(min(speed, limit), -limit)

        if mode == Mode.STOPPING and tension < STOP_TENSION_N:
            muscle.mode = Mode.STOPPED.value
        elif mode == Mode.STOPPED and tension > RESUME_TENSION_N:
            muscle.mode = Mode.STOPPING.value
