"""What is left at the floor and is no noise: said with what it is like, when and how fast."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import plants
import pytest
from scipy.signal import lfilter

import hil
from hil.commands.compare import text as compared
from hil.commands.diagnose import short, text
from hil.diagnosis import engine
from hil.diagnosis.constants import BURSTS, CERTAIN, SURE, SWINGS
from hil.diagnosis.residual_tests import (
    STARTS,
    UNLIKE,
    _slowly,
    kurtosis,
)
from hil.diagnosis.touches import TOUCHED, Touch, _often, touches
from hil.diagnosis.verbs import ladder
from hil.record.recording import Recording
from hil.report.html import diagnosis_report


def switching(seed):
    rng = np.random.default_rng(seed)
    return np.where(np.cumsum(rng.random(plants.DRY_T.size) < 0.002) % 2, 1.0, -1.0)


def answer(extra, **more):
    run = plants.dry_axis(extra, **more)
    d = hil.diagnose([run], hil.base_model(run.robot))
    return d, [w for code, w in d.warnings if code == UNLIKE]


@pytest.mark.slow
def test_a_wave_whose_frequency_rises_is_told_with_its_frequencies(tmp_path):
    d, (said,) = answer(np.sin(2 * np.pi * (2.0 * plants.DRY_T + 0.16 * plants.DRY_T**2)))
    assert d.verdict == "unexplained" and not d.findings
    assert said.startswith("joint1: the remaining error swings from side to side, at about ")
    at = [float(x) for x in said.split("about ")[1].split(" Hz")[0].replace("and", ",").split(",")]
    assert 2.0 < at[0] < 5.0 < at[1] < 8.0 < at[2] < 10.0
    shown = text(d, ladder(d))
    assert shown.count(said) == 1 and shown.index(said) < shown.index("held-out error")
    run = plants.dry_axis(np.sin(2 * np.pi * (2.0 * plants.DRY_T + 0.16 * plants.DRY_T**2)))
    assert said in compared(hil.compare([run], hil.base_model(run.robot)))
    page = tmp_path / "r.html"
    diagnosis_report(d, page)
    html = page.read_text(encoding="utf-8")
    assert (
        "the remaining error of joint1 is not noise" in html and "Record this joint at rest" in html
    )


@pytest.mark.parametrize("seed", plants.seeds(1, 2))
def test_a_torque_that_switches_is_no_noise(seed):
    d, (said,) = answer(2.5 * switching(seed), seed=seed)
    assert d.verdict == "unexplained" and "It is not noise (kurtosis -1." in said


def test_bursts_are_told_with_their_instants_and_leave_the_verdict():
    rng, extra = np.random.default_rng(3), np.zeros(plants.DRY_T.size)
    at = (3.3, 11.0, 19.7)
    for x in at:
        extra += (
            4.0
            * rng.standard_normal(plants.DRY_T.size)
            * np.exp(-(((plants.DRY_T - x) / 0.15) ** 2))
        )
    d, (said,) = answer(extra)
    assert d.verdict == "adequate" and "comes in bursts" in said
    told = [float(x) for x in said.split("largest are at ")[1].split(" s of monday")[0].split(",")]
    assert told == pytest.approx(at, abs=0.3)


def test_bursts_are_told_of_the_run_that_has_them():
    rng = np.random.default_rng(3)
    near = np.exp(-(((plants.DRY_T[:, None] - [5.0, 14.2]) / 0.15) ** 2)).sum(axis=1)
    quiet = plants.dry_axis(np.zeros(plants.DRY_T.size), seed=2)
    hit = replace(plants.dry_axis(6.0 * rng.standard_normal(near.size) * near), name="tuesday")
    d = hil.diagnose([quiet, hit], hil.base_model(hit.robot))
    (said,) = [w for code, w in d.warnings if code == UNLIKE]
    told = [float(x) for x in said.split("largest are at ")[1].split(" s of tuesday")[0].split(",")]
    assert all(min(abs(x - at) for x in told) < 0.3 for at in (5.0, 14.2))


@pytest.mark.parametrize("colour", [0.0, 0.9, 0.99])
@pytest.mark.parametrize("seed", plants.seeds(1, 2, 3))
def test_of_noise_of_any_colour_nothing_is_said(colour, seed):
    d, said = answer(np.zeros(plants.DRY_T.size), seed=seed, colour=colour)
    assert d.verdict == "adequate" and not said


@pytest.mark.parametrize("pole", [0.5, 0.9, 0.98])
def test_bounds_hold_for_gaussian_noise(pole):
    rng = np.random.default_rng(7)
    found = []
    for _ in range(400):
        r = lfilter([1.0], [1.0, -pole], rng.standard_normal(2000))[100:]
        found.append(kurtosis((r - r.mean()) / r.std()))
    k, se = np.array(found).T
    assert np.mean((k < SWINGS) & (k < -SURE * se)) <= 0.005
    assert np.mean((k > BURSTS) & (k > CERTAIN * se)) <= 0.005
    # the standard error is that of the sample
    assert np.std(k) == pytest.approx(np.mean(se), rel=0.35)


def test_known_distributions():
    t = np.linspace(0, 1, 5000, endpoint=False)
    assert kurtosis(np.sqrt(2) * np.sin(2 * np.pi * 40 * t))[0] == pytest.approx(-1.5)
    assert kurtosis(np.where(t < 0.5, 1.0, -1.0))[0] == pytest.approx(-2.0)


@pytest.mark.parametrize(("slow", "said"), [(True, True), (False, False)])
def test_bursts_where_the_joint_starts_and_turns_are_friction_at_low_speed(slow, said):
    rng, v = np.random.default_rng(1), np.sin(np.linspace(0, 60, 6000))
    burst = np.abs(v) < 0.05 if slow else np.abs(np.abs(v) - 0.7) < 0.03
    left = 0.1 * rng.standard_normal(v.size) + 2.0 * burst * np.sign(v)
    problem = SimpleNamespace(live=np.ones((1, v.size), dtype=bool), qd=v[None])
    assert (STARTS in _slowly(problem, 0, left)) is said


def hand(t):
    """Two pushes of about a second [N m]."""
    return 0.5 * np.exp(-(((t - 6.0) / 0.4) ** 2)) - 0.4 * np.exp(-(((t - 14.0) / 0.3) ** 2))


@pytest.mark.slow
def test_pushes_of_a_moment_are_told_with_their_times_and_left_out():
    """A hand pushes an axis twice: the fit, the errors and the floor are those without it."""
    run = replace(plants.axis(1, push=hand), tau_ext=None)  # nobody measures it
    d, quiet = (hil.diagnose([r], hil.base_model(r.robot)) for r in (run, plants.axis(1)))
    (said,) = [w for code, w in d.warnings if code == TOUCHED]
    (a, b), (c, e) = np.array(re.findall(r"([0-9.]+) to ([0-9.]+) s", said), dtype=float)
    assert a < 6.0 < b < c < 14.0 < e and (b - a) + (e - c) < 6.0
    assert d.verdict == quiet.verdict == "adequate"
    assert d.noise == pytest.approx(quiet.noise, rel=0.1)
    assert said in text(d, ladder(d)) and said in short(d, ladder(d), None)
    (still,), (rest,) = ([w for c, w in x.warnings if c == "standstill"] for x in (d, quiet))
    shares = [float(re.search(r"still for (\d+) %", x)[1]) for x in (still, rest)]
    assert shares == pytest.approx([12, 12], abs=1)
    assert not any(code == TOUCHED for code, _ in quiet.warnings)


def test_what_acts_when_a_run_begins_may_be_how_it_begins():
    """A spring that had yielded was told as a hand."""
    run = plants.serial_arm(2, 1, axes=("0 1 0", "0 1 0"))
    push = 4.0 * np.exp(-(((run.t - 0.3) / 0.5) ** 2))
    run = replace(run, tau=run.tau + np.outer(push, [1.0, 0.0]))
    (first, *_) = touches(hil.fit([run], hil.base_model(run.robot)))
    assert first.early and "not at rest when the run began" in first.text
    assert "not at rest" not in replace(first, early=False).text


@pytest.mark.slow
def test_pushes_of_several_joints_and_runs_do_not_hide_each_other():
    """All that a hand does on two joints of two runs is left out; a fit of squares hid half."""
    runs = []
    for seed, times in ((1, (4.0, 16.0)), (2, (9.0,))):
        run = plants.serial_arm(2, seed, axes=("0 1 0", "0 1 0"))
        push = sum(np.exp(-(((run.t - s) / 0.5) ** 2)) for s in times)
        runs.append(replace(run, tau=run.tau + np.outer(push, [4.0, -2.0])))
    d = hil.diagnose(runs, hil.base_model(runs[0].robot))
    said = [w for code, w in d.warnings if code == TOUCHED]
    for joint in runs[0].joints:
        times = re.findall(r"([0-9.]+) to ([0-9.]+) s", " ".join(w for w in said if joint in w))
        for middle in (4.0, 16.0, 9.0):
            assert any(float(a) < middle < float(b) for a, b in times), (joint, middle)
    assert (d.verdict, d.findings) == ("adequate", [])


def knob(push: float, width: float = 0.01) -> Recording:
    """A knob with cogging and dry friction that builds up; a hand pushes it for a second."""
    rng = np.random.default_rng(1)
    t = np.arange(24 * 400) / 400.0
    w = 2 * np.pi * np.array([0.11, 0.29, 0.67])
    q, v, a = plants.sines(t, w, np.array([1.0, 0.9, 0.4]), rng.uniform(0, 6.28, 3))
    z = np.zeros(t.size)
    for k, step in enumerate(np.diff(q), 1):
        z[k] = np.sign(step) + (z[k - 1] - np.sign(step)) * np.exp(-abs(step) / width)
    tau = 4e-4 * a + 0.012 * z + 0.003 * v + 0.008 * np.sin(14 * q + 0.3)
    tau += push * np.exp(-(((t - 11.0) / 0.5) ** 4)) + 2e-4 * rng.standard_normal(t.size)
    return plants.single("knob", t, q, tau)


@pytest.mark.parametrize(("push", "width"), [(-0.02, 0.03), plants.further(-0.03, 0.01)])
def test_a_push_beside_what_is_missing_is_left_out_and_hides_nothing(push, width):
    """It was most of what was left, and of two effects one or none was found beside it."""
    run = knob(push, width)
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert {f.effect for f in d.findings if f.confidence > 0.95} == {"cogging", "presliding"}
    (said,) = [w for code, w in d.warnings if code == TOUCHED]
    a, b = map(float, re.search(r"([0-9.]+) to ([0-9.]+) s", said).groups())
    assert 9.0 < a < 10.8 and 11.2 < b < 13.0
    assert d.ladder[-1].heldout.relative[0] < 0.5


def test_what_is_suspected_of_a_push_and_is_none_stays(monkeypatch):
    """A better model that leaves nothing more then than at other times clears the suspicion."""
    run, asked = knob(0.0), []
    plain = hil.diagnose([run], hil.base_model(run.robot))
    span = [(5.0, 6.0)]
    told = [Touch("joint1", "knob", "N m", 0, span, 0.0, 1.0)]
    monkeypatch.setattr(engine, "suspects", lambda result: asked.append(result) or told)
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert asked and not any(code == TOUCHED for code, _ in d.warnings)
    assert [f.effect for f in d.findings] == [f.effect for f in plain.findings]
    assert d.ladder[-1].heldout.relative == pytest.approx(plain.ladder[-1].heldout.relative)


def test_what_acts_where_a_joint_is_only_then_is_no_push():
    """A stop that is met a few times: no other instant has such positions."""
    run = plants.axis_with_stop(0.86, 1)
    assert 0.0 < np.mean(run.q > 0.5) < 0.1
    assert touches(hil.fit([run], hil.base_model(run.robot))) == []
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert not any(code == TOUCHED for code, _ in d.warnings)


@pytest.mark.parametrize(("moments", "long", "often"), [(5, 4, True), (2, 8, False), (5, 1, False)])
def test_what_acts_many_times_and_for_long_comes_with_the_motion(moments, long, often):
    """Drag of an eddy brake was told as a hand that pushed five times in 25 s."""
    struck, every = np.zeros(100, dtype=bool), np.ones(100, dtype=bool)
    for k in range(moments):
        struck[9 * k : 9 * k + long] = True
    # a second run, twice as long, in which nothing acts
    blocks = np.arange(300).repeat(2) // 2
    runs = SimpleNamespace(runs=2, whole=np.array([0, 1]), run=(blocks >= 50).astype(int))
    wide = np.concatenate([struck[:50], np.zeros(250, dtype=bool)])
    full = np.concatenate([every, every, every])
    assert _often(wide, full, blocks, runs) is often


def test_a_push_is_told_where_the_noise_of_other_runs_is_less():
    """Blocks of two kinds of noise spread so far that a push of a second was within that."""
    quiet = plants.smooth_axis(1, 20.0, 250.0, noise=0.002)
    loud = plants.smooth_axis(2, 20.0, 250.0, noise=0.05)
    push = 1.0 * np.exp(-(((loud.t - 8.0) / 0.4) ** 4))
    pushed = replace(loud, tau=loud.tau + push[:, None])
    base = hil.base_model(loud.robot)
    assert touches(hil.fit([quiet, pushed], base)) == []
    d = hil.diagnose([quiet, pushed], base)
    (said,) = [w for code, w in d.warnings if code == TOUCHED]
    a, b = map(float, re.search(r"([0-9.]+) to ([0-9.]+) s", said).groups())
    assert 6.0 < a < 8.0 < b < 10.0 and "of run2" in said.replace(loud.name, "run2")
    assert (d.verdict, d.findings) == ("adequate", [])
    assert d.noise == pytest.approx(hil.diagnose([quiet, loud], base).noise, rel=0.2)
