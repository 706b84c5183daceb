"""One fitted arm for all targets, with effects that only some of them can express."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from plants import spatial

from hil.export import target
from hil.export.target import Job, within
from hil.models.model import Use, base_model


def session(seed):
    """The arm with a Stribeck rise on its first joint, a spring, and a ripple on its last."""
    run = spatial(seed, 6.0, offset=0.1)
    speed = np.gradient(run.q[:, 0], run.t)
    tau = run.tau.copy()
    tau[:, 0] += 0.8 * np.exp(-((speed / 0.3) ** 2)) * np.sign(speed)
    tau[:, 1] += 1.5 * run.q[:, 1]
    tau[:, 2] += 0.2 * np.sin(2 * np.pi * 2.0 * run.q[:, 2])
    return replace(run, tau=tau)


@pytest.fixture(scope="session")
def arm():
    """Two runs and a model of them."""
    one, two = session(1), session(2)
    model = base_model(one.robot) + Use("spring", ("upper",)) + Use("stribeck", ("base",))
    model = model + Use("cogging", ("fore",))
    return SimpleNamespace(run=one, other=two, model=model)


@pytest.fixture(scope="session")
def made(arm):
    """What each target makes of it, once; targets that say the same share a fit."""
    known, fitted = {}, {}

    def once(model, words, *rest):
        key = words.bodies, words.columns
        if key not in fitted:
            fitted[key] = within(model, words, *rest)
        return fitted[key]

    def make(name):
        if name not in known:
            job = Job(arm.model, Path("arm.toml"), "arm", [arm.run], [arm.other], True)
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(target, "within", once)
                known[name] = target.get(name).make(job)
        return known[name]

    return make


@pytest.fixture(scope="session")
def states():
    """States (n, 3) at which dry friction is past its reversal in any program's law."""
    rng = np.random.default_rng(5)
    q = rng.uniform(-1.0, 1.0, (40, 3))
    v = rng.uniform(0.5, 2.0, (40, 3)) * rng.choice([-1.0, 1.0], (40, 3))
    return q, v, rng.uniform(-4.0, 4.0, (40, 3))
