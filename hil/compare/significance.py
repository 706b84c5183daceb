"""Whether an effect's coefficients differ from zero beyond chance, all of them together.

With coefficients b (m,) and their covariance V from the scatter over G blocks of time,

    T^2 = b' V^-1 b,    T^2 (G - m) / (m (G - 1)) ~ F(m, G - m)

where all of them are zero.  Detection asks how much of the residual a candidate explains; a wave
that is there in a few blocks and not in the others explains much, and is no law.

Source: Hotelling, Ann. Math. Stat. 2, 1931; Liang and Zeger, Biometrika 73, 1986 (covariance).
"""

from __future__ import annotations

import numpy as np
from scipy.stats import f

from hil.compare.detect import LEVEL
from hil.identify.blocks import time_blocks
from hil.identify.regression import cluster_covariance
from hil.identify.result import FitResult

#: Blocks, beside one for each coefficient, from which their scatter says anything: of three blocks
#: not even coefficients of ten standard errors are more than chance.
FEWEST = 10


def by_chance(result: FitResult, key: tuple[str, int]) -> bool:
    """Whether an effect (name, joint) of a fit may as well be none."""
    return chance(result, key) > LEVEL


def chance(result: FitResult, key: tuple[str, int]) -> float:
    """Probability that coefficients that are zero would look as large.

    Shape values are taken as they are: a share and a delay trade off, and the effect is there all
    the same.

    Parameters
    ----------
    result : FitResult
        The fit.
    key : (str, int)
        Effect and joint.

    Returns
    -------
    float
        0 where the fit has no such term, or fewer blocks than the test needs.
    """
    number = next((k for k, t in enumerate(result.terms) if t.key == key), None)
    blocks = time_blocks(result.problem)
    if number is None:
        return 0.0
    where = result.slices[number]
    count, m = int(blocks.max()) + 1, where.stop - where.start
    if count - m < FEWEST:
        return 0.0
    weighted = (result.residual / result.sigma[:, None]).reshape(-1)
    every = cluster_covariance(weighted, result.basis, np.tile(blocks, result.problem.d))
    own, b = every[where, where], result.theta[where]
    size = np.sqrt(np.diag(own))
    if not np.all(size > 0):
        return 0.0
    inverse = np.linalg.pinv(own / np.outer(size, size), hermitian=True)
    # T^2 = b' V^-1 b
    square = float((b / size) @ inverse @ (b / size))
    return float(f.sf(square * (count - m) / (m * (count - 1)), m, count - m))
