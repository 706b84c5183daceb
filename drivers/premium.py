"""PHANTOM Premium 1.5: three joints, motor encoders, motor DACs; operating states.

Compiled code turns counts into the joint state and joint efforts into DAC codes.  The constants of
the drive train stand here, each with its source.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import fabs, floor, inf, isfinite
from typing import Any

import numba as nb
import numpy as np

from hil.errors import ConfigError, DeviceError
from hil.signals.device import FloatArray, OperatingState, StateCommand, StateMachine, Status, Wire
from hil.signals.velocity import estimator

#: Joints of the arm, and the robot that the constants are of.
_JOINTS, _ROBOT = 3, "phantom-premium-1.5"
#: Bits of a DAC; boxes take codes of 16 bits.
FEWEST_BITS, MOST_BITS = 8, 16
_TURNED = " {0} get a minus before their places in channels.{1}, e.g. '-BOX/0'."
_MOTORS = _TURNED.format("Amplifiers that invert and motors that turn the other way", "motors")
#: Option that is above 0 -> what stands for its sign.
_POSITIVE = {
    "counts_per_turn": _TURNED.format("Encoders that count the other way", "encoders"),
    "torque_constant": _MOTORS,
    "amps_per_volt": _MOTORS,
    "dac_volts": _MOTORS,
    "stall_torque": "",
}


@dataclass(frozen=True)
class PremiumConfig:
    """How counts become angles and torques become codes.

    Parameters
    ----------
    gear : tuple of 3 tuples of 3 floats
        Motor angles = gear @ joint angles; joint 3 is measured from the base, hence diagonal
        (cable reductions 13.3, 11.2, 11.2: mahilab/Phantom, after Cavusoglu et al. 2002).
    counts_per_turn : int
        HEDM-5500 with 1024 lines, four edges each.
    torque_constant : float
        Maxon RE25 118743 [N m/A].
    amps_per_volt, dac_volts, dac_bits : float, float, int
        Amplifier [A/V] and its DAC; all above 0.  An amplifier that inverts gets a minus before
        its place in ``channels.motors``.
    stall_torque : float
        Of the motor [N m].
    home : tuple of 3 floats
        Joint angles at which the arm rests when it is opened [rad]; encoders that count from
        where they were switched on are referred to it.
    velocity : str
        Velocity estimator, a name of the registry group ``hil.velocity``.
    velocity_options : mapping
        Its options, e.g. ``{ cutoff_hz = 30.0 }``.
    """

    gear: tuple[tuple[float, ...], ...] = ((13.3, 0.0, 0.0), (0.0, 11.2, 0.0), (0.0, 0.0, 11.2))
    counts_per_turn: int = 4096
    torque_constant: float = 0.0234
    amps_per_volt: float = 0.5513
    dac_volts: float = 10.0
    dac_bits: int = 16
    stall_torque: float = 0.129
    home: tuple[float, ...] = (0.0, 0.0, 0.0)
    velocity: str = "foaw-end-fit"
    velocity_options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if len(self.home) != _JOINTS:
            raise ConfigError("home: three joint angles [rad] are needed.")
        for name, hint in _POSITIVE.items():
            value = getattr(self, name)
            if not 0.0 < value < inf:
                raise ConfigError(f"{name} = {value:g}; a number above 0 is needed.{hint}")
        if not FEWEST_BITS <= self.dac_bits <= MOST_BITS:
            raise ConfigError(
                f"dac_bits = {self.dac_bits}; {FEWEST_BITS} to {MOST_BITS} is needed, the bits of "
                "the DAC before the amplifier."
            )
        self._refuse_gear()
        if self.top < 1:
            raise ConfigError(
                f"stall_torque = {self.stall_torque:g} N m is less than one code of the DAC, "
                f"{self.motor_step:.3g} N m, so no torque could go out; compare it with "
                "torque_constant, amps_per_volt, dac_volts and dac_bits."
            )

    def _refuse_gear(self) -> None:
        """Refuse what turns no motor angles into joint angles."""
        size = [len(row) for row in self.gear]
        if size != [_JOINTS] * _JOINTS:
            raise ConfigError(
                f"gear has {len(size)} rows of {size} numbers; three rows of three are needed, "
                "motor angles = gear @ joint angles."
            )
        gear = np.array(self.gear)
        if not np.isfinite(gear).all() or np.linalg.matrix_rank(gear) < _JOINTS:
            raise ConfigError(
                f"gear = {[list(row) for row in self.gear]} cannot be inverted: a joint moves no "
                "motor, or two joints move the motors alike; give each joint the reduction of its "
                "cable drive."
            )

    @property
    def motor_step(self) -> float:
        """Motor torque of one code [N m]."""
        volts = self.dac_volts / (1 << (self.dac_bits - 1))
        return volts * self.amps_per_volt * self.torque_constant

    @property
    def top(self) -> int:
        """Largest code: of the stall torque, or of the DAC."""
        return min(int(self.stall_torque / self.motor_step), (1 << (self.dac_bits - 1)) - 1)

    def refuse_arm(self, arm: str, robot: str, joints: int) -> None:
        """Refuse an arm that this driver or its constants are not of.

        Parameters
        ----------
        arm, robot : str
            Name of the arm, and its preset; that is empty for a URDF.
        joints : int
            How many joints the arm has.
        """
        if joints != _JOINTS:
            raise ConfigError(
                f"the driver reads three encoders and drives three motors, and arm {arm!r} has "
                f"{joints} joints; name the driver of its drives."
            )
        if robot not in ("", _ROBOT) and self.gear == PremiumConfig.gear:
            raise ConfigError(
                f"the reductions and motors of the driver are those of {_ROBOT}, and arm {arm!r} "
                f"is a {robot!r}; set robot = {_ROBOT!r}, or give the arm's own gear, "
                "counts_per_turn, torque_constant, amps_per_volt and stall_torque as options."
            )


@nb.njit(cache=True, nogil=True)
def _joint_state(
    counts: Any, rate: Any, to_joint: Any, period: float, position: Any, velocity: Any
) -> None:
    """Position [rad] and velocity [rad/s] from counts and their rates.

    Parameters
    ----------
    counts : ndarray (3,)
        Motor counts now.
    rate : ndarray (3,)
        Motor counts per period.
    to_joint : ndarray (3, 3)
        Joint angle per motor count [rad].
    period : float
        Sample period [s].
    """
    for i in range(3):
        position[i] = 0.0
        velocity[i] = 0.0
        for j in range(3):
            # count n stands for the interval n..n+1: take its middle
            position[i] += to_joint[i, j] * (counts[j] + 0.5)
            velocity[i] += to_joint[i, j] * (rate[j] / period)


@nb.njit(cache=True, nogil=True)
def codes(effort: Any, to_code: Any, to_effort: Any, top: int, out: Any, sent: Any) -> int:
    """DAC codes for joint efforts; 0 = as asked, 1 = clamped, 3 = not a number (all zero).

    Parameters
    ----------
    effort, sent : ndarray (3,)
        Asked for, and really going out [N m].
    to_code, to_effort : ndarray (3, 3)
        Codes per N m and back.
    top : int
        Largest code.
    out : ndarray (3,)
        Codes.
    """
    status = 0
    for i in range(3):
        if not isfinite(effort[i]):
            status = 3
    for i in range(3):
        value = 0.0
        if status != 3:
            for j in range(3):
                value += to_code[i, j] * effort[j]
        if fabs(value) > top:
            value = top if value > 0.0 else -top
            status = 1
        out[i] = floor(value + 0.5)
    for i in range(3):
        sent[i] = 0.0
        for j in range(3):
            sent[i] += to_effort[i, j] * out[j]
    return status


_STATUS = tuple(Status)
#: Looked up once: members of an enumeration are slow to find in the fast path.
_INVALID, _LOST = Status.INVALID, Status.LOST
_ENABLED, _FAULT = OperatingState.ENABLED, OperatingState.FAULT


class PremiumArm:
    """One arm: `MeasuredJs` and `ServoJf`.

    Parameters
    ----------
    name : str
        Name of the device.
    wire : Wire
        Wire to its encoders and DACs.
    config : PremiumConfig
        Drive train.
    period : float
        Sample period [s].
    """

    def __init__(self, name: str, wire: Wire, config: PremiumConfig, period: float) -> None:
        self.name = name
        self._wire = wire
        self._machine = StateMachine(name)
        self._period = period
        gear = np.array(config.gear)
        # theta = gear^-1 * 2 pi / counts_per_turn * counts
        self._to_joint = np.linalg.inv(gear) * (2 * np.pi / config.counts_per_turn)
        # tau = gear^T tau_motor
        self._to_effort = gear.T * config.motor_step
        self._to_code = np.linalg.inv(self._to_effort)
        self._top = config.top
        self._period_ns = round(period * 1e9)
        self._last_ns, self._begun = 0, False
        # counts = floor(gear theta counts_per_turn / 2 pi)
        at_home = gear @ np.array(config.home) * config.counts_per_turn / (2 * np.pi)
        wire.home(np.floor(at_home).astype(np.int64))
        self.counts = wire.counts
        self._rate = np.zeros(3)
        self._velocity = estimator(config.velocity, dict(config.velocity_options), 3, period)
        self.codes = np.zeros(3, np.int64)

    @property
    def state(self) -> OperatingState:
        """Operating state now."""
        return self._machine.state

    @property
    def effort_limit(self) -> FloatArray:
        """Largest joint effort that a single DAC can ask for [N m] (3,)."""
        return np.asarray(np.abs(self._to_effort).max(axis=1) * self._top)

    def measured_js(self, t_ns: int, position: FloatArray, velocity: FloatArray) -> Status:
        """Write position [rad] and velocity [rad/s] (3,) at `t_ns`.

        A wire that is lost takes the arm to FAULT.
        """
        status = self._wire.receive(t_ns)
        steps = max(1, (t_ns - self._last_ns + self._period_ns // 2) // self._period_ns)
        self._last_ns = t_ns
        if not self._begun:  # where the arm rests is known from the first reading on
            self._begun = True
            self._velocity.reset(self.counts)
        self._velocity.update(self.counts, steps, self._rate)
        _joint_state(self.counts, self._rate, self._to_joint, self._period, position, velocity)
        if status is _LOST:
            self._machine.command(StateCommand.FAULT)
            return _INVALID
        return status

    def servo_jf(self, effort: FloatArray, sent: FloatArray) -> Status:
        """Send `effort` [N m] (3,) as DAC codes; `sent` = what they stand for.

        Not a number: no torque, and the arm goes to FAULT.  Not ENABLED: no torque.
        """
        status = _STATUS[codes(effort, self._to_code, self._to_effort, self._top, self.codes, sent)]
        if status is _INVALID:
            self._machine.command(StateCommand.FAULT)
        if self._machine.state is not _ENABLED:
            self.codes[:] = 0
            sent[:] = 0.0
        self._wire.send(self.codes)
        return _INVALID if self._machine.state is _FAULT else status

    def enable(self) -> None:
        """Start the velocity at rest and switch the amplifiers on.

        Raises
        ------
        DeviceError
            If the wire is lost, or the arm is not DISABLED.
        """
        if self._wire.trouble:
            raise DeviceError(f"{self.name} cannot be enabled: {self._wire.trouble}")
        self._machine.command(StateCommand.ENABLE)
        self._velocity.reset(self.counts)
        self._wire.power(True)

    def disable(self) -> None:
        """No torque; amplifiers off.  A fault stays latched."""
        if self._machine.state is not OperatingState.FAULT:
            self._machine.command(StateCommand.DISABLE)
        self.codes[:] = 0
        self._wire.send(self.codes)
        self._wire.power(False)

    def pause(self) -> None:
        """Keep measuring, send no torque."""
        self._machine.command(StateCommand.PAUSE)

    def resume(self) -> None:
        """From PAUSED back to ENABLED."""
        self._machine.command(StateCommand.RESUME)

    def fault(self) -> None:
        """Latch FAULT: no torque until cleared."""
        self._machine.command(StateCommand.FAULT)

    def close(self) -> None:
        """Disable and release the wire."""
        self.disable()
        self._wire.close()


#: What the registry looks for.
Config = PremiumConfig
open_device = PremiumArm
