"""A name with which the model moves worse than without is none."""

from dataclasses import replace

import compare_plants as plants
import numpy as np
import pytest

import hil
from hil.commands.diagnosetext import text
from hil.compare import words, worsened
from hil.compare.analysis import ladder
from hil.compare.findings import Finding
from hil.compare.material import from_diagnosis
from hil.record.recording import Recording

RATE, STEPS = 500.0, 8
#: Motor and link [kg m^2], play [rad], shaft [N m/rad, N m s/rad], dry and viscous friction.
JM, JL, GAP, STIFF, DAMP = 0.008, 0.012, 0.02, 300.0, 0.3
FC, FV, FC_LINK = 0.12, 0.05, 0.06


def geared(seed, seconds=28.0):
    """An axis that drives a link through a gear with play and a soft shaft; the motor is seen."""
    rng, h = np.random.default_rng(seed), 1 / RATE / STEPS
    t = np.arange(int(seconds * RATE)) / RATE
    w = 2 * np.pi * np.array([0.07, 0.23, 0.61, 1.05])
    a, ph = np.array([0.66, 0.36, 0.14, 0.07]), rng.uniform(0, 6.28, 4)
    goal = np.sin(w * t[:, None] + ph) @ a
    rate = np.cos(w * t[:, None] + ph) @ (a * w)
    q = link = float(goal[0])
    qd = linked = float(rate[0])
    rows = np.empty((t.size, 2))
    for k in range(t.size):
        tau = 25.0 * (goal[k] - q) + 0.7 * (rate[k] - qd)
        rows[k] = q, tau
        for _ in range(STEPS):
            twist = q - link
            bent = twist - min(max(twist, -GAP / 2), GAP / 2)
            shaft = STIFF * bent + DAMP * (qd - linked) * (bent != 0.0)
            shaft *= shaft * bent > 0.0
            free = qd + h * (tau - FV * qd - shaft) / JM
            qd = np.sign(free) * max(abs(free) - h * FC / JM, 0.0)
            free = linked + h * shaft / JL
            linked = np.sign(free) * max(abs(free) - h * FC_LINK / JL, 0.0)
            q, link = q + h * qd, link + h * linked
    rows += [1e-5, 0.01] * rng.normal(size=rows.shape)
    return Recording("axis", "arm", ("joint1",), t, rows[:, :1], rows[:, 1:])


@pytest.fixture(scope="module")
def geared_axis():
    run = geared(1)
    return hil.diagnose([run], hil.base_model(run.robot))


def test_what_lowers_the_effort_error_alone_is_no_cause(geared_axis):
    d = geared_axis
    assert d.verdict == "unexplained" and not d.findings
    assert [f.effect for f in d.partial] == ["presliding"]
    first, last = ladder(d)[0], ladder(d)[-1]
    assert last.step.heldout.rms[0] < 0.8 * first.step.heldout.rms[0]
    assert last.multi_step.rms[0] > 1.5 * first.multi_step.rms[0]


def test_terminal_and_report_say_why(geared_axis):
    shown = text(geared_axis, ladder(geared_axis))
    assert "presliding on joint1 (the simulated motion is worse with it)" in shown
    (sentence,) = [x for code, x in geared_axis.warnings if code == worsened.CODE]
    assert sentence in shown and "a cause lowers both, that is not the cause" in sentence
    details = words.details(from_diagnosis(geared_axis))
    assert any("the simulated motion is worse with it" in line for line in details)
    assert f"{sentence}." in details


@pytest.mark.parametrize(
    ("effect", "extra"),
    [
        ("quadratic-drag", lambda t, q, v: 0.2 * v * abs(v)),
        ("stribeck", lambda t, q, v: 0.15 * np.sign(v) / (1 + (v / 0.1) ** 2)),
        ("end-stop", lambda t, q, v: 4.0 * max(q - 0.6, 0.0) ** 1.3),
    ],
)
def test_a_right_name_lowers_both_errors(effect, extra):
    run = plants.axis(1, extra=extra)
    before, after = hil.add([run], hil.base_model(run.robot), effect)
    named = [Finding(effect, "joint1", 1.0, 5.0, 2.0, 0.1, 0.8, {}, [])]
    steps, simulated = zip(*((r.step, r.multi_step) for r in (before, after)), strict=True)
    assert worsened.worsened(steps, simulated, named) == {}


def test_the_replay_counts_where_short_horizons_do_not_show_it(geared_axis):
    first, last = (r.multi_step for r in ladder(geared_axis)[:: len(ladder(geared_axis)) - 1])
    named = [replace(geared_axis.partial[0])]
    steps = geared_axis.ladder
    replayed = replace(first, closed_loop=last.closed_loop)
    found = worsened.worsened(steps, [first, replayed], named)
    assert list(found) == ["joint1"] and "under a servo of 1 Hz" in found["joint1"]
    assert worsened.worsened(steps, [first, first], named) == {}
