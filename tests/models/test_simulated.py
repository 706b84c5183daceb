"""Every effect that follows the simulated state can be simulated, in each of its forms."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_effects import motion_of

from hil.identify.design import Term
from hil.identify.multistep import Windows, _Forward
from hil.models import catalogue
from hil.models.effect import Trait, terms_of
from hil.models.robots import IndependentAxes

WINDOWS = 7
MOTION = motion_of(IndependentAxes(("a", "b")), n=60)
SIMULATED = [
    name
    for name, effect in sorted(catalogue.table().items())
    if Trait.REPLAYED not in effect.traits and not effect.scope.lacks(MOTION, 1)
]


@pytest.mark.parametrize("name", SIMULATED)
def test_loads_are_those_of_the_windows(name):
    motion, effect = MOTION, catalogue.get(name)
    load = np.stack([motion.load, motion.static, motion.tau], axis=1)[:WINDOWS]
    shapes = effect.search.grid(motion, 1) or [()]
    for shape in {shapes[0], shapes[-1]}:
        term, m = Term(effect, 1, shape=tuple(shape)), len(terms_of(effect, motion, 1))
        result = SimpleNamespace(terms=[term], theta=np.ones(m), slices=[slice(0, m)])
        q, job = motion.q[:WINDOWS], Windows(result, np.arange(WINDOWS), 1)
        model = _Forward([job], motion, np.zeros(WINDOWS, dtype=int))
        assert model.effort(q, q, 0 * q[None], load).shape == (1, *q.shape)
