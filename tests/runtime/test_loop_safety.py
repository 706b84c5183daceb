"""Conditions of the loop: what is wrong leads to a defined state, and the motors get zero."""

import contextlib
import json
import mmap
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.errors import DeviceError
from hil.record.recording import RobotSource
from hil.rig import safety
from hil.rig.check import limits_of_arm
from hil.rig.config import ArmConfig, SafetyConfig, load_rig
from hil.rig.open import ArmPort
from hil.rig.safety import (
    BITS,
    FAULTING,
    LOOKED_BACK,
    PAUSING,
    TABLE,
    alternates,
    named_conditions,
    safety_limits,
    sentence,
    violations,
)
from hil.runtime.board import Ring
from hil.runtime.clock import VirtualClock
from hil.runtime.commands import OperatorCommand
from hil.runtime.loop import Loop, Overload
from hil.runtime.runner import run_session
from hil.signals.device import OperatingState as State
from hil.signals.device import Status
from hil.signals.frame import FrameLayout

RIG = Path(__file__).parents[2] / "rigs" / "teleop.toml"
DT_NS = 1_000_000
MIDDLE = np.array([0.0, 0.4, 0.3])


class Arm:
    """An arm whose every answer the test chooses."""

    def __init__(self):
        self.q, self.qd, self.wrench = MIDDLE.copy(), np.zeros(3), np.zeros(6)
        self.js = self.cf = self.jf = Status.OK
        self.codes, self.counts, self.gauges = (np.zeros(n, np.int64) for n in (3, 3, 6))
        self.faults, self.gain = 0, 1.0
        self.out = np.full(3, np.nan)

    def measured_js(self, t_ns, position, velocity):
        position[:], velocity[:] = self.q, self.qd
        return self.js

    def measured_cf(self, t_ns, position, wrench):
        wrench[:] = self.wrench
        return self.cf

    def servo_jf(self, effort, sent):
        sent[:] = self.gain * effort
        self.out[:] = effort
        return self.jf

    def fault(self):
        self.faults += 1


class Push:
    """A law that always pushes the same way."""

    state_names = ("count",)

    def __init__(self, effort=0.1):
        self.effort = effort

    def update(self, t, x, u, x_next, y):
        x_next[0] = x[0] + 1
        y[:] = self.effort


@pytest.fixture
def bench():
    return Bench()


class Bench:
    def __init__(self, effort=0.1, arm=None, safety=None, tip=None, box=None):
        self.arm = Arm()
        config, safety = arm or ArmConfig(), safety or SafetyConfig()
        robot = limits_of_arm(config, RobotSource(config.robot))
        port = ArmPort(
            self.arm,
            self.arm,
            self.arm,
            self.arm.counts,
            self.arm.codes,
            self.arm.gauges,
            np.array(config.torque_limit),
            np.array(config.speed_limit),
            safety_limits(config, robot, safety, 12.0),
            tip,
            box,
        )
        self.limits = port.limits
        self.ring = Ring(5000, FrameLayout(1, 1).width)
        self.clock = VirtualClock(DT_NS)
        self.loop = Loop(
            [port],
            Push(effort),
            self.clock,
            self.ring,
            FrameLayout(1, 1),
            DT_NS,
            0,
            safety.missed_limit,
        )
        self.loop.begin()
        self.run(10)

    def run(self, n=1):
        for _ in range(n):
            self.loop.step()
        return self.loop.machine.state

    def names(self):
        return {c.name for c in named_conditions(self.loop.conditions)}


def js(arm, status):
    arm.js = status


#: How to make a condition, the condition, the state that follows, ticks that it may take.
CASES = {
    "encoders repeat": (lambda a: setattr(a, "js", Status.STALE), "joint-stale", State.PAUSED, 2),
    "force repeats": (lambda a: setattr(a, "cf", Status.STALE), "force-stale", State.PAUSED, 2),
    "force saturated": (
        lambda a: setattr(a, "cf", Status.CLAMPED),
        "force-saturated",
        State.PAUSED,
        1,
    ),
    "force above red": (lambda a: a.wrench.__setitem__(2, 11.0), "force-red", State.PAUSED, 1),
    "encoders lost": (lambda a: setattr(a, "js", Status.INVALID), "joint-lost", State.FAULT, 1),
    "force lost": (lambda a: setattr(a, "cf", Status.INVALID), "force-lost", State.FAULT, 1),
    "encoder jumps far": (lambda a: a.q.__iadd__(0.3), "encoder-jump", State.FAULT, 1),
    "encoder jumps by a little": (lambda a: a.q.__iadd__(0.007), "encoder-jump", State.FAULT, 1),
    "position not a number": (lambda a: a.q.fill(np.nan), "not-a-number", State.FAULT, 1),
    "force not a number": (lambda a: a.wrench.fill(np.nan), "not-a-number", State.FAULT, 1),
    "too fast": (lambda a: a.qd.__setitem__(1, -26.0), "overspeed", State.FAULT, 1),
    "driver refuses": (lambda a: setattr(a, "jf", Status.INVALID), "motor-refused", State.FAULT, 1),
}


@pytest.mark.parametrize("case", CASES)
def test_every_condition_leads_to_its_state_in_time_with_the_motors_at_zero(bench, case):
    make, condition, state, ticks = CASES[case]
    assert bench.run() is State.ENABLED and (bench.arm.out == 0.1).all()
    make(bench.arm)
    for _ in range(ticks - 1):
        assert bench.run() is State.ENABLED
    assert bench.run() is state
    assert condition in bench.names()
    assert (bench.arm.out == 0.0).all()
    assert bool(bench.arm.faults) == (state is State.FAULT)
    stamps, rows = bench.ring.take()
    timing = rows[-1, FrameLayout(1, 1).part("timing")]
    assert (timing[5], int(timing[6]) & BITS[condition]) == (state, BITS[condition])
    assert stamps[-1, 0] == bench.loop.tick


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_law_that_is_not_a_number_faults_before_anything_goes_out(bad):
    bench = Bench(effort=bad)
    assert bench.loop.machine.state is State.FAULT
    assert sentence(bench.loop.reason) == "an effort of the law was not a number"
    assert (bench.arm.out == 0.0).all()


def test_one_late_sample_is_only_noted(bench):
    bench.arm.js = Status.STALE
    assert bench.run() is State.ENABLED and bench.names() == {"sensor-late"}
    bench.arm.js = Status.OK
    # what follows may be the motion of two periods, at any allowed speed
    bench.arm.q[:] += 0.02
    bench.arm.qd[:] = 10.0
    assert bench.run() is State.ENABLED and bench.names() == set()


def test_a_fast_motion_is_not_a_jump(bench):
    # 24 rad/s reached at 600 rad/s^2, in steps of an encoder
    v = 0.0
    for _ in range(40):
        v = min(24.0, v + 0.6)
        bench.arm.q[0] += np.round(v * 1e-3 * 8670) / 8670 if abs(bench.arm.q[0]) < 1.4 else 0.0
        bench.arm.qd[0] = v
        if bench.arm.q[0] > 1.4:
            break
        assert bench.run() is State.ENABLED


def test_a_stuck_encoder_under_torque_is_found():
    bench = Bench(effort=0.5)
    assert bench.run(230) is State.ENABLED
    assert bench.run(25) is State.FAULT
    assert sentence(bench.loop.reason) == "an encoder stands still under torque"
    # the same without torque, or moving by a count, is none
    still, moving = Bench(effort=0.1), Bench(effort=0.5)
    assert still.run(400) is State.ENABLED
    for k in range(400):
        moving.arm.q[:] = MIDDLE + 1.2e-4 * (k % 2)
        assert moving.run() is State.ENABLED


def test_leaving_the_range_pauses_once_and_the_way_back_is_open(bench):
    slow = np.linspace(0.4, -2.2, 2000)
    for q in slow:
        bench.arm.q[1] = q
        bench.run()
    assert bench.loop.machine.state is State.PAUSED and "position" in bench.names()
    bench.loop.mailbox.append(OperatorCommand("resume", lambda loop: loop.begin()))
    assert bench.run(5) is State.ENABLED and "position" in bench.names()


RESUME = OperatorCommand("resume", lambda loop: loop.begin())


def _outside(bench, joint, past=0.02):
    """A joint drifts out of its range, which pauses, and the operator resumes."""
    end = float(limits_of_arm(ArmConfig(), RobotSource(ArmConfig().robot)).high[joint])
    for q in np.linspace(bench.arm.q[joint], end + past, 2000):
        bench.arm.q[joint] = q
        bench.run()
    assert bench.loop.machine.state is State.PAUSED
    bench.loop.mailbox.append(RESUME)
    assert bench.run() is State.ENABLED
    return end


@pytest.mark.parametrize(("step", "state"), [(0.39, State.ENABLED), (0.41, State.PAUSED)])
def test_who_was_outside_at_a_resume_gets_no_further(bench, step, state):
    end = _outside(bench, 0)
    for q in np.linspace(end + 0.02, end + 0.02 + step, 1000):
        bench.arm.q[0] = q
        bench.run()
    assert bench.loop.machine.state is state


def test_back_within_its_range_a_joint_may_not_leave_it_again(bench):
    end = _outside(bench, 0)
    for q in np.linspace(end + 0.02, end - 0.01, 100):
        bench.arm.q[0] = q
        assert bench.run() is State.ENABLED
    for q in np.linspace(end - 0.01, end + 0.01, 100):
        bench.arm.q[0] = q
        bench.run()
    assert bench.loop.machine.state is State.PAUSED


def test_one_joint_that_is_outside_hides_no_other(bench):
    _outside(bench, 0)
    for q in np.linspace(0.4, -2.2, 2000):
        bench.arm.q[1] = q
        bench.run()
        if q > -0.2:
            assert bench.loop.machine.state is State.ENABLED
    assert bench.loop.machine.state is State.PAUSED
    assert any("joint2" in text for text in violations(
        bench.loop.reason, ("joint1", "joint2", "joint3"), bench.arm.q, bench.arm.qd,
        bench.limits))  # fmt: skip


@pytest.mark.parametrize(
    ("gain", "state"),
    [(1.01, State.ENABLED), (50.0, State.FAULT), (-50.0, State.FAULT), (np.nan, State.FAULT)],
)
def test_a_driver_that_sends_more_than_the_limit_faults(bench, gain, state):
    bench.arm.gain = gain
    assert bench.run() is state
    if state is State.FAULT:
        assert bench.names() == {"effort-exceeded"} and bench.arm.faults
        assert (bench.arm.out == 0.0).all()


def test_the_rounding_of_a_code_is_no_excess_at_a_small_limit():
    bench = Bench(effort=1e-3, arm=ArmConfig(torque_limit=(1e-3,) * 3))
    bench.arm.servo_jf = lambda effort, sent: sent.fill(2.5e-3) or Status.OK
    assert bench.run() is State.ENABLED
    bench.arm.servo_jf = lambda effort, sent: sent.fill(5e-3) or Status.OK
    assert bench.run() is State.FAULT


def test_no_power_goes_out_while_it_is_paused(bench):
    bench.loop.pause()
    bench.arm.servo_jf = lambda effort, sent: sent.fill(1.7) or Status.OK
    assert bench.run() is State.FAULT and "effort-exceeded" in bench.names()


def test_an_effort_that_is_no_number_heats_the_winding_as_the_limit_does():
    arm = ArmConfig(winding=replace(ArmConfig().winding, winding_time=0.05))
    hot, odd = Bench(effort=0.0, arm=arm), Bench(effort=0.0, arm=arm)
    for bench, sent in ((hot, ArmConfig().torque_limit[0]), (odd, np.nan)):
        bench.arm.servo_jf = lambda effort, out, sent=sent: out.fill(sent) or Status.OK
        bench.run(400)
    assert odd.loop._arms.hottest == pytest.approx(hot.loop._arms.hottest)
    assert odd.loop._arms.hottest > 26.0


def test_a_state_of_the_law_that_is_not_a_number_faults(bench):
    bench.loop._controller.update = lambda t, x, u, x_next, y: (x_next.fill(np.nan), y.fill(0.1))
    assert bench.run() is State.FAULT and bench.names() == {"law-invalid"}
    assert (bench.arm.out == 0.0).all()


def test_the_workspace_of_the_tip_is_watched_after_a_resume_too():
    from hil.controllers.dynamics import premium

    forward, lengths = premium()
    box = np.array([[0.1, -0.05, -0.3], [0.4, 0.05, 0.3]])
    bench = Bench(tip=lambda q, out: forward(q, lengths, out), box=box)
    states = []
    for q in np.linspace(0.0, 1.5, 3000):
        bench.arm.q[0] = q
        before = bench.loop.machine.state
        if bench.run() is State.PAUSED and before is State.ENABLED:
            states.append(q)
            bench.loop.mailbox.append(RESUME)
    assert len(states) > 2 and np.all(np.diff(states) > 0.05)


def test_the_workspace_is_watched_where_the_rig_file_gives_one():
    from hil.controllers.dynamics import premium

    forward, lengths = premium()
    box = np.array([[0.1, -0.05, -0.3], [0.4, 0.05, 0.3]])
    bench = Bench(tip=lambda q, out: forward(q, lengths, out), box=box)
    for q in np.linspace(0.0, 0.3, 300):
        bench.arm.q[0] = q
        bench.run()
    assert bench.loop.machine.state is State.PAUSED and "workspace" in bench.names()


def test_the_lamp_has_hysteresis(bench):
    for force, lamp in ((7.0, False), (7.3, True), (6.6, True), (6.4, False)):
        bench.arm.wrench[0] = force
        bench.run()
        assert ("force-yellow" in bench.names()) is lamp, force


def test_a_fault_is_latched_and_takes_no_command(bench):
    bench.arm.js = Status.INVALID
    bench.run()
    bench.arm.js = Status.OK
    bench.loop.mailbox.append(OperatorCommand("start", lambda loop: loop.begin()))
    assert bench.run(5) is State.FAULT
    assert (bench.arm.out == 0.0).all()


def test_a_hot_winding_pauses_and_a_warm_one_lights_the_lamp():
    bench = Bench(effort=0.79)
    seen, state = [], State.ENABLED
    while state is State.ENABLED and bench.loop.tick < 60_000:
        bench.arm.q[:] = MIDDLE + 1.2e-4 * (bench.loop.tick % 2)
        state = bench.run()
        seen.append(bench.names())
    assert state is State.PAUSED and "winding-red" in seen[-1]
    first = next(k for k, s in enumerate(seen) if "winding-yellow" in s)
    assert 0 < first < len(seen) - 100


def test_the_winding_follows_its_two_time_constants():
    # P = R i^2 at 25 degC and without the copper's rise: R1 P (1 - e^(-t/tau1)) + R2 P (...)
    constants = np.array([2.18, 3.1, 14.0, 12.0, 612.0, 25.0])
    heat, i = np.zeros(2), 0.1
    for _ in range(60_000):
        found = safety.warm(i, 1e-3, constants, heat)
    loss = 2.18 * i * i
    fast, slow = 1 - np.exp(-60 / 12), 1 - np.exp(-60 / 612)
    assert found == pytest.approx(25 + loss * (3.1 * fast + 14.0 * slow), rel=1e-3)


def test_missed_periods_pause_after_the_first_second():
    over = Overload(100, 1000)
    assert not over.over(500, 400)
    assert not over.over(1500, 60)
    assert not over.over(1600, 40)
    assert over.over(1700, 1)
    assert not over.over(2800, 0)
    # a clock that jumps is one large miss
    assert over.over(100_000, 90_000)


def test_the_table_of_conditions_is_whole():
    assert len({c.name for c in TABLE}) == len(TABLE) < 53
    assert PAUSING & FAULTING == 0
    assert named_conditions(0) == [] and sentence(0) == "nothing is wrong"


def test_rounding_is_finer_than_the_devices(bench):
    bench.arm.q[:] += 1e-5 / 3
    bench.run()
    assert np.abs(bench.loop.frame[:3] - bench.arm.q).max() <= safety.POSITION_GRID / 2


LIVE = f"""
import signal
import sys
from hil.runtime.runner import run_session as run
from hil.rig.config import load_rig
from hil.rig.open import open_rig

def opener(config, seed):
    rig = open_rig(config, seed)
    for port in rig.ports:
        wire = port.joints._wire
        def send(codes, send=wire.send):
            send(codes)
            print("codes", *codes, flush=True)
        def power(on, power=wire.power):
            power(on)
            print("power", on, flush=True)
        wire.send, wire.power = send, power
    return rig

# a job in the background of a script ignores it
signal.signal(signal.SIGINT, signal.default_int_handler)
over = eval(sys.argv[2]) if len(sys.argv) > 2 else {{}}
config = load_rig({str(RIG)!r}, over)
run(config, 20.0, 1, "real", sys.argv[1], opener=opener)
"""


@contextlib.contextmanager
def live(tmp_path, over=None):
    """A session in its own process whose motors have torque; nothing is left of it after."""
    words = [sys.executable, "-c", LIVE, str(tmp_path / "s.mcap"), repr(over or {})]
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(words, **piped) as process:
        try:
            torque = 0
            for line in process.stdout:
                torque += line.startswith("codes") and set(line.split()[1:]) != {"0"}
                if torque > 100:
                    break
            assert torque > 100, process.stderr.read()
            yield process
        finally:
            process.kill()


@pytest.mark.real_time
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_takes_the_torque_and_the_power_off(tmp_path, number):
    with live(tmp_path) as process:
        process.send_signal(number)
        said, _ = process.communicate(timeout=30)
    lines = said.splitlines()
    assert process.returncode != 0
    assert lines[-1] == "power False" and lines.count("power False") == 2
    assert [s for s in lines if s.startswith("codes")][-1] == "codes 0 0 0"
    from hil.record.mcap_read import load, summary

    assert not summary(tmp_path / "s.mcap").truncated
    assert load(tmp_path / "s.mcap", "leader").n > 0


@pytest.mark.real_time
@pytest.mark.parametrize("kind", ["killed", "hung"])
def test_the_watchdog_cuts_the_power_of_a_killed_and_of_a_hung_process(tmp_path, kind, agreed):
    mark, report = tmp_path / "cut", tmp_path / "s.mcap.watchdog.json"
    agreed(["touch", str(mark)])
    over = {"safety": {"watchdog": 1.0, "cut": ["touch", str(mark)]}}
    with live(tmp_path, over) as process:
        process.send_signal(signal.SIGKILL if kind == "killed" else signal.SIGSTOP)
        until = time.monotonic() + 20
        while not report.exists() and time.monotonic() < until:
            os.sched_yield()
    told = json.loads(report.read_text())
    assert mark.exists()
    assert ("gone" if kind == "killed" else "tick") in told["why"]
    assert told["silent_s"] < 10.0


def test_a_loop_that_is_gone_before_its_watchdog_has_begun_is_gone(tmp_path):
    from hil.runtime import watchdog

    mark, report = tmp_path / "cut", tmp_path / "s.mcap.watchdog.json"
    told = {"parent": -1, "timeout": 1.0, "cut": ["/bin/touch", str(mark)], "report": str(report)}
    told["latch"] = str(tmp_path / "latch")
    with (tmp_path / "page").open("w+b") as file:
        file.truncate(mmap.PAGESIZE)
        assert watchdog.main([str(file.fileno()), json.dumps(told)]) == 1
    assert mark.exists() and "gone" in json.loads(report.read_text())["why"]


@pytest.mark.real_time
def test_the_watchdog_keeps_still_where_the_session_ends(tmp_path, agreed):
    from hil.runtime.runner import run_session

    agreed(["touch", str(tmp_path / "cut")])
    over = {"safety": {"watchdog": 1.0, "cut": ["touch", str(tmp_path / "cut")]}}
    run_session(load_rig(RIG, over), 0.5, output=tmp_path / "s.mcap", clock="real")
    assert not (tmp_path / "cut").exists()
    assert not (tmp_path / "s.mcap.watchdog.json").exists()


def test_a_tick_leaves_nothing_for_the_collector(bench):
    import gc

    bench.run(50)
    gc.collect()
    gc.disable()
    try:
        before = gc.get_count()[0]
        bench.run(2000)
        assert gc.get_count()[0] - before < 50
    finally:
        gc.enable()


def test_what_the_operating_system_refuses_is_a_sentence(monkeypatch):
    from hil.runtime import realtime

    def refused(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refused)
    with realtime.arranged() as found:
        assert not sys.getswitchinterval() > 1e-4
    assert "SCHED_FIFO 80" not in found.granted
    assert "no SCHED_FIFO 80 (Operation not permitted; needs root" in found.refused[0]
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_statistics_count_what_happened():
    from hil.runtime.statistics import Statistics

    s = Statistics(DT_NS)
    timing = np.zeros((1000, 9))
    timing[:, 0] = 2_000.0
    timing[-1, :4] = 5_000_000.0, 80_000.0, 4, 1
    ticks = np.arange(1, 1001)
    ticks[-1] += 4
    for part in (slice(0, 500), slice(500, 1000)):
        s.add(ticks[part], timing[part])
    f = s.figures()
    assert (f.ticks, f.missed, f.dropped) == (1000, 4, 1)
    assert f.late_p50 == pytest.approx(2.0, rel=0.13) and f.late_most == 5000.0
    assert f.longest_gap == pytest.approx(5000.0 + 5000.0 - 2.0)
    assert sum(n for _, n in s.late.filled()) == 1000


@pytest.mark.parametrize("rate", [333, 350])
def test_a_law_that_shakes_an_arm_from_tick_to_tick_is_named_before_its_encoder(rate, tmp_path):
    config = load_rig("teleop", {"loop": {"rate_hz": rate}})
    said = f"(?s)moved as no joint can.*follower joint2.*half of rate_hz = {rate}.*raise rate_hz"
    with pytest.raises(DeviceError, match=said):
        run_session(config, 3.0, 0, "lockstep", tmp_path / "s.mcap")


def test_efforts_that_calm_down_or_wander_do_not_shake():
    k = np.arange(LOOKED_BACK)
    turning = 0.1 * (-1.0) ** k
    rows = np.column_stack([turning * 1.2**k, turning * 0.7**k, 0.1 * np.sin(0.5 * k), 0 * k])
    assert alternates(rows).tolist() == [True, False, False, False]
