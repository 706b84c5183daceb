"""Two axes with Coulomb and viscous friction, the second with a law that the model lacks."""

import numpy as np

from hil.record.recording import Recording

LAWS = {
    "": lambda x, v, a: 0.0 * v,
    "offset": lambda x, v, a: 0.3 + 0.0 * v,
    "cogging": lambda x, v, a: 0.4 * np.sin(6 * np.pi * x),
    "stribeck": lambda x, v, a: 0.4 * np.exp(-((v / 0.1) ** 2)) * np.tanh(v / 0.01),
    "coulomb": lambda x, v, a: 0.25 * np.tanh(v / 0.01),
    "gain": lambda x, v, a: 0.15 * (0.3 * a + 0.8 * np.tanh(v / 0.01) + 0.5 * v),
}


def session(law: str, seed: int, name: str, slow: float = 1.0) -> Recording:
    """Two axes; the law acts on the second."""
    n, d = 8000, 2
    rng, t = np.random.default_rng(seed), np.arange(n) / 500.0
    tones = np.array([0.23, 0.41, 0.77, 1.1]) * slow
    q, v, a = (np.empty((n, d)) for _ in range(3))
    for j in range(d):
        w, phase = 2 * np.pi * tones * (1 + 0.07 * j), rng.uniform(0, 2 * np.pi, 4)
        size, angle = 0.25 / (tones / slow) ** 0.7, np.outer(t, w) + phase
        q[:, j] = (size * np.sin(angle)).sum(axis=1)
        v[:, j] = (size * w * np.cos(angle)).sum(axis=1)
        a[:, j] = -(size * w**2 * np.sin(angle)).sum(axis=1)
    tau = 0.3 * a + 0.8 * np.tanh(v / 0.01) + 0.5 * v + 0.02 * rng.standard_normal((n, d))
    tau[:, 1] += LAWS[law](q[:, 1], v[:, 1], a[:, 1])
    q += 1e-6 * rng.standard_normal((n, d))
    return Recording(name, "arm", ("joint1", "joint2"), t, q, tau)
