"""External joint torque without a force sensor: inverse dynamics and momentum observer.

Both take a fitted model's motor torque: rigid body, friction and whatever else it holds.
tau_s acts ON the robot: M q'' + C q' + N + tau_f = tau_c + tau_s (thesis sections 3.1 and 3.3).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.identify.fit import predict
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]


def by_inverse_dynamics(result: FitResult, run: Recording) -> tuple[FloatArray, FloatArray]:
    """External joint torque of a run, tau_s = model - tau_c, from any fitted model.

    Every effect of the model counts, a user's own too, within the filter band of the fit.  Its
    errors are those of the model: friction that remains cannot be told from a force.

    Parameters
    ----------
    result : FitResult
        Fitted where nothing touched the robot.
    run : Recording
        The run in question.

    Returns
    -------
    t : ndarray (n,)
        Time [s].
    tau_s : ndarray (n, d)
        External torque ON the robot [N m]; 0 at standstill, where friction hides it.

    Raises
    ------
    ConfigError
        If the run has other joints than the fit.
    """
    fitted = result.problem
    if run.joints != fitted.joints:
        raise ConfigError(
            f"run {run.name!r} has joints {', '.join(run.joints)}, the model was fitted to "
            f"{', '.join(fitted.joints)}"
        )
    bare = replace(run, wrench=None, tau_ext=None)  # what was measured must not help
    problem = Problem([bare], fitted.source, fitted.explains, rates=fitted.rates, span=fitted.span)
    problem.align_effort(fitted.alignment)
    residual = predict(result, problem)
    return problem.t, np.asarray(-residual.T, np.float64)


@nb.njit(cache=True, nogil=True)
def _observe(p: Any, push: Any, gain: float, period: float, state: Any, r: Any) -> None:
    """One period of the momentum observer, in place.

    With p = M q' and p' = tau_c + tau_s + C^T q' - N - tau_f,

        r = K (p - p_0 - int(tau_c + C^T q' - N - tau_f + r) dt)   =>   r' = K (tau_s - r):

    tau_s through a first-order low-pass of corner K [rad/s]; the integral advances implicitly,
    so that any K is stable.

    Parameters
    ----------
    p, push : ndarray (d,)
        Momentum [N m s], tau_c + C^T q' - N - tau_f [N m].
    gain, period : float
        K [rad/s], sample period [s].
    state : ndarray (1 + d,)
        Started; integral minus p_0 [N m s].
    r : ndarray (d,)
        Written: estimate of tau_s [N m].
    """
    for i in range(p.size):
        if state[0] == 0.0:
            state[1 + i] = p[i] - period * push[i]
        # r = K (p - s - T (push + r))
        known = state[1 + i] + period * push[i]
        r[i] = gain * (p[i] - known) / (1.0 + gain * period)
        state[1 + i] = known + period * r[i]
    state[0] = 1.0


def by_momentum_observer(
    m: FloatArray, qd: FloatArray, push: FloatArray, gain: float, period: float
) -> FloatArray:
    """External torque of a record by the momentum observer, (n, d) [N m].

    Parameters
    ----------
    m : ndarray (n, d, d)
        Mass matrices.
    qd : ndarray (n, d)
        Speeds [rad/s].
    push : ndarray (n, d)
        tau_c + C^T q' - N - tau_f [N m].
    gain, period : float
        K [rad/s], sample period [s].

    Raises
    ------
    ConfigError
        If a gain or period is not positive, the arrays do not agree, or a value is not finite:
        the observer would carry it on into every later sample.
    """
    if not (0.0 < gain < np.inf and 0.0 < period < np.inf):
        raise ConfigError(
            f"momentum observer: gain = {gain} rad/s, period = {period} s; both must be positive"
        )
    _refuse_record(m, qd, push)
    p: FloatArray = np.einsum("nij,nj->ni", m, qd)
    out: FloatArray = np.zeros_like(p)
    state = np.zeros(1 + p.shape[1])
    for k in range(len(p)):
        _observe(p[k], push[k], gain, period, state, out[k])
    return out


def _refuse_record(m: FloatArray, qd: FloatArray, push: FloatArray) -> None:
    """Refuse what the kernel would read beyond, or carry on into every later sample."""
    if qd.ndim != 2 or push.shape != qd.shape or m.shape != (*qd.shape, qd.shape[1]):
        raise ConfigError(
            f"momentum observer: m has the shape {m.shape}, qd {qd.shape}, push {push.shape}; "
            "expected (n, d, d), (n, d), (n, d)"
        )
    good = [np.isfinite(x).reshape(len(qd), -1).all(axis=1) for x in (m, qd, push)]
    bad = np.flatnonzero(~np.all(good, axis=0))
    if bad.size:
        raise ConfigError(
            f"momentum observer: sample {bad[0]} of {len(qd)} holds a value that is not finite; "
            "fill it in, or observe the parts apart"
        )
