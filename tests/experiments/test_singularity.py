"""The safe distance to the estimation singularity: runs against eigenvalues, and what costs."""

from dataclasses import replace

import numpy as np
import pytest

from hil.experiments import singularity
from hil.experiments.singularity import BASE, KAPPAS
from hil.teleop import force_sensor_free
from hil.teleop.architecture import Design


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Runs of three seconds: the last of them, a whole period of the hand, is watched."""
    monkeypatch.setattr(singularity, "_SECONDS", 3.0)


@pytest.mark.parametrize("kappa", [1.5, 3.9])
def test_the_shared_force_gives_the_condition_of_q(kappa):
    c2 = float(singularity.share(kappa))
    assert force_sensor_free.conditioning(Design(c2=c2, c3=c2, c5=0.1, c6=0.1)) == pytest.approx(
        kappa
    )


@pytest.mark.slow
def test_without_friction_and_steps_runs_end_where_eigenvalues_do(monkeypatch):
    monkeypatch.setattr(singularity, "_COULOMB", 0.0)
    monkeypatch.setattr(singularity, "_RISE", 0.0)
    wares = [replace(BASE, step=0.0, friction=0.0, corner=f) for f in (5.0, 10.0)]
    kappas = np.array([1.1, 2.0, 4.5])
    stable, accurate = singularity.verdicts(wares, 1, kappas)
    assert stable.tolist() == [[True, True, False], [True, False, False]]
    assert accurate[stable].all()
    edges = [singularity.linear(w) for w in wares]
    assert 2.0 < edges[0] < 4.5 and 1.1 <= edges[1] < 2.0


def test_a_late_channel_and_a_wide_filter_cost_what_eigenvalues_say():
    assert singularity.linear(replace(BASE, corner=30.0)) == 1.0
    assert singularity.linear(replace(BASE, delay=2)) < singularity.linear(BASE)
    assert singularity.linear(replace(BASE, corner=1.0)) > singularity.linear(BASE)
    assert np.isnan(singularity.linear(replace(BASE, accelerometer="tip")))


@pytest.mark.slow
def test_friction_that_no_model_holds_is_in_the_estimate():
    wares = [BASE, replace(BASE, friction=0.0), replace(BASE, step=120e-6)]
    stable, accurate = singularity.verdicts(wares, 2, KAPPAS[:1])
    assert accurate[0, 0] and not accurate[1, 0]
    assert stable[0, 0] and not stable[2, 0]
