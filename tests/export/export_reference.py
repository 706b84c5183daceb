"""Our evaluation of a fit, by the columns of its effects and by nothing else."""

import numpy as np


def evaluated(step, q, v, a):
    """Motor effort of a fit at states, by the columns of its effects and by nothing else."""
    result = step.result
    motion = result.problem.motions[0].at_states(q, v, a, 0 * q, 0 * q, 0 * q)
    out = np.zeros(q.shape)
    for term, where in zip(result.terms, result.slices, strict=True):
        part = term.effect.columns(motion, term.joint, term.shape) @ result.theta[where]
        if term.effect.scope.whole:
            out += part
        else:
            out[:, term.joint] += part
    return out
