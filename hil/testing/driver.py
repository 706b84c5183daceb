"""Check that a driver keeps the contract which the loop, the safety and the user rely on.

A device under test has a far end, which is moved, loaded, broken and read, and passes one period as
the loop does it.  Every rule is one function of a table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from hil.errors import DeviceError
from hil.signals.device import (
    Device,
    FloatArray,
    MeasuredCf,
    MeasuredJs,
    OperatingState,
    ServoJf,
    Status,
    Tareable,
)
from hil.testing.effects import ConformanceError


@dataclass(frozen=True)
class Tolerance:
    """How near a driver must come to the truth of the far end.

    Parameters
    ----------
    position, velocity, force, torque, effort : float
        [rad], [rad/s], [N], [N m], [N m].
    """

    position: float = 2e-3
    velocity: float = 0.05
    force: float = 0.05
    torque: float = 0.01
    effort: float = 2e-3


class FarEnd:
    """Truth behind a wire.  Derive from it and write the methods that your simulation can do.

    What a class does not write is not checked, and `check_driver` says so.

    Attributes
    ----------
    joints : int
        Joints of the arm.
    pose : ndarray (joints,)
        Where the joints stand at the start, and while a force is measured [rad].
    axes : int
        Components of the wrench that `press` can apply: 3 without torques, or 6.
    """

    joints: int = 3
    axes: int = 6

    @property
    def now_ns(self) -> int:
        """Time [ns] from which the check goes on after the device was opened."""
        return 0

    def __init__(self) -> None:
        self.pose: FloatArray = np.zeros(self.joints)

    def advance(self, t_ns: int) -> None:
        """Let the far end run to `t_ns`; not needed where the device's wire does so itself."""

    def place(self, position: FloatArray) -> None:
        """The joints stand at `position` (joints,) [rad] from the next `advance` on."""
        raise NotImplementedError

    def press(self, wrench: FloatArray) -> None:
        """Force [N] and torque [N m] (6,) ON the robot, base frame, from now on."""
        raise NotImplementedError

    def effort(self) -> FloatArray:
        """Efforts (joints,) [N m] that the motors now get."""
        raise NotImplementedError

    def unplug(self) -> None:
        """Pull the device off its bus, or cut its supply."""
        raise NotImplementedError

    def replug(self) -> None:
        """Attach it again, as after a power-up."""
        raise NotImplementedError

    def mute(self, on: bool) -> None:
        """While on, the device takes requests and answers none."""
        raise NotImplementedError

    def garble(self) -> None:
        """Spoil the next answer: wrong length, wrong code, wrong order, flipped bits."""
        raise NotImplementedError

    @classmethod
    def can(cls, method: str) -> bool:
        """Whether a class has written `method`."""
        return getattr(cls, method) is not getattr(FarEnd, method)


#: Within this time a lost or silent device must be noticed [s].
NOTICED = 0.2


class DriverBench:
    """A device under test with its time."""

    def __init__(
        self,
        again: Callable[[], Device],
        far: FarEnd,
        period: float,
        settle: float,
        tolerance: Tolerance,
    ) -> None:
        self.device, self.again, self.far, self.tol = again(), again, far, tolerance
        self.step_ns, self.period = round(period * 1e9), period
        self.settle = max(1, round(settle / period))
        self.t_ns = far.now_ns
        self.q, self.qd = np.zeros(far.joints), np.zeros(far.joints)
        self.wrench, self.sent = np.zeros(6), np.zeros(far.joints)
        self.effort = np.zeros(far.joints)
        if isinstance(self.device, Tareable):
            self.t_ns = self.device.tare(self.t_ns)

    def require(self, held: bool, text: str) -> None:
        """Raise with the name of the device where a rule is broken."""
        if not held:
            raise ConformanceError(f"device {self.device.name!r}: {text}")

    def tick(self, effort: FloatArray | None = None) -> Status:
        """One period as the loop does it; the worst status."""
        self.t_ns += self.step_ns
        self.far.advance(self.t_ns)
        status, device = Status.OK, self.device
        try:
            if isinstance(device, MeasuredJs):
                status = max(status, device.measured_js(self.t_ns, self.q, self.qd))
            if isinstance(device, MeasuredCf):
                at = self.q if isinstance(device, MeasuredJs) else self.far.pose
                status = max(status, device.measured_cf(self.t_ns, at, self.wrench))
            if isinstance(device, ServoJf):
                self.effort[:] = 0.0 if effort is None else effort
                status = max(status, device.servo_jf(self.effort, self.sent))
        except Exception as error:
            raise ConformanceError(
                f"device {device.name!r}: a call of the fast path raised {error!r}; it must "
                "answer with a Status"
            ) from error
        self.require(isinstance(status, Status), f"returned {status!r}, expected a Status")
        return status

    def ticks(self, n: int, effort: FloatArray | None = None) -> Status:
        """Worst status of some ticks."""
        return max(self.tick(effort) for _ in range(n))

    def reopen(self) -> None:
        """Open the device anew, after which the far end's time holds if it is later."""
        self.device = self.again()
        self.t_ns = max(self.t_ns, self.far.now_ns)

    def enable(self) -> None:
        """Enable, after some ticks in which the driver may fill its windows."""
        self.ticks(self.settle)
        self.device.enable()
        self.ticks(self.settle)

    def notices(self) -> Status:
        """Run until a trouble shows in the status, at most `NOTICED`."""
        for _ in range(round(NOTICED / self.period)):
            status = self.tick()
            if status >= Status.STALE:
                return status
        return Status.OK


#: Efforts [N m] that every motor can give.
TEST_EFFORT = 0.02


def _states(b: DriverBench) -> None:
    device = b.device
    b.require(bool(device.name), "has no name")
    b.require(device.state is OperatingState.DISABLED, f"opens {device.state!r}, not DISABLED")
    b.enable()
    b.require(device.state is OperatingState.ENABLED, "is not ENABLED after enable()")
    _refused(b, "a second enable()")
    device.disable()
    device.disable()
    b.require(device.state is OperatingState.DISABLED, "is not DISABLED after disable()")
    device.enable()
    if isinstance(device, ServoJf):
        device.fault()
        b.require(device.state is OperatingState.FAULT, "is not in FAULT after fault()")
        _refused(b, "enable() in FAULT")
    device.close()
    b.require(device.state is not OperatingState.ENABLED, "is ENABLED after close()")
    device.close()


def _refused(b: DriverBench, what: str) -> None:
    try:
        b.device.enable()
    except DeviceError as error:
        b.require(b.device.name in str(error), f"{what}: the message does not name the device")
        return
    b.require(False, f"{what} was not refused with a DeviceError")


def _position(b: DriverBench) -> None:
    goal = b.far.pose.copy()
    b.enable()
    speed = 0.5 * np.array([1.0, -0.6, 0.8, -1.0, 0.7, 0.5])[: b.far.joints]
    for _ in range(round(0.4 / b.period)):
        goal += speed * b.period
        b.far.place(goal)
        b.require(b.tick() is Status.OK, "a steady motion is not measured with status OK")
    lag = np.abs(speed) * 3 * b.period
    off = np.abs(b.q - goal) - lag
    b.require(float(off.max()) < b.tol.position, f"moving: measured {b.q}, true {goal} rad")
    near = float(np.abs(b.qd - speed).max())
    b.require(near < b.tol.velocity, f"speed: measured {b.qd}, true {speed} rad/s")
    b.ticks(b.settle)
    off = np.abs(b.q - goal)
    b.require(float(off.max()) < b.tol.position, f"at rest: measured {b.q}, true {goal} rad")


def _force(b: DriverBench) -> None:
    b.enable()
    for k in range(b.far.axes):
        wrench = np.zeros(6)
        wrench[k] = 1.5 if k < 3 else 0.02
        b.far.press(wrench)
        b.ticks(b.settle)
        off = np.abs(b.wrench - wrench)
        text = f"wrench: measured {b.wrench}, true {wrench} (N, N m; ON the robot, base frame)"
        b.require(float(off[:3].max()) < b.tol.force, text)
        b.require(float(off[3:].max()) < b.tol.torque, text)
        b.far.press(np.zeros(6))
    b.ticks(b.settle)


def _effort(b: DriverBench) -> None:
    push = TEST_EFFORT * np.array([1.0, -0.5, 0.8, -1.0, 0.6, 0.5])[: b.far.joints]
    b.ticks(b.settle, push)
    b.require(not b.far.effort().any(), "gives an effort before enable()")
    b.enable()
    status = b.ticks(b.settle, push)
    b.require(status is Status.OK, f"answers {status!r} to a small effort, expected OK")
    _same(b, b.sent, push, "says that it sent")
    _same(b, b.far.effort(), push, "sends")
    status = b.tick(np.full(b.far.joints, 1e6))
    b.require(status is Status.CLAMPED, f"answers {status!r} to 1e6 N m, expected CLAMPED")
    b.require(float(np.abs(b.sent).max()) < 1e5, "does not clamp")
    push[0] = np.nan
    status = b.tick(push)
    b.require(status is Status.INVALID, f"answers {status!r} to an effort that is not a number")
    b.require(b.device.state is OperatingState.FAULT, "is not in FAULT after such an effort")
    status = b.ticks(b.settle, np.full(b.far.joints, TEST_EFFORT))
    b.require(status is Status.INVALID, f"answers {status!r} to an effort in FAULT")
    b.require(not b.far.effort().any(), "gives an effort in FAULT")


def _same(b: DriverBench, value: FloatArray, true: FloatArray, what: str) -> None:
    near = float(np.abs(value - true).max()) < b.tol.effort
    b.require(near, f"{what} {value}, asked for {true} N m")


def _zero_on_exit(b: DriverBench) -> None:
    push = np.full(b.far.joints, TEST_EFFORT)
    for leave in ("disable", "close", "fault"):
        b.enable()
        b.ticks(b.settle, push)
        b.require(bool(b.far.effort().all()), "gives no effort when enabled")
        getattr(b.device, leave)()
        if leave == "fault":
            b.ticks(b.settle, push)
        b.require(not b.far.effort().any(), f"still gives {b.far.effort()} N m after {leave}()")
        b.device.close()
        b.reopen()
    b.device.close()


def _unplug(b: DriverBench) -> None:
    b.enable()
    b.far.unplug()
    try:
        b.require(b.notices() >= Status.STALE, f"does not notice in {NOTICED} s that it is gone")
        b.ticks(b.settle)
        b.require(b.device.state is OperatingState.FAULT, "is not in FAULT when it is gone")
        b.device.close()
        try:
            b.again().close()
        except DeviceError as error:
            b.require(len(str(error)) > 20, f"refuses to open with {str(error)!r} alone")
        else:
            b.require(False, "opens while it is unplugged")
    finally:
        b.far.replug()
    b.reopen()
    b.enable()
    b.require(b.tick() <= Status.CLAMPED, "does not work after it was plugged in again")
    b.device.close()


def _mute(b: DriverBench) -> None:
    b.enable()
    b.far.mute(True)
    noticed = b.notices()
    b.far.mute(False)
    b.require(noticed >= Status.STALE, f"does not notice in {NOTICED} s that no answer comes")


def _garble(b: DriverBench) -> None:
    b.enable()
    if b.far.can("place"):  # away from zero, where nothing shows
        goal = b.far.pose.copy()
        for _ in range(b.settle):
            goal += 1e-3 * (1 + np.arange(b.far.joints))
            b.far.place(goal)
            b.tick()
    b.ticks(b.settle)
    for _ in range(20):
        b.far.garble()
        before = b.q.copy(), b.wrench.copy()
        status = b.tick()
        if b.device.state is OperatingState.FAULT:
            return
        jump = float(np.abs(b.q - before[0]).max()) > b.tol.position
        jump |= float(np.abs(b.wrench - before[1])[:3].max()) > b.tol.force
        b.require(not jump or status >= Status.STALE, "hands on a spoilt answer with status OK")
        b.ticks(3)


_ANY: tuple[type, ...] = (MeasuredJs, MeasuredCf, ServoJf)
_Check = Callable[[DriverBench], None]
#: name -> what the far end must be able to do, which capabilities it is about, the check.
CHECKS: dict[str, tuple[tuple[str, ...], tuple[type, ...], _Check]] = {
    "states": ((), _ANY, _states),
    "position": (("place",), (MeasuredJs,), _position),
    "force": (("press",), (MeasuredCf,), _force),
    "effort": (("effort",), (ServoJf,), _effort),
    "zero on exit": (("effort",), (ServoJf,), _zero_on_exit),
    "unplug": (("unplug", "replug"), _ANY, _unplug),
    "time-out": (("mute",), _ANY, _mute),
    "bad frames": (("garble",), _ANY, _garble),
}


__all__ = ["Checked", "FarEnd", "Tolerance", "check_driver"]


@dataclass
class Checked:
    """What was checked, and what was not because the far end cannot do it.

    Parameters
    ----------
    done, skipped : list of str
        Names of checks.
    """

    done: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)


def check_driver(
    open_device: Callable[[], Device],
    far: FarEnd,
    *,
    period: float = 1e-3,
    settle: float = 0.05,
    tolerance: Tolerance | None = None,
) -> Checked:
    """Check states, time-outs, unplugging, bad frames, units, signs and zero on exit.

    Parameters
    ----------
    open_device : callable
        Opens the driver on the far end; called anew for every check.
    far : FarEnd
        The other side of the wire.
    period, settle : float
        Time between ticks; time after which the far end has what was sent, and the driver what
        was measured [s].
    tolerance : Tolerance, optional
        How near is near.

    Returns
    -------
    Checked
        What was checked, and what the far end could not do.

    Raises
    ------
    ConformanceError
        With a sentence that says what is wrong and what was expected.
    """
    checked = Checked()
    for name, (needs, kinds, check) in CHECKS.items():
        missing = [m for m in needs if not far.can(m)]
        bench = DriverBench(open_device, far, period, settle, tolerance or Tolerance())
        try:
            applies = any(isinstance(bench.device, kind) for kind in kinds)
            if applies and not missing:
                check(bench)
        finally:
            bench.device.close()
        if applies:
            (checked.skipped if missing else checked.done).append(name)
    if not checked.done:
        raise ConformanceError("the driver measures nothing and moves nothing: see hil.signals")
    return checked
