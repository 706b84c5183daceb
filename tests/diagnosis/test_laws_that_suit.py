"""Laws whose shapes suit each other, and what is asked of one whose value lies at an end."""

from __future__ import annotations

import numpy as np
import plants
import pytest

import hil


def diagnosed(extra):
    runs = [plants.moved_axis(s, extra=extra) for s in (1, 2)]
    return hil.diagnose(runs[0], hil.base_model(runs[0].robot), runs[1])


def named(d):
    return {f.effect: f for f in d.findings if f.confidence > 0.9}


def arm(stiffness: float, time: float):
    """A Maxwell element: its damper's displacement, from what it is at the start."""

    def effort(t, q, v, a):
        x, dt = np.empty(t.size), t[1] - t[0]
        x[0] = q[0]
        for k in range(1, t.size):
            x[k] = x[k - 1] + dt * ((q[k] + q[k - 1]) / 2 - x[k - 1]) / (time + dt / 2)
        return stiffness * (q - x)

    return effort


@pytest.mark.parametrize(("stiffness", "time"), [(1.5, 0.4), plants.further(0.6, 2.0)])
def test_what_relaxes_is_named_with_its_time(stiffness, time):
    """It had been presliding at 1.00, or an unexplained lateness."""
    d = diagnosed(arm(stiffness, time))
    found = named(d)
    assert (d.verdict, set(found)) == ("missing-effect", {"relaxation"})
    values = {k.rpartition(".")[2]: v.value for k, v in found["relaxation"].parameters.items()}
    assert values["k"] == pytest.approx(stiffness, rel=0.03)
    assert values["T"] == pytest.approx(time, rel=0.05)
    assert d.ladder[-1].heldout.rms[0] < 1.1 * d.noise[0]


@pytest.mark.slow
def test_rubber_is_a_spring_and_what_relaxes_beside_it():
    """An eccentric mass suited the range better, until what relaxes had a name."""
    maxwell = arm(1.6, 0.5)
    d = diagnosed(lambda t, q, v, a: 1.2 * q + maxwell(t, q, v, a))
    assert set(named(d)) == {"spring", "relaxation"}
    assert d.ladder[-1].heldout.rms[0] < 1.1 * d.noise[0]


@pytest.mark.slow
def test_a_weight_before_a_stop_is_no_polynomial():
    """A function of the position stood for both, and beside it the stop lay elsewhere."""

    def extra(t, q, v, a):
        return 0.9 * np.sin(q) + 3.0 * np.maximum(q - 0.2, 0.0)

    d = diagnosed(extra)
    found = named(d)
    assert "end-stop" in found and "position-torque" not in found
    assert {"unbalance", "spring"} & set(found)
    assert found["end-stop"].parameters["j1.end-stop.q0"].value == pytest.approx(0.2, abs=0.01)
    assert d.ladder[-1].heldout.rms[0] < 1.15 * d.noise[0]
