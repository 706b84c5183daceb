"""What is checked of a driver, one rule a function, and the table of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.errors import DeviceError
from hil.signals.device import FloatArray, MeasuredCf, MeasuredJs, ServoJf, Status
from hil.signals.state import OperatingState
from hil.testing.bench import NOTICED, Bench

#: Efforts [N m] that every motor can give.
PUSH = 0.02


def _states(b: Bench) -> None:
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


def _refused(b: Bench, what: str) -> None:
    try:
        b.device.enable()
    except DeviceError as error:
        b.require(b.device.name in str(error), f"{what}: the message does not name the device")
        return
    b.require(False, f"{what} was not refused with a DeviceError")


def _position(b: Bench) -> None:
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


def _force(b: Bench) -> None:
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


def _effort(b: Bench) -> None:
    push = PUSH * np.array([1.0, -0.5, 0.8, -1.0, 0.6, 0.5])[: b.far.joints]
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
    status = b.ticks(b.settle, np.full(b.far.joints, PUSH))
    b.require(status is Status.INVALID, f"answers {status!r} to an effort in FAULT")
    b.require(not b.far.effort().any(), "gives an effort in FAULT")


def _same(b: Bench, value: FloatArray, true: FloatArray, what: str) -> None:
    near = float(np.abs(value - true).max()) < b.tol.effort
    b.require(near, f"{what} {value}, asked for {true} N m")


def _zero_on_exit(b: Bench) -> None:
    push = np.full(b.far.joints, PUSH)
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


def _unplug(b: Bench) -> None:
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


def _mute(b: Bench) -> None:
    b.enable()
    b.far.mute(True)
    noticed = b.notices()
    b.far.mute(False)
    b.require(noticed >= Status.STALE, f"does not notice in {NOTICED} s that no answer comes")


def _garble(b: Bench) -> None:
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
_Check = Callable[[Bench], None]
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
