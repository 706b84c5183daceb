"""Formulas of effects: the same numbers as their columns, and nothing but what is allowed."""

from dataclasses import replace

import numpy as np
import plants
import pytest

from hil.errors import ConfigError
from hil.identify.problem import of_model
from hil.models import catalogue, formula
from hil.models.effect import Trait, terms_of
from hil.models.model import base_model
from hil.models.parts import JOINT
from hil.record.recording import Recording
from hil.testing.effects import sample_motions

DECLARED = sorted(name for name, e in catalogue.table().items() if e.doc.formulas)


def states(motion):
    """The same states without averaging of signs, which belongs to a recording."""
    return motion.at_states(motion.q, motion.qd, motion.qdd, motion.load, motion.static, motion.tau)


def test_the_base_model_but_for_its_bodies_has_formulas():
    assert {"coulomb", "viscous", "armature", "torque-offset"} <= set(DECLARED)


@pytest.mark.parametrize("name", DECLARED)
def test_a_formula_gives_the_columns(name):
    effect, tried = catalogue.get(name), 0
    for _, given in sample_motions(60):
        motion = states(given)
        for j in range(motion.d):
            if effect.scope.lacks(motion, j):
                continue
            low, high = motion.span[j]
            for shape in effect.search.grid(motion, j):
                by_name = dict(zip([p.name for p in effect.shape], shape, strict=True))
                k = int(by_name.get(JOINT, j + 1)) - 1
                values = {"q": motion.q[:, j], "v": motion.qd[:, j], "a": motion.qdd[:, j]}
                values |= {"low": low, "high": high, "v0": motion.v0[j], "v0k": motion.v0[k]}
                values |= {"qk": motion.q[:, k], "vk": motion.qd[:, k]} | by_name
                columns = effect.columns(motion, j, shape)
                texts = {p.name: x for p, x in zip(effect.params, effect.doc.formulas, strict=True)}
                held = [texts[p.name] for p in terms_of(effect, motion, j)]
                for text, column in zip(held, columns.T, strict=True):
                    if "v0" in by_name and not by_name["v0"]:
                        continue
                    if high - low < 1e-9 and "high - low" in text:
                        continue  # a joint that never moved has no span to scale by
                    found = formula.evaluate(text, values)
                    np.testing.assert_allclose(found + 0 * column, column, rtol=1e-10, atol=1e-11)
                    tried += 1
    assert tried


@pytest.mark.parametrize(
    "text",
    ["__import__('os')", "q.real", "q[0]", "lambda: q", "open(q)", "sin(x=q)", "q if v else a"],
)
def test_what_is_no_formula_is_refused(text):
    with pytest.raises(ConfigError, match="formula"):
        formula.parsed(text)


def test_a_name_without_a_value_is_named():
    with pytest.raises(ConfigError, match="no value of vs"):
        formula.written("exp(v / vs)", {}, {"v": "v[0]"})


def test_numbers_keep_all_their_digits():
    k = -1.0 / 3.0
    text = formula.written("k * q", {"k": k}, {"q": "q"})
    assert text == f"(({k!r}) * q)" and float(text[2:].partition(")")[0]) == k


def arm(units):
    """Three joints of which nothing is known, all of which move."""
    names = tuple(f"joint{k}" for k in range(1, 4))
    rng, t = np.random.default_rng(5), np.arange(400) * 0.01
    q = np.stack([np.sin((k + 1.3) * t + k) for k in range(3)], axis=1)
    given = Recording("arm", "arm", names, t, q, rng.normal(size=q.shape), robot=plants.SINGLE)
    run = replace(given, metadata={"unit": units})
    return of_model([run], base_model(run.robot)).motions[0]


@pytest.mark.parametrize("units", ["rad rad rad", "rad m rad", "m m rad"])
def test_laws_of_an_unknown_geometry_are_their_formulas(units):
    """Chains and loops: columns are built from factors, exports from the texts."""
    motion, tried = arm(units), 0
    q, v, a = motion.q, motion.qd, motion.qdd
    values = formula.states(3, lambda k: q[:, k], lambda k: v[:, k], lambda k: a[:, k])
    for effect in (e for e in catalogue.table().values() if Trait.GEOMETRY in e.traits):
        for j in range(3):
            texts = effect.scope.formulas(motion, j)
            columns = effect.columns(motion, j, ())
            assert columns.shape[1] == len(texts)
            for column, text in zip(columns.T, texts, strict=True):
                np.testing.assert_array_equal(column, formula.evaluate(text, values))
                tried += 1
    assert tried > 100
