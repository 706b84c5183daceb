"""Without force sensors: the estimation singularity, the FSF transformation, Class II estimates.

The closed loop is Q f + R v = 0 with f = (f_m, f_s), v = (v_m, -v_s).  Estimating the forces
is solving it, f_hat = -Q^-1 R v, which needs det Q = -D != 0.  Every transparent controller
has D = 0: perfect transparency and force estimation exclude each other (thesis 4.2.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hil.errors import ConfigError
from hil.teleop.architecture import FORCE_GAINS, Design, require_finite
from hil.teleop.hybrid import ComplexArray, FloatArray

#: Condition number of Q from which the transformed loop is refused (comfortable up to 3):
#: with a sample of delay and usual filters it is stable for 1/kappa >= 0.18 and unstable at 0.05.
_REFUSED = 9.0


def q_matrix(design: Design) -> FloatArray:
    """Q = [[1 + c6, -c2], [c3, -(1 + c5)]], shape (2, 2); of finite gains."""
    require_finite(design)
    return np.array([[1 + design.c6, -design.c2], [design.c3, -(1 + design.c5)]])


def conditioning(design: Design) -> float:
    """kappa(Q) = s_max / s_min; infinite at the singularity.

    1 / kappa is the relative distance in the 2-norm to the nearest singular Q (Eckart, Young).
    """
    values = np.linalg.svd(q_matrix(design), compute_uv=False)
    return float(values[0] / values[1]) if values[1] > 1e-15 * values[0] else float("inf")


def loop_gains(design: Design) -> ComplexArray:
    """Eigenvalues lambda of [[1 + c6, c2], [c3, 1 + c5]], shape (2,); their product is D.

    1 / lambda are the eigenvalues of M^-1 M_app, the apparent masses of the transformed loop.
    """
    a = np.array([[1 + design.c6, design.c2], [design.c3, 1 + design.c5]])
    return np.linalg.eigvals(a).astype(complex)


def _require(design: Design, limit: float, runs: Callable[[Design], bool]) -> None:
    """Refuse a design too close to the singularity.

    Raises
    ------
    ConfigError
        Naming D, kappa, the limit, and the nearest design that works.
    """
    kappa = conditioning(design)
    if kappa <= limit and design.D > 0.0:
        return
    raise ConfigError(
        f"design {design.name!r} is too close to the force estimation singularity: D = "
        f"(1 + c5)(1 + c6) - c2 c3 = {design.D:.3g}, condition of Q {kappa:.3g}, at most "
        f"{limit:.3g} is possible"
        + (" and D must be positive" if design.D <= 0.0 else "")
        + f"; {_way_out(design, limit, runs)}; with force sensors (without --fsf) there is no "
        "such limit"
    )


def _way_out(design: Design, limit: float, runs: Callable[[Design], bool]) -> str:
    """The nearest design that works, in the digits that are said."""
    for target in limit / _STEPS:
        found = nearest(design, float(target))
        said: dict[str, Any] = {c: float(f"{getattr(found, c):.4g}") for c in FORCE_GAINS}
        near = replace(found, **said)
        good = conditioning(near) <= limit and near.D > 0.0 and min(near.c5, near.c6) >= -1.0
        if good and runs(near):
            return (
                f"the nearest design that works has c2 = {near.c2:.4g}, c3 = {near.c3:.4g}, "
                f"c5 = {near.c5:.4g}, c6 = {near.c6:.4g} (condition {conditioning(near):.3g})"
            )
    return (
        "no other c2, c3, c5, c6 near these work with its motion gains and filters; lower the "
        "stiffness, the damping and acceleration_hz"
    )


#: How far below the limit a design that works is looked for, the nearest first.
_STEPS: FloatArray = np.geomspace(1.0005, 8.9, 12)


def nearest(design: Design, limit: float = _REFUSED) -> Design:
    """Nearest design (Frobenius norm of Q) with kappa(Q) <= limit and D > 0.

    With the singular values s1 >= s2 of A = [[1 + c6, c2], [c3, 1 + c5]] = U diag(s1, s2) V^T and
    det U V^T > 0 the nearest diag is the projection of (s1, s2) on s1 = limit s2; a negative D
    counts as a negative s2.

    Raises
    ------
    ConfigError
        For gains that are not finite, and where none is nearest: Q = 0.
    """
    if not q_matrix(design).any():
        raise ConfigError(
            f"design {design.name!r} has Q = 0 (c2 = c3 = 0, c5 = c6 = -1): no force acts on an "
            "arm, and of the designs with D > 0 none is nearest; choose c5 and c6 above -1"
        )
    a = np.array([[1 + design.c6, design.c2], [design.c3, 1 + design.c5]])
    u, s, vt = np.linalg.svd(a)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        u[:, 1], s[1] = -u[:, 1], -s[1]
    if s[1] * limit < s[0]:
        # foot of the perpendicular on the line (limit, 1)
        t = (limit * s[0] + s[1]) / (limit**2 + 1)
        s = np.array([limit, 1.0]) * t * (1 + 1e-12)
        s[1] *= 1 + 1e-9
    b = u @ np.diag(s) @ vt
    return replace(
        design, c6=float(b[0, 0] - 1), c2=float(b[0, 1]), c3=float(b[1, 0]), c5=float(b[1, 1] - 1)
    )


def transform(
    design: Design, limit: float = _REFUSED, runs: Callable[[Design], bool] = lambda _: True
) -> Design:
    """Equivalent controller that measures no force: same H, same closed-loop poles.

    Two controllers are equivalent if [Q' R'] = T [Q R] with T invertible.  Q' = diag(1, -1) gives

        c1' = [c3 (z_cm + c8) + (1 + c6) c1] / D      c4' = [(1 + c5) c4 - c2 (z_cs + c7)] / D
        c7' = [(1 + c6)(z_cs + c7) - c3 c4] / D - z_cs
        c8' = [(1 + c5)(z_cm + c8) + c2 c1] / D - z_cm

    whose parts a s are the acceleration gains (thesis 3.2.3; derived in this form).

    Parameters
    ----------
    limit : float
        Largest condition of Q.
    runs : callable
        Whether a design that is proposed in place of a refused one would run, transformed.

    Raises
    ------
    ConfigError
        If it is too close to the singularity (`_require`).
    """
    _require(design, limit, runs)
    zm, zs = design.master.term, design.slave.term
    a, b, c, d = 1 + design.c6, design.c2, design.c3, 1 + design.c5
    over = 1.0 / design.D
    master, slave = zm + design.c8, zs + design.c7
    return replace(
        design,
        c1=(master * c + design.c1 * a) * over,
        c4=(design.c4 * d + -(slave * b)) * over,
        c7=(slave * a + -(design.c4 * c)) * over + -zs,
        c8=(master * d + design.c1 * b) * over + -zm,
        c2=0.0,
        c3=0.0,
        c5=0.0,
        c6=0.0,
        name=f"{design.name}-fsf",
    )


def estimate(q: FloatArray, r: FloatArray) -> FloatArray:
    """Class II estimate f_hat = -Q^-1 R(v) of (f_m, f_s) [N], shape (..., 2).

    Parameters
    ----------
    q : ndarray (2, 2)
        Force gains, away from the singularity.
    r : ndarray (..., 2)
        R(v): (f_cm0 - d_m, f_cs0 - d_s) with f_c0 the law without its force terms and d the full
        non-linear robot terms including M q'' [N].  f_s is ON the environment.
    """
    return np.asarray(-np.linalg.solve(q, r[..., None])[..., 0], np.float64)


@dataclass(frozen=True)
class Sampled:
    """Whether the acceleration loop of a transformed design survives sampling.

    Parameters
    ----------
    smallest : float
        Smallest real part of the loop gains lambda.
    bound : float
        What it must exceed: 1/2 unfiltered, alpha/2 with a first-order filter.
    """

    smallest: float
    bound: float

    @property
    def stable(self) -> bool:
        """Whether it does."""
        return self.smallest > self.bound


def sampled_condition(design: Design, acceleration_hz: float, period: float) -> Sampled:
    """Condition under which the transformed loop stays stable with one sample of delay.

    The acceleration of one sample ago, filtered by a_f += alpha (a - a_f) with
    alpha = 1 - exp(-2 pi f T), feeds back the matrix M_app - M: stable if and only if
    lambda > alpha/2 (real lambda), Re lambda > 1/2 without a filter.

    Parameters
    ----------
    acceleration_hz : float
        Corner of the acceleration filter; 0 = none.
    period : float
        Sample period [s].
    """
    alpha = 1.0 - np.exp(-2 * np.pi * acceleration_hz * period) if acceleration_hz else 1.0
    return Sampled(float(loop_gains(design).real.min()), float(alpha / 2))
