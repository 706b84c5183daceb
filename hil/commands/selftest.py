"""`hil selftest`: a rig device by device, without motor power and then, if allowed, with it."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from hil import terminal
from hil.commands.run import add_rearm, opener
from hil.errors import ConfigError, DeviceError
from hil.rig import boxes, safety
from hil.rig.config import RigConfig, load_rig
from hil.rig.open import ArmPort, Rig, open_rig
from hil.runtime import guard
from hil.runtime.clock import Clock
from hil.runtime.guard import Watchdog, guarded_session
from hil.runtime.runner import CLOCKS, unwinding_signals
from hil.runtime.watchdog import report_in_words
from hil.signals.device import Device, FloatArray, Status

# Device by device: first without motor power, then every motor at a small torque.
#
# A pulse of torque one way and one the other way: the difference of the two changes of speed is
# the motor's alone, whatever gravity and a supporting hand do to both.

#: Torques that may be asked for [N m].
_SMALLEST, _LARGEST, _USUAL = 0.02, 0.2, 0.1
#: Ticks of a pulse, of the rest before it, and of watching without power.
_PULSE, _REST, _WATCH = 25, 100, 500
#: Least change of speed [rad/s]; largest rest of counts and of force [N] without power.
_MOVES, _STILL_COUNTS, _STILL_FORCE = 0.03, 4, 1.0
#: Share of a pulse by which what a device says it sends may miss what it was asked.
AGREES = 0.1
#: Largest change of speed by a pulse, by its torque [rad/s/(N m)]: PHANTOMs have 1 to 12.
WILD = 30.0
#: Why arms of a URDF get no pulses.
UNDRIVEN = (
    "not driven: pulses are for arms that balance themselves; between pulses nothing would hold "
    "the weight of this arm. Hold a posture with 'hil run RIG.toml --seconds 5' instead, one hand "
    "at the emergency stop"
)
#: Largest rest of drives that measure finer than an encoder [rad or m].
_STILL = 1e-3


@dataclass(frozen=True)
class TestStep:
    """Outcome of one step.

    Parameters
    ----------
    device, what : str
        What was tested.
    passed : bool
        Whether it is as it should be.
    text : str
        What was seen, and what to do if it is not.
    """

    device: str
    what: str
    passed: bool
    text: str


def selftest(
    config: RigConfig,
    torque: float,
    allowed: Callable[[], bool],
    opener: Callable[[RigConfig, int], Rig] = open_rig,
    source: str = "RIG.toml",
    rearm: bool = False,
) -> Iterator[TestStep]:
    """Test a rig; nothing but zero goes to a motor before `allowed` has returned True.

    Parameters
    ----------
    config : RigConfig
        The rig.
    torque : float
        Of a pulse [N m].
    allowed : callable
        Asks the user whether the motors may be driven.
    opener : callable
        Opens the rig.
    source, rearm : str, bool
        As of `hil.runtime.runner.run_session`.

    Yields
    ------
    Step
        One after the other; the motors' only if all before have passed.  Last the cut: the
        self-test stops ticking with the watchdog beside it, and its program runs.

    Raises
    ------
    ConfigError
        If the torque is not a small one, or the cut program cannot be run or was not agreed to.
    DeviceError
        If the rig cannot be opened, or a box or the watchdog is lost on the way.
    """
    if not _SMALLEST <= torque <= _LARGEST:
        raise ConfigError(f"--torque {torque:g}: {_SMALLEST} to {_LARGEST} N m is needed.")
    passed, found = True, guard.watchdog_state(config.safety, source, rearm)
    if found is not None:
        passed, text = found
        yield TestStep("watchdog", "program", passed, text)
    # a simulated operator keeps off, as the user is told to; arms of a URDF have none
    if not any(arm.own for arm in config.arms.values()):
        config = replace(config, simulation={**config.simulation, "operator": {}})
    rig = opener(config, 0)
    try:
        bench = _Bench(rig, config)
        for name, box in rig.boxes.items():
            yield TestStep(name, "box", True, boxes.describe_box(box))
        for step in bench.without_power():
            passed &= step.passed
            yield step
        if not passed:
            return
        own = [name for name, arm in config.arms.items() if arm.own]
        if own:
            yield TestStep(", ".join(own), "motors", True, UNDRIVEN)
            return
        if allowed():
            with (
                tempfile.TemporaryDirectory() as folder,
                guarded_session(config.safety, Path(folder, "selftest"), source, rearm) as watchdog,
            ):
                bench.watchdog = watchdog
                yield from bench.with_power(torque)
                if watchdog is not None:
                    yield from bench.cut(watchdog, torque)
    finally:
        rig.close()


class _Bench:
    """An open rig that is stepped without a controller."""

    def __init__(self, rig: Rig, config: RigConfig) -> None:
        self.rig, self.config = rig, config
        self.period_ns = config.loop.period_ns
        self.clock: Clock = CLOCKS[config.clock](self.period_ns)
        self.clock.start()
        self.tick = 0
        self.watchdog: Watchdog | None = None
        self.arms = dict(zip(config.controller.arms, rig.ports, strict=True))
        n = len(self.arms)
        self.d = d = len(config.arms[config.controller.arms[0]].joints)
        self.q, self.qd = np.zeros((n, d)), np.zeros((n, d))
        self.wrench, self.zero, self.sent = np.zeros((n, 6)), np.zeros(d), np.zeros(d)

    def step(self, driven: ArmPort | None = None, effort: FloatArray | None = None) -> Status:
        """One tick: read everything, drive one arm."""
        self.tick = self.clock.wait(self.tick + 1)
        found = 0 if self.watchdog is None else self.watchdog.beat(self.tick)
        if found:
            raise DeviceError(f"the self-test was stopped: {safety.sentence(found)}")
        t_ns = self.tick * self.period_ns + self.rig.origin_ns
        status = Status.OK
        for i, port in enumerate(self.arms.values()):
            status = max(status, port.joints.measured_js(t_ns, self.q[i], self.qd[i]))
            if port.force is not None:
                status = max(status, port.force.measured_cf(t_ns, self.q[i], self.wrench[i]))
            wanted = self.zero if port is not driven or effort is None else effort.copy()
            safe = safety.limit(wanted, self.qd[i], port.torque_limit, port.speed_limit)
            status = max(status, Status(safe), port.efforts.servo_jf(wanted, self.sent))
            if port is driven and status < Status.INVALID:
                self._compare(i, wanted)
        return status

    def _compare(self, i: int, wanted: FloatArray) -> None:
        """Stop where the device of arm i sends something else than it was asked."""
        most = AGREES * max(float(np.abs(wanted).max()), _SMALLEST)
        wrong = np.flatnonzero(~(np.abs(self.sent - wanted) <= most))
        if wrong.size:
            k, arm = int(wrong[0]), list(self.arms)[i]
            raise DeviceError(
                f"the self-test was stopped: of arm {arm!r}, joint {k + 1}, {wanted[k]:g} N m was "
                f"asked, and its device sends {self.sent[k]:.3g} N m; compare the options of its "
                "table in [devices] with the drive train: reductions, gains and limits."
            )

    def without_power(self) -> Iterator[TestStep]:
        """Everything is read for a while; nothing may move or be pressed."""
        counts, force, worst = [], [], Status.OK
        for _ in range(_WATCH):
            worst = max(worst, self.step())
            counts.append(np.stack([p.counts for p in self.arms.values()]))
            force.append(self.wrench[:, :3].copy())
        if worst >= Status.STALE:
            why = self.rig.trouble() or f"the worst status was {worst.name}"
            yield TestStep("rig", "reading", False, f"{why}; run 'hil devices RIG.toml'")
            return
        moved, noise = np.ptp(counts, axis=0), np.std(force, axis=0)
        for i, (arm, port) in enumerate(self.arms.items()):
            most, scales = int(moved[i].max()), getattr(port.joints, "scales", None)
            fine = 0.0 if scales is None else _STILL / scales[:, 0]
            still = bool(np.all(moved[i] <= np.maximum(_STILL_COUNTS, fine)))
            text = f"counts moved by {most} at rest"
            if scales is not None:  # counts of such drives are too fine to say how far
                angle = float(np.max(moved[i] * scales[:, 0]))
                text += f": {angle:.1g} rad or m, where up to {_STILL:g} is at rest"
            if not still:
                text += "; rest the arm in its dock and keep off it, or look for bad cables"
            yield TestStep(arm, "encoders", still, text)
            if port.force is not None:
                most_n = float(noise[i].max())
                text = f"force has a noise of {most_n:.2g} N"
                if most_n > _STILL_FORCE:
                    text += "; keep off the sensor, and look at its cable"
                yield TestStep(arm, "force", most_n <= _STILL_FORCE, text)

    def with_power(self, torque: float) -> Iterator[TestStep]:
        """Every joint of every arm, one at a time, both ways."""
        for i, (arm, port) in enumerate(self.arms.items()):
            devices = self._of(arm)
            for k in range(self.d):
                yield _judge(arm, k, self._both_ways(i, port, devices, k, torque), torque)

    def cut(self, watchdog: Watchdog, torque: float) -> Iterator[TestStep]:
        """Stop ticking until the watchdog has cut; on hardware no motor may move from then on.

        A simulated rig has no power that a program could cut: there only the program is judged.
        """
        self.watchdog, until = None, time.monotonic() + guard.CUTTING
        while watchdog.alive and time.monotonic() < until:
            self.step()
        trip = watchdog.proved()
        text = report_in_words(trip) if trip else "it did not act when the loop stopped"
        yield TestStep("watchdog", "cut", bool(trip.get("worked")), text)
        if not (self.config.hardware and trip.get("worked")):
            return
        for i, (arm, port) in enumerate(self.arms.items()):
            most = max(
                np.abs(self._both_ways(i, port, self._of(arm), k, torque)).max()
                for k in range(self.d)
            )
            text = f"{torque:g} N m after the cut changed a speed by {most:.2f} rad/s"
            if most >= _MOVES:
                text += ": the motors still have power; look at what the cut program switches"
            yield TestStep(arm, "cut", most < _MOVES, text)

    def _of(self, arm: str) -> list[Device]:
        """Devices of an arm."""
        return [d for name, d in self.rig.devices.items() if self.config.devices[name].arm == arm]

    def _both_ways(
        self, i: int, port: ArmPort, devices: list[Device], k: int, torque: float
    ) -> FloatArray:
        """Change of speed (d,) [rad/s] by torque on joint k, free of what acts both ways alike."""
        change = np.zeros(self.d)
        for sign in (1.0, -1.0):
            effort = np.zeros(self.d)
            effort[k] = sign * torque
            change += 0.5 * sign * self._pulse(i, port, devices, effort)
        return change

    def _pulse(
        self, i: int, port: ArmPort, devices: list[Device], effort: FloatArray
    ) -> FloatArray:
        """Change of speed (d,) [rad/s] by a pulse; no power before and after."""
        worst = max(self.step() for _ in range(_REST))
        for device in devices:
            device.enable()
        before = self.qd[i].copy()
        for _ in range(_PULSE):
            worst = max(worst, self.step(port, effort))
        change = self.qd[i] - before
        for device in devices:
            device.disable()
        if worst is Status.INVALID:
            why = self.rig.trouble() or "an arm was faster than its speed_limit"
            raise DeviceError(f"the self-test was stopped: {why}")
        return np.asarray(change)


def _judge(arm: str, k: int, change: FloatArray, torque: float) -> TestStep:
    """Whether joint k, and it above all, went the way that it was pushed."""
    name, seen = f"joint {k + 1}", f"{torque:g} N m changed its speed by {change[k]:+.2f} rad/s"
    largest = int(np.argmax(np.abs(change)))
    if abs(change[largest]) < _MOVES:
        text = f"{seen}: it does not move; is the amplifier on, and its watchdog fed?"
    elif largest != k:
        text = f"{seen}, and that of joint {largest + 1} by more: look at the channel map"
    elif change[k] < 0:
        text = f"{seen}: turn the sign of its place in channels.motors or channels.encoders"
    elif change[k] > WILD * torque:
        text = (
            f"{seen}, above {WILD * torque:g} rad/s: the motor gives more torque than it is asked, "
            "or the encoder counts more; compare the gains of its amplifier and its reduction with "
            "the options of the device"
        )
    else:
        return TestStep(arm, name, True, seen)
    return TestStep(arm, name, False, text)


EXAMPLE = "hil selftest teleop --torque 0.1"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("rig", metavar="RIG.toml", help="rig file")
    parser.add_argument(
        "--torque", type=float, default=_USUAL, help=f"torque of a pulse [N m] (default {_USUAL})"
    )
    parser.add_argument("--no-motors", action="store_true", help="stop before the motors")
    add_rearm(parser)
    parser.add_argument("--json", action="store_true", help="steps as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Run the steps; 0 if all of them passed, 2 if the motors were asked for and not allowed."""
    config = load_rig(args.rig)
    steps, answers = [], []

    def allowed() -> bool:
        answers.append(args.no_motors or _confirmed(config, args))
        return answers[-1] and not args.no_motors

    with unwinding_signals():
        steps_of = selftest(config, args.torque, allowed, opener(args.rig), args.rig, args.rearm)
        for step in steps_of:
            steps.append(step)
            if not args.json:
                mark = "ok  " if step.passed else "FAIL"
                terminal.out(f"{mark}  {step.device:<16} {step.what:<10} {step.text}")
    if args.json:
        rows = [asdict(step) for step in steps]
        terminal.out(json.dumps({"schema": "hil.runtime.selftest/1", "steps": rows}))
    if not all(step.passed for step in steps):
        return 3
    return 0 if all(answers) else 2


def _confirmed(config: RigConfig, args: argparse.Namespace) -> bool:
    """Whether the user has typed the name of the rig."""
    sys.stderr.write(
        f"\nNow every motor of {', '.join(config.controller.arms)} gets pulses of "
        f"{args.torque:g} N m, one joint at a time.\nRest the arms in their docks, keep clear, one "
        "hand at the emergency stop.\n"
        f"Type the name of the rig, {config.name}, to continue. Anything else ends the test: "
    )
    sys.stderr.flush()
    line = ""
    try:
        line = sys.stdin.readline()
    finally:
        # a terminal has ended the line itself, unless the input ended or was interrupted
        if not (line.endswith("\n") and sys.stdin.isatty()):
            sys.stderr.write("\n")
    if line.strip() == config.name:
        return True
    said = f"{line.strip()!r} is not the name of the rig" if line else "the input ended"
    sys.stderr.write(
        f"hil selftest: {said}; the motors stay off and were not tested. Type {config.name} when "
        "asked, or give --no-motors to test the rest alone\n"
    )
    return False
