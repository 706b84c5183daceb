"""Safety of one arm, every tick: what may be wrong, what the loop does about it, and the limits.

One table of conditions with their reactions.  `examine` runs before the law sees the measured
values and makes one mask of conditions; it also rounds them to a grid far finer than any device,
so that the session holds exactly what the law saw in a third fewer bytes.  `limit` stands between
the law and the device: torque clamp, speed limit, not-a-number.  The temperature of a winding
follows two time constants: winding to housing, housing to air.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import fabs, floor, isfinite, sqrt
from typing import Any

import numba as nb
import numpy as np

from hil.excite.trajectory import Limits
from hil.rig.config import ArmConfig, SafetyConfig
from hil.signals.device import FloatArray, Status


class Reaction(IntEnum):
    """What a condition leads to, in the tick in which it is seen."""

    NOTE = 0
    PAUSE = 1
    FAULT = 2


@dataclass(frozen=True)
class Condition:
    """One row.

    Parameters
    ----------
    name : str
        As in events and tables.
    reaction : Reaction
        NOTE: recorded; PAUSE: motors zero until the operator resumes; FAULT: latched.
    text : str
        Sentence for the operator.
    """

    name: str
    reaction: Reaction
    text: str


_R = Reaction
#: Bit k of the recorded mask is row k; new rows come last, old sessions keep their meaning.
TABLE: tuple[Condition, ...] = (
    Condition("effort-limited", _R.NOTE, "the law asked for more than the torque limit"),
    Condition("force-yellow", _R.NOTE, "the force at the tip is high"),
    Condition("winding-yellow", _R.NOTE, "a motor is warm"),
    Condition("sensor-late", _R.NOTE, "a sensor repeated its last good value once"),
    Condition("joint-stale", _R.PAUSE, "the encoders repeat their last good value"),
    Condition("force-stale", _R.PAUSE, "the force sensor repeats its last good value"),
    Condition("force-saturated", _R.PAUSE, "the force sensor is at the end of its range"),
    Condition("force-red", _R.PAUSE, "the force at the tip is above its limit"),
    Condition("winding-red", _R.PAUSE, "a motor winding is too hot"),
    Condition("position", _R.PAUSE, "a joint is outside of its range"),
    Condition("workspace", _R.PAUSE, "the tip is outside of the workspace"),
    Condition("overrun", _R.PAUSE, "the loop missed too many periods"),
    Condition("overspeed", _R.FAULT, "a joint passed its speed_limit"),
    Condition("encoder-jump", _R.FAULT, "an encoder moved as no joint can"),
    Condition("encoder-stuck", _R.FAULT, "an encoder stands still under torque"),
    Condition("joint-lost", _R.FAULT, "the encoders do not answer"),
    Condition("force-lost", _R.FAULT, "the force sensor does not answer"),
    Condition("not-a-number", _R.FAULT, "a measured value is not a number"),
    Condition("effort-invalid", _R.FAULT, "an effort of the law was not a number"),
    Condition("motor-refused", _R.FAULT, "the motor driver refused a command"),
    Condition("watchdog-lost", _R.FAULT, "the watchdog does not answer"),
    Condition("power-cut", _R.FAULT, "the watchdog cut the power"),
    Condition("effort-exceeded", _R.FAULT, "a motor driver sent more than the torque limit"),
    Condition("law-invalid", _R.FAULT, "a state of the law was not a number"),
)
BITS: dict[str, int] = {c.name: 1 << k for k, c in enumerate(TABLE)}


def _mask(reaction: Reaction) -> int:
    return sum(BITS[c.name] for c in TABLE if c.reaction is reaction)


PAUSING, FAULTING = _mask(Reaction.PAUSE), _mask(Reaction.FAULT)


def named_conditions(mask: int) -> list[Condition]:
    """Conditions of a recorded mask, the worst first."""
    found = [c for k, c in enumerate(TABLE) if mask >> k & 1]
    return sorted(found, key=lambda c: -c.reaction)


def sentence(mask: int) -> str:
    """What a mask means, in words, the worst first."""
    return "; ".join(c.text for c in named_conditions(mask)) or "nothing is wrong"


#: Ticks before a fault that are looked back at.
LOOKED_BACK = 12


def alternates(efforts: FloatArray) -> FloatArray:
    """Whether efforts went up and down in turn, every tick, and not less and less so, (d,) of bool.

    Parameters
    ----------
    efforts : ndarray (n, d)
        Of the ticks before a fault.
    """
    steps = np.diff(efforts, axis=0)
    if len(steps) < LOOKED_BACK // 2:
        return np.zeros(efforts.shape[1], np.bool_)
    size, half = np.abs(steps), len(steps) // 2
    turns = np.mean(steps[1:] * steps[:-1] < 0.0, axis=0) > 0.85
    grows = size[-half:].mean(axis=0) >= size[:half].mean(axis=0)
    out: FloatArray = turns & grows & (size[-half:].max(axis=0) > 1e-2)
    return out


def violations(mask: int, joints: Sequence[str], q: Any, qd: Any, lim: Any) -> list[str]:
    """Which joints are what a mask says, with values and limits; empty where it is of no joint.

    Parameters
    ----------
    mask : int
        Conditions.
    joints : sequence of str
        Names, length d.
    q, qd : ndarray (d,)
        Positions and speeds of that tick.
    lim : ndarray
        Of `safety_limits`.

    Returns
    -------
    list of str
        In SI units of the joint: rad/s or m/s, rad or m.
    """
    found = []
    for i, name in enumerate(joints):
        low, high, fast = (float(lim[_ROWS + _BOUNDS * i + k]) for k in (_LOW, _HIGH, _SPEED))
        if mask & _FAST and not abs(qd[i]) <= fast:
            found.append(f"{name} at {qd[i]:.4g} of {fast:.4g}")
        if mask & _RANGE and not low <= q[i] <= high:
            found.append(f"{name} at {q[i]:.4g}, range {low:.4g} to {high:.4g}")
    return found


#: Outcomes, the larger the worse (as `hil.signals.device.Status`).
OK, CLAMPED, INVALID = 0, 1, 3


@nb.njit(cache=True, nogil=True)
def limit(effort: Any, velocity: Any, torque_limit: Any, speed_limit: Any) -> int:
    """Clamp `effort` (d,) [N m] in place; zero all of it where the state is not safe.

    Returns
    -------
    int
        `OK`, `CLAMPED`, or `INVALID`: an effort or speed is not a number, or a joint is faster
        than `speed_limit` (d,) [rad/s].
    """
    status = OK
    for i in range(effort.size):
        if not isfinite(effort[i]) or not fabs(velocity[i]) <= speed_limit[i]:
            status = INVALID
    for i in range(effort.size):
        if status == INVALID:
            effort[i] = 0.0
        elif fabs(effort[i]) > torque_limit[i]:
            effort[i] = torque_limit[i] if effort[i] > 0.0 else -torque_limit[i]
            status = CLAMPED
    return status


#: Copper: resistance per kelvin, about 25 degC [1/K].
COPPER = 0.00393
#: Order of the constants that `warm` takes.
CONSTANTS = (
    "resistance",
    "winding_to_housing",
    "housing_to_air",
    "winding_time",
    "housing_time",
    "ambient",
)


@nb.njit(cache=True, nogil=True)
def warm(current: float, dt: float, c: Any, heat: Any) -> float:
    """Advance one motor by `dt` [s] under `current` [A]; its winding temperature [degC].

    Parameters
    ----------
    c : ndarray (6,)
        `CONSTANTS`.
    heat : ndarray (2,)
        Rise of the housing over the air, and of the winding over the housing [K]; written.

    Notes
    -----
    Maxon, key information on motors: the two stages are first-order lags of the copper loss.
    Exact only while the stages are far apart in time (here 12 s and 612 s).
    """
    # P = R25 (1 + alpha (T - 25)) i^2
    temperature = c[5] + heat[0] + heat[1]
    loss = c[0] * (1.0 + COPPER * (temperature - 25.0)) * current * current
    # tau1 dT1/dt = R1 P - T1;  tau2 dT2/dt = R2 P - T2
    heat[1] += dt / c[3] * (c[1] * loss - heat[1])
    heat[0] += dt / c[4] * (c[2] * loss - heat[0])
    return float(c[5] + heat[0] + heat[1])


#: Grids: position 1/240 of a count [rad], velocity 1/20 of what the longest window resolves
#: [rad/s], force and torque 1/6 of a word of the finest sensor [N], [N m], effort 1/700 of a DAC
#: code [N m].
POSITION_GRID, VELOCITY_GRID, FORCE_GRID, TORQUE_GRID = 2.0**-21, 2.0**-12, 2.0**-13, 2.0**-20
EFFORT_GRID = 2.0**-24
#: What a count or two may do to a difference of positions [rad].
_FLOOR = 5e-4
#: How much further out a joint, a fold or the tip may get after a `resume` outside of its range, as
#: a share of the range; and the longest range of which that counts [rad or m], of the tip [m].
#: Half: an arm that fell while it was paused stops again before its law has caught it; double: it
#: may go on far outside.
_FURTHER, _LONGEST, _TIP_LONGEST = 0.2, 2.0, 0.25
#: Multiple of its torque limit that a driver may send: its last code is rounded.  Nearer to 1: a
#: coarse converter at a small limit faults; double: a gain of the wrong size goes on.  And what
#: rounding may add to it [N m or N], as a joint feels the codes of several motors.
_EXCESS, _ROUNDED = 1.25, 2e-3
#: A lamp goes back below this share of its threshold.
HYSTERESIS = 0.9
#: memory: hottest winding [degC] to a hundredth, stale joint and force readings, readings so far,
#: lamp, whether a joint is outside that may not be; then a row a joint: last position, last step,
#: time stood still, heat of its motor (2), how far it may be outside; then the same of each fold.
HOTTEST, _STALE_JS, _STALE_CF, _SEEN, _LAMP, ACUTE, _JOINTS = range(7)
_Q, _STEP, _STILL, _HEAT, _MAY, _KEPT = 0, 1, 2, 3, 5, 6
#: limits: acceleration, force yellow and red, stale readings, stuck time, winding yellow and red,
#: thermal constants (6), joints; then a row a joint: low, high, speed, torque, effort per ampere;
#: then number of folds and four numbers a fold.
_ACC, _FORCE, _READS, _STUCK, _HOT, _C, _D, _ROWS = 0, 1, 3, 4, 5, 7, 13, 14
_LOW, _HIGH, _SPEED, _TORQUE, _AMP, _BOUNDS = range(6)

_YELLOW, _WARM, _LATE = BITS["force-yellow"], BITS["winding-yellow"], BITS["sensor-late"]
_STALE_BITS = (BITS["joint-stale"], BITS["force-stale"])
_SATURATED, _RED, _HOT_BIT = BITS["force-saturated"], BITS["force-red"], BITS["winding-red"]
_RANGE, _FAST, _JUMP = BITS["position"], BITS["overspeed"], BITS["encoder-jump"]
_STUCK_BIT, _NAN = BITS["encoder-stuck"], BITS["not-a-number"]
_LOST = (BITS["joint-lost"], BITS["force-lost"])
_CLAMPED, _STALE, _INVALID = int(Status.CLAMPED), int(Status.STALE), int(Status.INVALID)


def memory(lim: FloatArray) -> FloatArray:
    """Empty memory of an arm with these `safety_limits`."""
    d = int(lim[_D])
    return np.zeros(_JOINTS + _KEPT * d + int(lim[_ROWS + _BOUNDS * d]))


def safety_limits(
    arm: ArmConfig, robot: Limits, safety: SafetyConfig, force_range: float
) -> FloatArray:
    """Numbers that `examine` takes.

    Parameters
    ----------
    arm, safety : ArmConfig, SafetyConfig
        Of the rig file.
    robot : Limits
        Ranges of the joints.
    force_range : float
        Of the force sensor [N]; infinite without one.
    """
    yellow = arm.force_yellow or 0.6 * force_range
    red = arm.force_red or 0.85 * force_range
    winding = arm.winding
    folds = [float(x) for fold in robot.folds for x in fold]
    # without the motors' constants nothing is known of their heat
    amps = winding.effort_per_amp or (np.inf,) * len(arm.joints)
    rows = zip(robot.low, robot.high, arm.speed_limit, arm.torque_limit, amps, strict=True)
    return np.array(
        [
            arm.acceleration_limit,
            yellow,
            red,
            safety.stale_ticks,
            safety.stuck_time,
            winding.yellow,
            winding.red,
            *(getattr(winding, n) for n in CONSTANTS),
            len(arm.joints),
            *(float(x) for row in rows for x in row),
            len(robot.folds),
            *folds,
        ]
    )


def lamps(numbers: FloatArray) -> tuple[float, float]:
    """Forces [N] from which the lamps of an arm are yellow and red; 0 where it has none.

    Parameters
    ----------
    numbers : ndarray
        Of `safety_limits`.
    """
    yellow, red = (float(x) for x in numbers[_FORCE : _FORCE + 2])
    return (yellow if isfinite(yellow) else 0.0, red if isfinite(red) else 0.0)


@nb.njit(cache=True, nogil=True)
def snap(values: Any, grid: float) -> bool:
    """Round `values` in place to multiples of `grid`; False if one is not a number."""
    good = True
    for i in range(values.size):
        if isfinite(values[i]):
            values[i] = floor(values[i] / grid + 0.5) * grid
        else:
            good = False
    return good


@nb.njit(cache=True, nogil=True)
def sensors(js: int, cf: int, memory: Any, lim: Any) -> int:
    """What the drivers said of their readings."""
    mask = 0
    for k, status, at in ((0, js, _STALE_JS), (1, cf, _STALE_CF)):
        if status == _STALE:
            memory[at] += 1.0
            mask |= _STALE_BITS[k] if memory[at] >= lim[_READS] else _LATE
        else:
            memory[at] = 0.0
        if status >= _INVALID:
            mask |= _LOST[k]
    if cf == _CLAMPED:
        mask |= _SATURATED
    return mask


@nb.njit(cache=True, nogil=True)
def _excess(x: float, low: float, high: float) -> float:
    """How far `x` is outside of a range; 0 within, infinite for what is no number."""
    if low <= x <= high:
        return 0.0
    return max(low - x, x - high) if isfinite(x) else np.inf


@nb.njit(cache=True, nogil=True)
def _room(low: float, high: float, longest: float) -> float:
    """How much further out of its range something may get, once it may be outside."""
    return _FURTHER * min(high - low, longest)


@nb.njit(cache=True, nogil=True)
def _further(out: float, may: Any, at: int, more: float) -> bool:
    """Whether what is `out` of its range may not be: it left it, or got further than it may.

    Parameters
    ----------
    out : float
        Of `_excess`.
    may : ndarray
        At `at` how far it may be out; becomes 0 where it is back within.
    more : float
        What it may get further.
    """
    if out == 0.0:
        may[at] = 0.0
        return False
    return not (may[at] > 0.0 and out <= may[at] + more)


@nb.njit(cache=True, nogil=True)
def out_of_range(q: Any, memory: Any, lim: Any, allow: bool) -> int:
    """Joints and folds that are out of their ranges; whether one may not be goes into `memory`.

    With `allow` those that are out may be as far out as they are, by a command of the operator.
    """
    mask, acute = 0, 0.0
    for i in range(q.size):
        row, at = _ROWS + _BOUNDS * i, _JOINTS + _KEPT * i + _MAY
        out = _excess(q[i], lim[row + _LOW], lim[row + _HIGH])
        if allow:
            memory[at] = out
        if _further(out, memory, at, _room(lim[row + _LOW], lim[row + _HIGH], _LONGEST)):
            acute = 1.0
        mask |= _RANGE if out > 0.0 else 0
    folds = _ROWS + _BOUNDS * q.size
    for k in range(int(lim[folds])):
        n, at = folds + 1 + 4 * k, _JOINTS + _KEPT * q.size + k
        out = _excess(q[int(lim[n])] - q[int(lim[n + 1])], lim[n + 2], lim[n + 3])
        if allow:
            memory[at] = out
        if _further(out, memory, at, _room(lim[n + 2], lim[n + 3], _LONGEST)):
            acute = 1.0
        mask |= _RANGE if out > 0.0 else 0
    memory[ACUTE] = acute
    return mask


@nb.njit(cache=True, nogil=True)
def _moved(q: Any, qd: Any, dt: float, single: bool, memory: Any, lim: Any) -> int:
    """Range, speed and steps of the joints."""
    mask = out_of_range(q, memory, lim, False)
    for i in range(q.size):
        own, row = _JOINTS + _KEPT * i, _ROWS + _BOUNDS * i
        if fabs(qd[i]) > lim[row + _SPEED]:
            mask |= _FAST
        step = q[i] - memory[own + _Q]
        if memory[_SEEN] >= 2.0:
            # |q_k - q_(k-1)| <= 2 v_max dt;  |q_k - 2 q_(k-1) + q_(k-2)| <= a_max dt^2
            if fabs(step) > 2.0 * lim[row + _SPEED] * dt + _FLOOR:
                mask |= _JUMP
            bend = lim[_ACC] * dt * dt + _FLOOR
            if single and memory[_SEEN] >= 4.0 and fabs(step - memory[own + _STEP]) > bend:
                mask |= _JUMP
        memory[own + _STEP], memory[own + _Q] = step, q[i]
    return mask


@nb.njit(cache=True, nogil=True)
def _driven(sent: Any, dt: float, memory: Any, lim: Any) -> int:
    """Heat of the motors, and joints that do not answer to them; `sent` of the last tick."""
    mask, hottest = 0, -273.0
    for i in range(sent.size):
        own, row = _JOINTS + _KEPT * i, _ROWS + _BOUNDS * i
        heat = memory[own + _HEAT : own + _HEAT + 2]
        constants = lim[_C : _C + 6]
        # of what is no number the worst is assumed
        effort = sent[i] if isfinite(sent[i]) else lim[row + _TORQUE]
        hottest = max(hottest, warm(effort / lim[row + _AMP], dt, constants, heat))
        pushed = fabs(effort) > 0.5 * lim[row + _TORQUE]
        still = fabs(memory[own + _STEP]) < 1e-6
        memory[own + _STILL] = memory[own + _STILL] + dt if pushed and still else 0.0
        if lim[_STUCK] > 0.0 and memory[own + _STILL] > lim[_STUCK]:
            mask |= _STUCK_BIT
    if hottest > lim[_HOT + 1]:
        mask |= _HOT_BIT
    if hottest > lim[_HOT]:
        mask |= _WARM
    return mask


@nb.njit(cache=True, nogil=True)
def pressed(wrench: Any, memory: Any, lim: Any) -> int:
    """Lamp of the force at the tip, with hysteresis."""
    force = sqrt(wrench[0] ** 2 + wrench[1] ** 2 + wrench[2] ** 2)
    lamp, last = 0, int(memory[_LAMP])
    for k in range(2):
        share = HYSTERESIS if last > k else 1.0
        if force > share * lim[_FORCE + k]:
            lamp = k + 1
    memory[_LAMP] = lamp
    return _RED | _YELLOW if lamp == 2 else (_YELLOW if lamp == 1 else 0)


@nb.njit(cache=True, nogil=True)
def examine(
    dt: float,
    single: bool,
    js: int,
    cf: int,
    q: Any,
    qd: Any,
    wrench: Any,
    sent: Any,
    memory: Any,
    lim: Any,
) -> int:
    """Conditions of one arm in one tick.

    Parameters
    ----------
    dt : float
        Time since the last tick [s].
    single : bool
        Whether that was one period, and the one before too.
    js, cf : int
        `Status` of the joint and the force reading.
    q, qd, wrench : ndarray (d,), (d,), (6,)
        Measured [rad], [rad/s], [N, N m]; rounded in place.
    sent : ndarray (d,)
        Efforts of the last tick [N m].
    memory, lim : ndarray
        What is kept between ticks; limits.
    """
    mask = sensors(js, cf, memory, lim)
    good = snap(q, POSITION_GRID) and snap(qd, VELOCITY_GRID)
    good = snap(wrench[:3], FORCE_GRID) and snap(wrench[3:], TORQUE_GRID) and good
    if not good:
        memory[HOTTEST], memory[ACUTE] = hottest(memory, lim), 0.0
        return mask | _NAN
    # a repeated reading is no motion, and what follows it is no single step
    if js == _STALE:
        memory[_SEEN], memory[ACUTE] = min(memory[_SEEN], 1.0), 0.0
    else:
        memory[_SEEN] += 1.0
        mask |= _moved(q, qd, dt, single, memory, lim)
    mask |= _driven(sent, dt, memory, lim) | pressed(wrench, memory, lim)
    memory[HOTTEST] = hottest(memory, lim)
    return mask


@nb.njit(cache=True, nogil=True)
def hottest(memory: Any, lim: Any) -> float:
    """Hottest winding of an arm [degC], to a hundredth."""
    rise = 0.0
    for i in range(int(lim[_D])):
        own = _JOINTS + _KEPT * i + _HEAT
        rise = max(rise, memory[own] + memory[own + 1])
    return float(floor(100.0 * (lim[_C + 5] + rise) + 0.5) / 100.0)


@nb.njit(cache=True, nogil=True)
def leave(sent: Any, counts: Any, codes: Any, gauges: Any, words: Any) -> None:
    """What of the exchange goes into the row: `sent` (d,) rounded, `words` filled."""
    snap(sent, EFFORT_GRID)
    d = sent.size
    for i in range(d):
        words[i] = counts[i]
        words[d + i] = codes[i]
    for i in range(6):
        words[2 * d + i] = gauges[i]


@nb.njit(cache=True, nogil=True)
def exceeded(sent: Any, torque_limit: Any) -> bool:
    """Whether a driver sent more than `_EXCESS` times the limit (d,) [N m], or no number."""
    for i in range(sent.size):
        if not fabs(sent[i]) <= _EXCESS * torque_limit[i] + _ROUNDED:
            return True
    return False


@nb.njit(cache=True, nogil=True)
def all_finite(values: Any) -> bool:
    """Whether all are numbers."""
    for i in range(values.size):
        if not isfinite(values[i]):
            return False
    return True


@nb.njit(cache=True, nogil=True)
def outside(tip: Any, box: Any, may: Any, allow: bool) -> int:
    """Whether `tip` (3,) is within `box` (2, 3) [m] (0), outside but may be (1), or may not (2).

    `may` (3,) is how far it may be outside; with `allow` it becomes as far as it is.
    """
    found = 0
    for i in range(3):
        out = _excess(tip[i], box[0, i], box[1, i])
        if allow:
            may[i] = out
        if _further(out, may, i, _room(box[0, i], box[1, i], _TIP_LONGEST)):
            found = 2
        elif out > 0.0 and found == 0:
            found = 1
    return found
