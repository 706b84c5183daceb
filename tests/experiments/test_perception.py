"""Simulated subjects: their share is that of signal detection, the tests keep their level."""

import numpy as np
import pytest

from hil.experiments import perception
from hil.experiments.perception import MEASURE, PEN, SO, WITHOUT_SENSORS, Felt


def test_the_share_that_is_found_is_that_of_signal_detection(monkeypatch):
    monkeypatch.setattr(perception, "_LAPSE", 0.0)
    found = perception.found_share(np.array([0.0, 1.0, 2.0]), 4)
    assert found == pytest.approx([0.25, 0.55, 0.82], abs=0.01)
    # two cells: Phi(d' / sqrt 2)
    assert float(perception.found_share(1.0, 2)) == pytest.approx(0.7602, abs=1e-3)


def test_what_is_felt_is_the_change_of_the_logarithm_over_its_noise():
    logs = np.log(np.array([[2.0, 3.0, 4.0], [2.2, 3.3, 4.4]]))
    felt = perception._felt(logs, 1)
    assert felt.change == pytest.approx(np.log(1.5))
    assert felt.scatter == pytest.approx(np.log(1.1) / np.sqrt(2))
    index = perception.index_of(Felt(0.4, 0.3), 0.4)
    assert float(index) == pytest.approx(0.4 / 0.5)


def test_both_tests_keep_their_level():
    """Equal controllers differ in 5 %; those apart by the margin are called equal in 5 %."""
    same = Felt(0.2, 0.02)
    level = perception.power(same, same, perception._differs, 12, 40, 1)
    assert level == pytest.approx(0.05, abs=0.02)
    grid = np.linspace(0.2, 0.6, 2000)
    shares = perception.found_share(grid / 0.19)
    other = Felt(float(np.interp(shares[0] + perception.EQUALITY_MARGIN, shares, grid)), 0.02)
    called = perception.power(other, Felt(0.2, 0.02), perception._equal, 40, 40, 1)
    assert called < 0.08


def test_a_small_test_cannot_decide_and_the_named_size_does():
    felt = {SO: Felt(0.14, 0.002), WITHOUT_SENSORS: Felt(0.14, 0.002), MEASURE: Felt(0.09, 0.004)}
    felt[PEN] = Felt(0.25, 0.001)
    rows = {r.controller: r for r in perception.tests({"bolt": felt}, 3)}
    assert rows[SO].power < 0.3 < rows[PEN].power
    assert rows[perception.EQUAL].power < 0.05
    n = round(rows[SO].subjects)
    again = perception.power(
        felt[SO], felt[MEASURE], perception._differs, n, perception.MANY_TRIALS, 9
    )
    assert again == pytest.approx(0.8, abs=0.06)
    assert np.isnan(rows[MEASURE].power)
    assert rows[PEN].subjects < rows[SO].subjects


def test_equal_scores_of_all_subjects_are_no_difference():
    none = np.zeros((2, 5))
    assert not perception._differs(none).any()
    assert perception._equal(none).all()
