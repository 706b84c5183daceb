"""Where a model fails: every view finds what was put there, and nothing where nothing is."""

from __future__ import annotations

import numpy as np
import plants
import pytest

from hil.commands.compare import text
from hil.diagnosis import residuals
from hil.diagnosis.evidence import gather
from hil.diagnosis.residuals import Region, motion_path, regions, since_reversal, spectral_lines
from hil.diagnosis.verbs import compare, fit
from hil.identify.problem import Problem
from hil.identify.timing import fit_aligned
from hil.models.model import base_model
from hil.record.recording import Recording


def compared(run: Recording):  # type: ignore[no-untyped-def]
    model = base_model(run.robot)
    result = fit_aligned(Problem([run], model.robot), model)
    return result, gather(result).floor


def disturbed(run: Recording, extra: np.ndarray) -> Recording:
    from dataclasses import replace

    return replace(run, tau=run.tau + extra[:, None])


def test_since_reversal_in_time_and_distance() -> None:
    t = np.arange(8.0)
    v = np.array([1, 1, 0.01, -0.01, -1, -1, 1, 1.0])
    run = np.array([0, 0, 0, 0, 0, 0, 1, 1])
    assert since_reversal(v, 0.1, t, run).tolist() == [0, 1, 2, 3, 0, 1, 0, 1]
    q = np.array([0, 1, 2, 2, 1, 0, 5, 6.0])
    assert motion_path(q, run).tolist() == [0, 1, 2, 2, 3, 4, 4, 5]
    assert since_reversal(v, 0.1, motion_path(q, run), run).tolist() == [0, 1, 2, 2, 0, 1, 0, 1]


@pytest.mark.parametrize(
    ("shape", "feature", "low", "high"),
    [
        (lambda r: 0.05 * np.sin(2 * np.pi * 3.3 * r.t), "line", 3.25, 3.35),
        (lambda r: 0.05 * np.sin(2 * np.pi * 2.0 * r.q[:, 0]), "order", 1.8, 2.2),
        (
            lambda r: 0.05 * np.sin(2 * np.pi * 2.0 * r.q[:, 0]) * np.sign(np.gradient(r.q[:, 0])),
            "friction-order",
            1.8,
            2.2,
        ),
    ],
)
def test_lines_are_found_where_they_were_put(shape, feature, low, high) -> None:  # type: ignore[no-untyped-def]
    run = plants.stiction_axis(1)
    result, floor = compared(disturbed(run, shape(run)))
    found = {x.feature: x for x in spectral_lines(result, floor, 0)}
    assert low < found[feature].high < high
    assert found[feature].text.startswith("joint1: ")


def test_a_drag_shows_over_speed_and_nothing_shows_without() -> None:
    result, floor = compared(plants.stiction_axis(1, drag=0.2))
    assert "speed" in {r.feature for r in regions(result, floor)["joint1"]}
    result, floor = compared(plants.stiction_axis(1))
    assert regions(result, floor)["joint1"] == []


def hummed(share: float) -> Recording:
    """A quiet axis of inertia and viscous friction with a hum of a share of its rms effort."""
    rng, t = np.random.default_rng(3), np.arange(20000) / 1000.0
    w = 2 * np.pi * np.array([0.11, 0.37, 0.9])
    q, v, a = plants.sines(t, w, np.array([0.5, 0.3, 0.1]), np.array([1.0, 2.0, 3.0]))
    tau = 0.5 * a + 0.8 * v
    size = float(np.sqrt(np.mean(tau**2)))
    tau += np.sqrt(2) * share * size * np.sin(2 * np.pi * 3.3 * t)
    return plants.single("hum", t, q, tau + 1e-3 * size * rng.standard_normal(t.size))


def test_what_is_below_the_practical_size_is_no_place_and_no_alarm() -> None:
    said = {}
    for share in (0.0015, 0.015):
        run = hummed(share)
        said[share] = text(compare([run], base_model(run.robot)))
    assert "nowhere above the noise band by more than 0.3 % of the rms effort" in said[0.0015]
    assert "times its noise band" not in said[0.0015] and "remaining error" not in said[0.0015]
    assert "the residual has a line at 3" in said[0.015]


def test_what_is_hardly_above_its_noise_band_is_no_place(monkeypatch) -> None:
    """Bands and floors are known to a tenth each."""
    result, floor = compared(plants.stiction_axis(1))
    size = float(result.problem.rms(result.problem.effort)[0])

    def place(strength):
        return Region("joint1", "speed", 0.0, 1.0, "rad/s", size, size, 1.0, strength, "there")

    for strengths, kept in (((1.05, 1.2), []), ((1.2, 1.5), [1.5])):
        found = {"joint1": [place(x) for x in strengths]}
        monkeypatch.setattr(residuals, "_found", lambda *_, of=found: dict(of))
        assert [r.strength for r in residuals.that_matter(result, floor)["joint1"]] == kept


def test_a_comparison_says_whose_floor_it_is() -> None:
    run = plants.stiction_axis(1)
    model = fit([run], base_model(run.robot)).model
    fitted, kept = (text(compare([run], m)) for m in (model, model.as_it_is()))
    assert "Noise floor of these sessions, from" in fitted
    assert "Noise floor of these sessions (not that of the fitted sessions), from" in kept
