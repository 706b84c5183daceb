"""LuGre, loops beside a Stribeck curve, and a Stribeck curve alone are told apart by name."""

import numpy as np
import pytest

from hil.diagnosis.engine import diagnose
from hil.models.model import base_model
from hil.record.recording import Recording

INERTIA, VISCOUS, COULOMB, RISE, SPEED = 0.01, 0.02, 0.05, 0.04, 0.12
RATE, SUBSTEPS, SECONDS = 500, 20, 20


def motion(seed, t):
    """Position, speed and acceleration of a multisine with reversals of all sizes."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.array([0.13, 0.31, 0.83, 1.9, 3.1])
    size, phase = np.array([0.3, 0.15, 0.06, 0.03, 0.012]), rng.uniform(0, 2 * np.pi, 5)
    angle = np.outer(t, w) + phase
    return np.sin(angle) @ size, np.cos(angle) @ (size * w), -np.sin(angle) @ (size * w**2)


def peak(v):
    return RISE * np.exp(-((v / SPEED) ** 2))


def lugre(q, v, dt):
    """sigma_0 z + sigma_1 z', z' = v - sigma_0 |v| z / g(v): small steps of Euler's method."""
    stiffness, damping, z, out = 8.0, 0.05, 0.0, np.zeros(v.size)
    for k, (speed, level) in enumerate(zip(v, COULOMB + peak(v), strict=True)):
        rate = speed - stiffness * abs(speed) * z / level
        z += rate * dt
        out[k] = stiffness * z + damping * rate
    return out


def loops(q, v, dt):
    """Coulomb and Stribeck friction, and five elements that stick and slip."""
    out = (0.2 * COULOMB + peak(v)) * np.tanh(v / 2e-3)
    for width in np.array([1.5, 3.0, 5.0, 8.0, 15.0]) * 1e-3:
        z = 0.0
        for k in range(1, q.size):
            z = min(max(z + q[k] - q[k - 1], -width), width)
            out[k] += 0.16 * COULOMB * z / width
    return out


def curve(q, v, dt):
    return (COULOMB + peak(v)) * np.tanh(v / 2e-3)


def recorded(law, seed):
    fine = np.arange(SECONDS * RATE * SUBSTEPS) / (RATE * SUBSTEPS)
    q, v, a = motion(seed, fine)
    tau = INERTIA * a + VISCOUS * v + law(q, v, 1 / (RATE * SUBSTEPS))
    pick = slice(None, None, SUBSTEPS)
    noise = np.random.default_rng([seed, 1]).normal(size=(2, tau[pick].size))
    columns = (fine[pick], (q[pick] + 2e-6 * noise[0])[:, None], (tau[pick] + 1e-3 * noise[1]))
    return Recording("axis", "arm", ("a",), columns[0], columns[1], columns[2][:, None])


@pytest.mark.parametrize(
    ("law", "names", "form"),
    [
        (lugre, {"presliding"}, 2.0),
        (loops, {"presliding", "stribeck"}, 0.0),
        (curve, {"stribeck"}, None),
    ],
)
def test_each_is_named_as_what_it_is(law, names, form):
    runs = [recorded(law, seed) for seed in (1, 2)]
    out = diagnose(runs[:1], base_model(runs[0].robot), runs[1:])
    assert {f.effect for f in out.findings} == names
    if form is not None:
        values = {n.split(".")[-1]: v.value for n, v in out.findings[0].parameters.items()}
        assert values["form"] == form
    if law is lugre:
        assert values["f1"] == pytest.approx(COULOMB, rel=0.05)
        assert values["s"] == pytest.approx(COULOMB / 8.0, rel=0.1)
