"""Map arithmetic."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.record.mapfile import builtin_maps, parse_map, read_map

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
