"""What `hil bench identify` compares with: plain numpy and Pinocchio, and FIGAROH."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.bench import arm
from hil.errors import ConfigError
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
#: Eigenvalues of the scaled normal equations below this share of the largest are rounding.
RANK = 1e-12
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def regressor(data: arm.Data) -> FloatArray:
    """Regressor (n, 3, 42) at every sample: bodies, rotor inertia, Coulomb, viscous, offset."""
    import pinocchio as pin

    model = pin.buildModelFromXML(arm.urdf())
    work = model.createData()
    n, d = data.q.shape
    x = np.zeros((n, d, 10 * d + 4 * d))
    for k in range(n):
        x[k, :, : 10 * d] = pin.computeJointTorqueRegressor(
            model, work, data.q[k], data.qd[k], data.qdd[k]
        )
    for j in range(d):
        first = 10 * d + 4 * j
        x[:, j, first] = data.qdd[:, j]
        x[:, j, first + 1] = np.sign(data.qd[:, j])
        x[:, j, first + 2] = data.qd[:, j]
        x[:, j, first + 3] = 1.0
    return x


def reference(data: arm.Data) -> FloatArray:
    """All 42 parameters by normal equations at the full rate, from the exact motion."""
    x = regressor(data).reshape(data.tau.size, -1)
    gram, right = x.T @ x, x.T @ data.tau.reshape(-1)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    value, vector = np.linalg.eigh(gram / np.outer(scale, scale))
    keep = value > RANK * value[-1]
    theta: FloatArray = vector[:, keep] @ ((vector[:, keep].T @ (right / scale)) / value[keep])
    return theta / scale


def heldout_of_reference(theta: FloatArray, test: arm.Data) -> FloatArray:
    """Rms error (3,) on another run at the full rate [N m]."""
    return rms(test.tau - regressor(test) @ theta)


def heldout_of_fit(result: FitResult, test: arm.Data) -> FloatArray:
    """The same of a fitted model of hil."""
    nothing = np.zeros_like(test.q)
    motion = replace(
        result.problem.motions[0], t=test.t, q=test.q, qd=test.qd, qdd=test.qdd, tau=test.tau,
        tau_ext=nothing, load=nothing, static=nothing, average=0.0,
    )  # fmt: skip
    effort = np.zeros_like(test.tau)
    for term, where in zip(result.terms, result.slices, strict=True):
        part = term.effect.columns(motion, term.joint, term.shape) @ result.theta[where]
        if term.effect.scope.whole:
            effort += part
        else:
            effort[:, term.joint] += part
    return rms(test.tau - effort)


def rms(x: FloatArray) -> FloatArray:
    """Root mean square of each column."""
    out: FloatArray = np.sqrt(np.mean(x**2, axis=0))
    return out


def timed(call: Callable[[], Any]) -> tuple[float, float]:
    """Processor time and wall clock of a call [s]."""
    start, clock = time.process_time(), time.perf_counter()
    call()
    return time.process_time() - start, time.perf_counter() - clock


def child(
    words: list[str], python: str = sys.executable, limits: dict[str, str] = ONE_THREAD
) -> dict[str, Any]:
    """Result of a script in a process of its own.

    Parameters
    ----------
    words : list of str
        What the interpreter is given.
    python : str
        The interpreter.
    limits : dict of str
        Environment variables that say how many threads it may have; one, if not given.

    Raises
    ------
    ConfigError
        If it fails.
    """
    environment = {**os.environ, **limits}
    done = subprocess.run(
        [python, *words], capture_output=True, text=True, env=environment, check=False
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ConfigError(f"{Path(words[0]).name} ended with code {done.returncode}: {last}")
    out: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return out


def figaroh(folder: Path, repeats: int, python: str) -> dict[str, Any] | str:
    """FIGAROH on train.npz and test.npz in a folder, or why it could not run."""
    if not python and importlib.util.find_spec("figaroh") is None:
        return "not installed (pip install 'hil-teleop[bench]', or --figaroh PYTHON)"
    script = str(Path(__file__).with_name("figaroh_peer.py"))
    try:
        return child([script, str(folder), str(repeats)], python or sys.executable)
    except (ConfigError, OSError) as error:
        return f"did not run: {error}"
