"""Efforts of wrong sign or in swapped columns are bad data, not physics; right ones are not."""

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.diagnosis import columns
from hil.record.recording import Recording


def said(run: Recording) -> tuple[str, list[tuple[str, str]]]:
    d = hil.diagnose([run], hil.base_model(run.robot))
    return d.verdict, d.warnings


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda tau: -tau, "sign", "all efforts have the wrong sign"),
        (lambda tau: tau * [1, -1], "sign", "tau2 (joint2) has the wrong sign"),
        (lambda tau: tau[:, ::-1], "swapped", "tau1 and tau2 (joint1, joint2) are swapped"),
    ],
)
def test_mistaken_columns_are_bad_data(change, code, words):
    run = plants.axes_apart()
    verdict, warnings = said(replace(run, tau=np.ascontiguousarray(change(run.tau))))
    assert verdict == "bad-data"
    assert [c for c, _ in warnings] == [code] and words in warnings[0][1]


@pytest.mark.parametrize("order", [[1, 0, 2], [1, 2, 0]])
def test_positions_in_another_order_than_their_efforts_are_told_both_ways(order):
    """Of axes nothing says which of the two stand in the wrong columns: it was the efforts."""
    run = plants.slow_axes(1, d=3)
    fit = hil.fit([replace(run, q=run.q[:, order])], hil.base_model(run.robot))
    ((code, text),) = columns.mistaken(fit, [replace(run, q=run.q[:, order])])
    back = [order.index(k) for k in range(3)]
    assert code == "swapped" and "change only one of them" in text
    for stem, taken in (("q", back), ("tau", order)):
        for k, c in enumerate(taken):
            assert (f"{stem}{k + 1} from the column of {stem}{c + 1}" in text) == (k != c)


@pytest.mark.parametrize("order", [[1, 0, 2, 3], [1, 2, 0, 3]])
def test_a_description_tells_that_the_positions_are_in_another_order(order):
    run = plants.serial_arm(4, 1)
    for wrong, stem in (
        (replace(run, q=run.q[:, order]), "q"),
        (replace(run, tau=run.tau[:, order]), "tau"),
    ):
        fit = hil.fit([wrong], hil.base_model(run.robot))
        ((code, text),) = columns.mistaken(fit, [wrong])
        back = order.index(0) + 1
        assert code == "swapped" and f"{stem}1 from the column of {stem}{back}" in text
        assert ("tau1" in text) == (stem == "tau")


def test_a_comparison_says_which_column_is_mistaken():
    run = plants.axes_apart()
    swapped = replace(run, tau=np.ascontiguousarray(run.tau[:, ::-1]))
    c = hil.compare([swapped], hil.base_model(run.robot), simulate=False)
    assert [f.code for f in c.faults if f.code in ("sign", "swapped")] == ["swapped"]
    c = hil.compare([run], hil.base_model(run.robot), simulate=False)
    assert not [f.code for f in c.faults if f.code in ("sign", "swapped")]


def test_one_axis_of_wrong_sign():
    run = plants.axis(1)
    verdict, warnings = said(replace(run, tau=-run.tau))
    assert verdict == "bad-data" and warnings[0][0] == "sign"


def test_right_columns_are_not_bad_data():
    assert said(plants.axes_apart())[0] == "adequate"
    # a large effect is one, not a wrong column
    assert said(plants.axis(1, extra=lambda t, q, v: 2.0 * np.sin(3 * q)))[0] != "bad-data"


def test_friction_that_drives_raises_suspicion_though_free_masses_take_the_sign():
    run = plants.axis(1)
    fits = [
        hil.fit([replace(run, tau=sign * run.tau)], hil.base_model(run.robot)) for sign in (1, -1)
    ]
    assert [columns.driven(f) for f in fits] == [False, True]
