"""Hybrid matrix: of a design, with what follows from it, and from data with its uncertainty.

    [f_m; -v_s] = H [v_m; f_s],   Dh = a Zs - c c4.   Transparent: H = [[0, 1], [-1, 0]].
    H = 1/Dh [[Zm Zs + c1 c4, b Zs - d c4], [-(c Zm + a c1), a d - b c]]

Of a design: transmitted impedance, sensitivity, characteristic equation, delay margin.  Thesis
sections 3.2 and 3.5; the closed form is derived from the two control laws.  From data:

    H = S_yu S_uu^-1,   y = (f_m, -v_s),   u = (v_m, f_s)

pooled over experiments whose u differ: against one linear environment v_m and f_s go together
and H is not identifiable.  Only whole periods of a periodic motion are transformed (a tapered
window would bias h12 by tens of percent); the scatter from period to period is the uncertainty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError
from hil.teleop.architecture import IDEAL, Blocks, Design, Realisation, blocks, require_finite
from hil.teleop.rational import LateLoop, Rational

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
#: Angular frequencies [rad/s] at which designs are judged.
GRID: FloatArray = np.geomspace(0.1, 2000.0, 400)


@dataclass(frozen=True)
class Impedance:
    """Operator or environment z(s) = m s + b + k / s.

    Parameters
    ----------
    m, b, k : float
        [kg], [N s/m], [N/m].
    """

    m: float = 0.0
    b: float = 0.0
    k: float = 0.0

    def __call__(self, s: Any) -> Any:
        """Value at s."""
        return self.m * s + self.b + self.k / s


#: A relaxed hand (mass 0.4 kg, 4 N s/m, 150 N/m) and a soft gel (300 N/m, 1.5 N s/m); assumptions
#: of the size that the field uses.
HAND = Impedance(0.4, 4.0, 150.0)
GEL = Impedance(0.0, 1.5, 300.0)
FREE_MOTION = Impedance()


def jw(w: Any = GRID) -> ComplexArray:
    """Points j w on the imaginary axis; w [rad/s]."""
    out: ComplexArray = 1j * np.asarray(w, float)
    return out


def _of_blocks(e: Blocks) -> tuple[Any, Any, Any, Any]:
    """h11 [N s/m], h12 [1], h21 [1], h22 [m/(N s)] from blocks."""
    # Dh = a Zs - c c4
    below = e.a * e.Zs - e.c * e.c4
    return (
        (e.Zm * e.Zs + e.c1 * e.c4) / below,
        (e.b * e.Zs - e.d * e.c4) / below,
        -(e.c * e.Zm + e.a * e.c1) / below,
        (e.a * e.d - e.b * e.c) / below,
    )


def hybrid(design: Design, s: Any, real: Realisation = IDEAL) -> ComplexArray:
    """Hybrid matrix at s (n,), shape (n, 2, 2).

    Raises
    ------
    ConfigError
        For a gain that is not finite, at s = 0, and where the ports are not determined by the
        controller: c1 c2 = c3 c4.
    """
    s = np.atleast_1d(s)
    require_finite(design)
    if not (np.isfinite(s) & (s != 0.0)).all():
        raise ConfigError(
            f"design {design.name!r}: a hybrid matrix was asked for at s = 0 or at an s that is no "
            "finite number; stiffness is k / s, so take a small s for rest, 1e-4j say"
        )
    with np.errstate(divide="ignore", invalid="ignore"):  # told below, with its reason
        parts = [np.broadcast_to(h, s.shape) for h in _of_blocks(blocks(design, s, real))]
    h = np.stack([np.stack(parts[:2], -1), np.stack(parts[2:], -1)], -2)
    if not np.isfinite(h).all():
        raise ConfigError(
            f"design {design.name!r} has no hybrid matrix: (1 + c6)(z_cs + c7) = c3 c4, so the "
            "port variables are not determined; change c4, c6 or c7"
        )
    return h


def transmitted(h: ComplexArray, ze: Any) -> ComplexArray:
    """Impedance that the operator feels, z_t = h11 - h12 h21 z_e / (1 + h22 z_e) [N s/m], (n,)."""
    ze = np.asarray(ze, complex)
    out: ComplexArray = h[..., 0, 0] - h[..., 0, 1] * h[..., 1, 0] * ze / (1 + h[..., 1, 1] * ze)
    return out


def sensitivity(h: ComplexArray, ze: Any, other: Any = None) -> ComplexArray:
    """Slope of z_t over z_e; with `other` the exact secant between two environments, (n,).

    dz_t/dz_e = -h12 h21 / (1 + h22 z_e)^2, and (z_t2 - z_t1)/(z_e2 - z_e1) with the product of
    both factors below.  Transparent: 1.
    """
    near = 1 + h[..., 1, 1] * np.asarray(ze, complex)
    far = near if other is None else 1 + h[..., 1, 1] * np.asarray(other, complex)
    out: ComplexArray = -h[..., 0, 1] * h[..., 1, 0] / (near * far)
    return out


def impedance_width(h: ComplexArray, w: FloatArray, ze_max: Impedance) -> FloatArray:
    """Width of transmitted impedance |z_t(z_e max) - z_t(0)| [N s/m], (n,).

    What the operator can feel at all: the difference between free space and the stiffest world.
    """
    wide: FloatArray = np.abs(transmitted(h, ze_max(jw(w))) - transmitted(h, 0.0))
    return wide


def characteristic(design: Design, zh: Impedance, ze: Impedance, real: Realisation = IDEAL) -> Any:
    """Chi = (a z_h + Zm)(d z_e + Zs) - (b z_e + c4)(c z_h - c1), a `Rational` [(N s/m)^2].

    For f_m = -z_h v_m and f_s = z_e v_s, without delay; its zeros are the poles of the closed loop.
    """
    ahead, around = _ahead_and_around(design, zh, ze, real)
    return ahead - around


def _ahead_and_around(
    design: Design, zh: Impedance, ze: Impedance, real: Realisation
) -> tuple[Any, Any]:
    """Both products of the characteristic equation, rational in s."""
    s = Rational.s()
    e = blocks(design, s, real)
    h, n = zh(s), ze(s)
    return (e.a * h + e.Zm) * (e.d * n + e.Zs), (e.b * n + e.c4) * (e.c * h - e.c1)


def poles(
    design: Design, zh: Impedance = HAND, ze: Impedance = GEL, real: Realisation = IDEAL
) -> ComplexArray:
    """Poles of the closed loop with operator and environment [rad/s], the rightmost first.

    With a delay there is no end of them: those that matter, and all right of the imaginary axis,
    which are counted; see `hil.teleop.rational.LateLoop`.

    Raises
    ------
    ConfigError
        For a number that is not finite, and where a delay leaves the poles unsure.
    """
    _known(design, zh, ze)
    delay = real.forward_s + real.backward_s
    if delay > 0.0:
        return _late(design, zh, ze, real).roots(delay)
    return Rational.zeros(characteristic(design, zh, ze, real))


def delay_margin(
    design: Design, zh: Impedance = HAND, ze: Impedance = GEL, real: Realisation = IDEAL
) -> float:
    """Longest additional round-trip delay for which the closed loop stays stable [s].

    Forward and backward channels meet in one loop: chi = P - L exp(-s T) with
    P = (a z_h + Zm)(d z_e + Zs), L = (b z_e + c4)(c z_h - c1).  A root crosses the axis at w
    with |L / P| = 1 once w T = arg(L / P) + 2 pi n; the smallest such T > 0 is the margin.
    Exact at any delay that is there already: its crossings are counted from none on.

    Returns
    -------
    float
        Infinite where no delay destabilises, 0 where the loop is unstable already, drifts freely,
        or bears no delay at all (a gain around it of 1 or more at the highest frequencies).
    """
    _known(design, zh, ze)
    return _late(design, zh, ze, real).margin(real.forward_s + real.backward_s)


def _late(design: Design, zh: Impedance, ze: Impedance, real: Realisation) -> LateLoop:
    """The loop for any delay."""
    now = replace(real, forward_s=0.0, backward_s=0.0)
    corners = [2 * np.pi * hz for hz in (real.velocity_hz, real.acceleration_hz, real.force_hz)]
    ahead, around = _ahead_and_around(design, zh, ze, now)
    return LateLoop.of(ahead, around, sorted({w for w in corners if w}))


def _known(design: Design, zh: Impedance, ze: Impedance) -> None:
    """Refuse a design, an operator or an environment with a number that is not finite."""
    require_finite(design)
    for what, z in (("operator", zh), ("environment", ze)):
        if not np.isfinite([z.m, z.b, z.k]).all():
            raise ConfigError(
                f"{what}: m = {z.m:g} kg, b = {z.b:g} N s/m, k = {z.k:g} N/m; finite numbers are "
                "needed"
            )


#: Condition of the pooled input spectrum above which H is not determined.
_CONDITION_LIMIT = 30.0


@dataclass(frozen=True)
class Experiment:
    """One axis of one run over whole periods.

    Parameters
    ----------
    vm, fm, vs, fs : ndarray (n,)
        Speeds [m/s], operator's force ON the master, slave's force ON the environment [N].
    periods : int
        Periods in the record; n must be a multiple.
    period : float
        Sample period [s].
    """

    vm: FloatArray
    fm: FloatArray
    vs: FloatArray
    fs: FloatArray
    periods: int
    period: float

    def __post_init__(self) -> None:
        for name in ("vm", "fm", "vs", "fs"):
            values = np.asarray(getattr(self, name))
            if values.ndim != 1 or values.size != self.vm.size:
                raise DataError(
                    f"{name} has shape {values.shape} and vm {np.shape(self.vm)}; one row each of "
                    "the same length is needed"
                )
            if not np.isfinite(values).all():
                bad = int(np.sum(~np.isfinite(values)))
                raise DataError(
                    f"{name} has {bad} of {values.size} samples that are no finite number; leave "
                    "out their periods, or fill the gaps"
                )
        if self.periods < 2 or self.vm.size == 0 or self.vm.size % self.periods:
            raise DataError(
                f"{self.vm.size} samples are not {self.periods} whole periods (at least 2)"
            )

    def spectra(self, harmonic: int) -> tuple[ComplexArray, ComplexArray]:
        """Y and u of each period at a harmonic, (periods, 2) each."""
        n = self.vm.size // self.periods
        wave = np.exp(-2j * np.pi * harmonic * np.arange(n) / n) * 2 / n
        rows = np.stack([self.fm, -self.vs, self.vm, self.fs]).reshape(4, self.periods, n) @ wave
        return rows[:2].T, rows[2:].T


@dataclass(frozen=True)
class Measured:
    """Hybrid matrix at one frequency.

    Parameters
    ----------
    w : float
        [rad/s].
    h, std : ndarray (2, 2)
        Estimate (complex) and standard error of its magnitude's scatter, real and imaginary
        part together.
    condition : float
        Of the pooled input spectrum, both inputs scaled to unit size.
    """

    w: float
    h: ComplexArray
    std: FloatArray
    condition: float


def estimate_hybrid(experiments: Sequence[Experiment], harmonic: int = 1) -> Measured:
    """Hybrid matrix at one harmonic of the motion.

    Parameters
    ----------
    experiments : sequence of Experiment
        At least two that differ in their environment, with the same length of a period.
    harmonic : int
        Number of the harmonic.

    Raises
    ------
    DataError
        If there is none, or the experiments do not tell v_m and f_s apart.
    """
    if not experiments:
        raise DataError("no experiment: two at least are needed, in different environments")
    parts = [e.spectra(harmonic) for e in experiments]
    lengths = {e.vm.size // e.periods * e.period for e in experiments}
    if len(lengths) != 1:
        raise DataError("the experiments have periods of different length")
    h, condition = _solve([y.mean(0) for y, _ in parts], [u.mean(0) for _, u in parts])
    if not condition < _CONDITION_LIMIT:
        raise DataError(
            f"v_m and f_s go together in these {len(parts)} runs (condition {condition:.3g}, at "
            f"most {_CONDITION_LIMIT:g}): H is not identifiable; add a run against another "
            "environment"
        )
    # jackknife over the periods of every experiment
    variance = np.zeros((2, 2))
    for k, (y, u) in enumerate(parts):
        n, left = len(y), []
        for j in range(n):
            keep = np.arange(n) != j
            ys = [y[keep].mean(0) if i == k else a.mean(0) for i, (a, _) in enumerate(parts)]
            us = [u[keep].mean(0) if i == k else b.mean(0) for i, (_, b) in enumerate(parts)]
            left.append(_solve(ys, us)[0])
        spread = np.array(left) - np.mean(left, axis=0)
        variance += (n - 1) / n * (np.abs(spread) ** 2).sum(0)
    return Measured(2 * np.pi * harmonic / lengths.pop(), h, np.sqrt(variance), condition)


def _solve(y: list[ComplexArray], u: list[ComplexArray]) -> tuple[ComplexArray, float]:
    """H from one row (2,) per experiment, and the condition of the scaled inputs."""
    right, left = np.array(y), np.array(u)
    scale = np.maximum(np.abs(left).max(axis=0), 1e-300)
    unit = left / scale
    values = np.linalg.svd(unit, compute_uv=False)
    condition = float(values[0] / max(values[-1], 1e-300)) if len(u) > 1 else float("inf")
    h = np.linalg.lstsq(unit, right, rcond=None)[0].T / scale
    return np.asarray(h, np.complex128), condition
