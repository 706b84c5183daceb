"""Held-out sessions: what is refused, and effects that every run has for itself."""

from dataclasses import replace

import compare_plants as plants
import numpy as np
import pytest

import hil
from hil.errors import DataError
from hil.models.model import Use


def test_a_fitted_session_is_no_held_out_one() -> None:
    run = plants.axis(1)
    with pytest.raises(DataError, match="holds the same data as the fitted session"):
        hil.diagnose([run], hil.base_model(run.robot), [replace(run, name="copy")])
    with pytest.raises(DataError, match="give another one, or none"):
        hil.compare([run], hil.base_model(run.robot), [replace(run, name="copy")])


def test_lost_counts_of_a_fitted_run_do_not_upset_a_held_out_run() -> None:
    """An effect of the whole robot with its own coefficients in every run."""
    runs = plants.arm(1), plants.arm(2)
    shift = np.where(runs[0].t > 8.0, 0.05, 0.0)[:, None] * np.array([0, 1, 0])[: runs[0].d]
    lost = replace(runs[0], q=runs[0].q + shift)
    base = hil.base_model(lost.robot)
    model = base + Use("missed-counts", ("joint2",), {"per_run": True})
    before, after = (hil.compare([lost], m, [runs[1]]).heldout.rms for m in (base, model))
    assert after[1] < before[1]
