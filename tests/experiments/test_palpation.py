"""Sensitivity by palpation on the simulated rig is what the theory predicts."""

import pytest

from hil.experiments import palpation, transparency, without_force_sensors
from hil.teleop import force_sensor_free, law_parameters, rig_designs


def test_a_bolt_in_the_gel_is_felt_as_much_as_predicted(tmp_path):
    """Four channels, the same without sensors, and the benchmark; one trial each."""
    given, axes = transparency.arms(transparency.identified(tmp_path, 1), without_force_sensors.LAW)
    four = without_force_sensors.designs(axes)
    kind, wish = palpation.NAMED[palpation.MEASURE]
    controllers = {
        "four": four,
        "free": [force_sensor_free.transform(d) for d in four],
        "measure": rig_designs.designs(kind, wish, axes),
    }
    rows = {
        n: palpation.palpate(n, d, given | law_parameters.table(d), tmp_path, 1, 1)
        for n, d in controllers.items()
    }
    for row in rows.values():
        assert row.mean == pytest.approx(row.predicted, rel=0.12)
    assert rows["free"].mean == pytest.approx(rows["four"].mean, rel=0.03)
    assert rows["measure"].mean < 0.6 * rows["four"].mean


def test_strokes_across_a_bolt_in_the_gel_are_felt(tmp_path):
    given, axes = transparency.arms(transparency.identified(tmp_path, 1), without_force_sensors.LAW)
    law = given | law_parameters.table(without_force_sensors.designs(axes))
    (gel, bolt), (there, under) = palpation.stroked(law, tmp_path, 1)
    # 20 mm of gel over 8 mm of cover: up to 2.5 times as stiff, blurred over the tip's way
    assert 1.3 < under / there < 2.5
    assert 1.1 < bolt / gel < under / there
    (found,), expected = palpation.stroke(law, tmp_path, 1, 1)
    assert found == pytest.approx(expected, rel=0.25)


def test_differences_are_those_asked_beforehand_after_holm():
    names = (palpation.MEASURE, "a", "a" + palpation.FREE_FORM)
    size = {palpation.MEASURE: 0.1, "a": 0.2, "a" + palpation.FREE_FORM: 0.2}
    rows = [
        palpation.PalpationRow(
            n,
            0.0,
            0.0,
            tuple(size[n] + 0.001 * ((k * 7 + i) % 5) + 1e-5 * k + 1e-6 * i for k in range(6)),
        )
        for i, n in enumerate(names)
    ]
    p = palpation.differences(rows)
    assert len(p) == 3
    # complete separation of six and six: 2 / 924, times three
    assert p[f"a / {palpation.MEASURE}"] == pytest.approx(3 * 2 / 924)
    assert p["a / a" + palpation.FREE_FORM] > 0.3
