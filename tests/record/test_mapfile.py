"""Map arithmetic."""

from __future__ import annotations

import tomllib

import numpy as np
import plants
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hil
from hil.errors import ConfigError
from hil.identify.prepare import signal
from hil.models.model import Band
from hil.record.bags import BagChoice
from hil.record.mapfile import builtin_maps, parse_map, read_map
from hil.record.sources import subset

numbers = st.floats(-1e3, 1e3, allow_nan=False).filter(lambda x: abs(x) > 1e-3)


@given(scale=numbers, shift=numbers, sign=st.sampled_from([-1, 1]), x=numbers)
def test_a_rule_and_its_inverse(scale, shift, sign, x):
    entry = {"from": "a", "scale": scale, "shift": shift, "sign": sign}
    back = {"from": "b", "scale": 1 / scale, "shift": -sign * shift / scale, "sign": sign}
    rules = parse_map({"columns": {"q1": entry, "q2": back}}).arms[""]
    there = rules["q1"].apply({"a": np.array([x])}, 1)
    again = rules["q2"].apply({"b": there}, 1)
    np.testing.assert_allclose(again, x, rtol=1e-6, atol=1e-6 * (1 + abs(shift / scale)))


@given(weights=st.dictionaries(st.sampled_from("abcd"), numbers, min_size=1), shift=numbers)
def test_combination_of_columns(weights, shift):
    rule = parse_map({"columns": {"q1": {"sum": weights, "shift": shift}}}).arms[""]["q1"]
    rng = np.random.default_rng(1)
    data = {name: rng.normal(size=5) for name in "abcd"}
    want = sum(w * data[n] for n, w in weights.items()) + shift
    np.testing.assert_allclose(rule.apply(data, 5), want, rtol=1e-9, atol=1e-6)


def test_constant_column():
    rule = parse_map(tomllib.loads("[columns]\ntau1 = 0.0")).arms[""]["tau1"]
    assert rule.apply({}, 3).tolist() == [0, 0, 0]


@pytest.mark.parametrize("name", builtin_maps())
def test_built_in_maps_read(name):
    assert read_map(name).arms


def test_built_in_maps_are_those_of_the_public_sets_and_of_known_programs():
    programs = ("dvrk", "lerobot", "libfranka", "ur-rtde")
    public = ("emps", "robot-beside", "tue-1dof", "tx40")
    assert builtin_maps() == tuple(sorted(public + programs))


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("position_hz", -5.0, "expected a frequency in Hz"),
        ("gap_s", float("inf"), "expected a time in s"),
        ("lag_poles", 7, "expected 1 or 2"),
        ("accuracy", 5.0, "share of the rms effort, e.g. 0.01, or 0"),
        ("clock_ppm", "fast", "expected a number"),
        ("effort_step", 0.1, "expected one step a joint"),
        ("effort_step", [-0.1], "expected one step a joint"),
    ],
)
def test_a_signal_that_cannot_be_is_refused_as_in_a_model(key, value, said):
    with pytest.raises(ConfigError, match=f"signal.{key} = .*{said}"):
        parse_map({"signal": {key: value}})


def test_steps_of_a_converter_go_with_their_joints():
    r = plants.joints(d=3)
    stems = (("q", r.q), ("tau", r.tau))
    frame = {"t": r.t} | {f"{s}{k + 1}": v[:, k] for s, v in stems for k in range(3)}
    given = {"signal": {"effort_step": [0.1, 0.0, 0.3], "shift_s": -0.001}}
    run = hil.from_arrays(frame, map=given)
    assert signal(Band(), run) == Band(shift_s=-0.001, effort_step=(0.1, 0.0, 0.3))
    some = subset(run, BagChoice(joints=("joint1", "joint3")))
    assert signal(Band(), some).effort_step == (0.1, 0.3)
    # what a model says goes first
    assert signal(Band(effort_step=(0.2, 0.2)), some).effort_step == (0.2, 0.2)
    with pytest.raises(ConfigError, match=r"signal.effort_step of the map has 2 numbers for 3"):
        hil.from_arrays(frame, map={"signal": {"effort_step": [0.1, 0.2]}})
