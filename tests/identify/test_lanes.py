"""Sizes of accelerations behind many filters are those behind each of them alone."""

import numpy as np
import pytest

from hil.identify.bands import acceleration_power, derivatives


@pytest.mark.parametrize(("rate", "n"), [(1000.0, 3000), (30.0, 300), (1000.0, 60)])
def test_several_filters_as_each_alone(rate: float, n: int) -> None:
    q = np.cumsum(np.random.default_rng(0).normal(size=(n, 2)), axis=0)
    cutoffs = np.geomspace(0.01, 0.3, 7) * rate
    alone = [np.mean(derivatives(q, rate, f)[2] ** 2, axis=0) for f in cutoffs]
    assert acceleration_power(q, rate, cutoffs) == pytest.approx(np.array(alone), rel=1e-10)
