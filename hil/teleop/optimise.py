"""Sensitivity-optimised design in two stages (thesis 3.3.2, paper VI).

Stage I (SO) maximises the weighted sensitivity abs(dz_t/dz_e) over eight parameters,

    c_i = theta_i (1 + corner/s), i = 1, 4, 7, 8 (c4 negative),   c_2, c_3, c_5, c_6 numbers

with kp theta_1, theta_4 / kp, kf theta_2 and theta_3 / kf where motion or force is scaled,

under tracking in free space and in contact, stability for every passive operator and every
environment of a bounded set, existence of the force-sensor-free form, and bounds.  Stage II
(SOFSF) is `force_sensor_free.transform` of the result.  Sensitivity above 1 is feasible in the
linear model unless bounds exclude it: the bounds are part of the design, and every active one is
named.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.optimize import NonlinearConstraint, minimize

from hil.errors import ConfigError
from hil.teleop import hybrid, passivity
from hil.teleop.architecture import IDEAL, Design, MotionTerm, Realisation, RobotImpedance
from hil.teleop.hybrid import GEL, HAND, FloatArray, Impedance
from hil.teleop.summary import band, tracking, weighted

#: theta in this order; c4 enters with a minus.
ORDER = ("c1", "c2", "c3", "c4", "c5", "c6", "c7", "c8")
_FORCES = np.array([False, True, True, False, True, True, False, False])


_POSITIVE = ("stiffness", "force", "corner", "free", "contact")


@dataclass(frozen=True)
class DesignProblem:
    """What a design must do.

    Parameters
    ----------
    master, slave : Robot
        Controlled robots.
    environment, operator : Impedance
        Where the sensitivity is taken; for the pole check.
    largest : Impedance
        Edge of the bounded set of environments: every passive z_e with abs(z_e) below its size.
    stiffness, force : float
        Largest k of a motion term [N/m], largest force gain (all at least 0).
    corner : float
        k / b of the motion terms [rad/s].
    free, contact : float
        Largest tracking error to 1 Hz in free space and against the environment.
    kappa : float
        Largest condition number of Q; infinite = no force-sensor-free form is asked for.
    real : Realisation
        Filters and delays.
    weight : float
        Exponent of the sensitivity's weight w^n; see `hil.teleop.summary.weighted`.
    motion_scale, force_scale : float
        kp and kf: v_s = kp v_m and f_m = kf f_s are the goals.
    """

    master: RobotImpedance = field(default_factory=lambda: RobotImpedance(0.3))
    slave: RobotImpedance = field(default_factory=lambda: RobotImpedance(0.3))
    environment: Impedance = GEL
    operator: Impedance = HAND
    largest: Impedance = Impedance(0.0, 6.0, 1500.0)  # noqa: RUF009
    stiffness: float = 300.0
    force: float = 1.0
    corner: float = 15.0
    free: float = 0.2
    contact: float = 0.6
    kappa: float = 1.5
    real: Realisation = IDEAL
    weight: float = 0.0
    motion_scale: float = 1.0
    force_scale: float = 1.0

    def __post_init__(self) -> None:
        for name in (*_POSITIVE, "motion_scale", "force_scale"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise ConfigError(
                    f"optimised design: {name} = {getattr(self, name)}; bounds, tolerances and "
                    "scales must be positive and finite"
                )
        if self.kappa <= 1.0:
            raise ConfigError(f"optimised design: kappa = {self.kappa:.3g} must exceed 1")
        if not abs(self.weight) <= 4.0:
            raise ConfigError(
                f"optimised design: weight = {self.weight:g}; the exponent n of the weight w^n "
                "lies within -4 and 4"
            )

    def bounds(self) -> FloatArray:
        """Upper bounds of theta, (8,): [N s/m] or 1."""
        return np.where(_FORCES, self.force, self.stiffness / self.corner)


#: Re z_t kept [N s/m], for what lies between the frequencies of the search.
_STABILITY_MARGIN = 0.03
#: Points of the search from end to end of the band of the sensitivity.
_POINTS = 21
#: Frequencies of the last look [rad/s].
_FINE: FloatArray = np.geomspace(0.1, 1000.0, 600)


class DesignSearch:
    """Grids and bounds of one problem; x = theta / bounds in [0, 1]."""

    def __init__(self, p: DesignProblem) -> None:
        self.p, self.top = p, p.bounds()
        self.w, self.slow = band(_POINTS), 2 * np.pi * np.geomspace(0.05, 1.0, 8)
        self.watch(np.geomspace(0.1, 1000.0, 60))

    def watch(self, wide: FloatArray) -> None:
        """Frequencies at which stability is demanded [rad/s]."""
        self.wide, p = wide, self.p
        self.s = hybrid.jw(np.concatenate([self.w, self.slow, self.wide]))
        self.ends = np.cumsum([self.w.size, self.slow.size])
        self.largest = np.abs(p.largest(hybrid.jw(self.wide)))

    def design(self, x: FloatArray) -> Design:
        """Controller of scaled parameters."""
        t, c = x * self.top, self.p.corner
        v = dict(zip(ORDER, t.tolist(), strict=True))
        one, kp, kf = MotionTerm(c, 1.0), self.p.motion_scale, self.p.force_scale
        return Design(
            c1=one * (kp * v["c1"]),
            c4=one * (-v["c4"] / kp),
            c7=one * v["c7"],
            c8=one * v["c8"],
            c2=kf * v["c2"],
            c3=v["c3"] / kf,
            c5=v["c5"],
            c6=v["c6"],
            master=self.p.master,
            slave=self.p.slave,
            name="optimised",
            motion_scale=kp,
            force_scale=kf,
        )

    def refine(self, x: FloatArray) -> bool:
        """Whether stability fails between the frequencies; those where it does are added."""
        with np.errstate(all="ignore"):  # a design without a matrix is refused later
            h = hybrid.hybrid(self.design(x), hybrid.jw(_FINE), self.p.real)
            least = passivity.half_disc(h, np.abs(self.p.largest(hybrid.jw(_FINE))))
        bad = _FINE[(least < 0.0) & np.isfinite(least)]
        new = bad[:: max(1, bad.size // 6)]
        if new.size:
            self.watch(np.unique(np.concatenate([self.wide, new])))
        return bool(new.size)

    def sensitivity(self, x: FloatArray) -> float:
        """sigma_c: 1 is transparent, as dz_t/dz_e = kp kf."""
        h = hybrid.hybrid(self.design(x), hybrid.jw(self.w), self.p.real)
        ze = self.p.environment(hybrid.jw(self.w))
        goal = self.p.motion_scale * self.p.force_scale
        return weighted(hybrid.sensitivity(h, ze), self.w, self.p.weight) / goal

    def constraints(self, x: FloatArray) -> dict[str, FloatArray]:
        """Slacks, positive = met, each scaled to about 1."""
        p, d = self.p, self.design(x)
        h = hybrid.hybrid(d, self.s, p.real)
        slow, wide = h[self.ends[0] : self.ends[1]], h[self.ends[1] :]
        touch = tracking(slow, p.environment(hybrid.jw(self.slow)), p.motion_scale)
        least = passivity.half_disc(wide, self.largest)
        chi = hybrid.characteristic(
            d, p.operator, p.environment, replace(p.real, forward_s=0.0, backward_s=0.0)
        )
        pole = float(np.roots(chi.num).real.max())
        q = {} if np.isinf(p.kappa) else {"fsf": np.array([1 - _condition_ratio(d, p.kappa)])}
        return {
            "free tracking": 1 - tracking(slow, 0.0, p.motion_scale) / p.free,
            "contact tracking": 1 - touch / p.contact,
            "stability": (np.maximum(least, -20.0) - _STABILITY_MARGIN) / 10.0,
            "poles": np.array([-(pole + 0.5) / 10.0]),
            **q,
        }

    def flat(self, x: FloatArray) -> FloatArray:
        """All slacks in one row."""
        return np.concatenate(list(self.constraints(x).values()))

    def worst(self, x: FloatArray) -> tuple[str, float]:
        """Constraint that is nearest to failing, or fails most, and its slack."""
        with np.errstate(all="ignore"):  # as in `refine`
            slack = {n: float(v.min()) for n, v in self.constraints(x).items()}
        name = min(slack, key=lambda n: slack[n])
        return name, slack[name]


def _condition_ratio(d: Design, limit: float) -> float:
    """(kappa + 1/kappa) / (limit + 1/limit): smooth, above 1 too close to the singularity."""
    a = np.array([[1 + d.c6, d.c2], [d.c3, 1 + d.c5]])
    size = float((a**2).sum()) / max(float(np.linalg.det(a)), 1e-6)
    return size / (limit + 1 / limit)


#: A constraint is active within this slack (each is scaled to about 1).
_ACTIVE = 2e-3


@dataclass(frozen=True)
class Active:
    """A constraint that stops the design from being better.

    Parameters
    ----------
    name, text : str
        What it is, and what it says here.
    price : float
        Estimated gain of sensitivity per unit of (scaled) relaxation.
    """

    name: str
    text: str
    price: float


def _active_constraints(search: DesignSearch, x: FloatArray) -> tuple[Active, ...]:
    """Constraints and bounds that bind, with their prices from the stationarity conditions."""
    slack = {n: v for n, v in search.constraints(x).items() if v.min() < _ACTIVE}
    rows: list[tuple[str, str, FloatArray]] = []
    for name in slack:
        rows.append((name, _reason(search, x, name), _gradient(search, x, name)))
    for i, name in enumerate(ORDER):
        edge = np.eye(8)[i]
        if x[i] > 1 - _ACTIVE:
            rows.append((f"{name} upper", f"{name} at its bound {search.top[i]:.4g}", -edge))
        elif x[i] < _ACTIVE:
            rows.append((f"{name} lower", f"{name} at 0: its sign is fixed", edge))
    if not rows:
        return ()
    # grad sigma + sum price grad g = 0
    uphill = _slope(search.sensitivity, x)
    prices = np.linalg.lstsq(np.stack([r[2] for r in rows], 1), -uphill, rcond=None)[0]
    out = [Active(n, t, float(p)) for (n, t, _), p in zip(rows, prices, strict=True)]
    return tuple(sorted(out, key=lambda a: -a.price))


def _reason(search: DesignSearch, x: FloatArray, name: str) -> str:
    p, values = search.p, search.constraints(x)[name]
    at = int(values.argmin())
    hz = (search.slow if "tracking" in name else search.wide) / (2 * np.pi)
    return {
        "free tracking": f"free tracking error reaches {p.free:g} at {hz[at % 8]:.2g} Hz",
        "contact tracking": f"contact tracking error reaches {p.contact:g} at {hz[at % 8]:.2g} Hz",
        "stability": f"Re z_t reaches {_STABILITY_MARGIN:g} N s/m at {hz[at % hz.size]:.3g} Hz",
        "poles": "the slowest pole reaches -0.5 rad/s",
        "fsf": f"the condition of Q reaches {p.kappa:g}: estimation singularity",
    }[name]


def _gradient(search: DesignSearch, x: FloatArray, name: str) -> FloatArray:
    at = int(search.constraints(x)[name].argmin())
    return _slope(lambda v: float(search.constraints(v)[name][at]), x)


def _slope(f: Callable[[FloatArray], float], x: FloatArray) -> FloatArray:
    """Gradient by differences that stay within the bounds, (8,)."""
    step = 1e-5
    ahead, behind = np.minimum(x + step, 1.0), np.maximum(x - step, 0.0)
    out = np.empty(8)
    for i in range(8):
        up, down = x.copy(), x.copy()
        up[i], down[i] = ahead[i], behind[i]
        out[i] = (f(up) - f(down)) / (ahead[i] - behind[i])
    return out


#: How often a search is taken up again, with the frequencies at which it failed.
_REFINEMENTS = 4
_BOX = [(0.0, 1.0)] * 8
_OPTIONS = {"maxiter": 60, "ftol": 1e-5, "eps": 1e-6}


@dataclass(frozen=True)
class OptimisedDesign:
    """An optimised design.

    Parameters
    ----------
    design : Design
        Stage I; its force-sensor-free form is `force_sensor_free.transform(design)`.
    theta : tuple of 8 floats
        Parameters, for a warm start.
    sensitivity : float
        Weighted sensitivity sigma_c.
    active : tuple of Active
        What binds, the most expensive first.
    starts, agreeing : int
        Searches made, and how many ended within 1 % of the best.
    """

    design: Design
    theta: tuple[float, ...]
    sensitivity: float
    active: tuple[Active, ...]
    starts: int
    agreeing: int


def optimise(
    problem: DesignProblem, start: tuple[float, ...] | None = None, starts: int = 8, seed: int = 0
) -> OptimisedDesign:
    """Maximise the sensitivity.

    Parameters
    ----------
    problem : Problem
        Task and bounds.
    start : tuple of 8 floats, optional
        `OptimisedDesign.theta` of a neighbouring problem: one search from there (fast enough for a
        re-design on line).
    starts, seed : int
        Searches from random points, without `start`.

    Raises
    ------
    ConfigError
        If no start leads to a feasible design; it names the constraint that fails least.
    """
    search, rng = DesignSearch(problem), np.random.default_rng(seed)
    first = (
        [np.clip(np.array(start) / search.top, 0.0, 1.0)]
        if start is not None
        else [
            np.array([1.0, 0.4, 0.1, 0.6, 0.1, 0.0, 1.0, 1.0]),
            *rng.uniform(0.0, 1.0, (max(starts - 1, 0), 8)),
        ]
    )
    ends = [_maximise(search, x) for x in first]
    good = [(search.sensitivity(x), x) for x in ends if search.worst(x)[1] > -1e-3]
    if not good:
        closest = max((search.worst(x) for x in ends), key=lambda r: r[1])
        raise ConfigError(
            f"no design meets all constraints; nearest miss: {closest[0]!r} by "
            f"{-100 * closest[1]:.3g} % of its scale; relax it, or allow larger gains "
            f"(stiffness {problem.stiffness:g} N/m, force {problem.force:g})"
        )
    best, x = max(good, key=lambda r: r[0])
    agreeing = sum(value > 0.99 * best for value, _ in good)
    theta = tuple(float(v) for v in x * search.top)
    return OptimisedDesign(
        search.design(x), theta, best, _active_constraints(search, x), len(first), agreeing
    )


def _maximise(search: DesignSearch, x: FloatArray) -> FloatArray:
    """Sequential quadratic programming on scaled parameters; grid refined where it was passed."""
    climb: Any = minimize
    for _ in range(_REFINEMENTS):
        with np.errstate(all="ignore"):  # the search may pass through designs without a matrix
            found = climb(
                lambda v: -search.sensitivity(v),
                x,
                method="SLSQP",
                bounds=_BOX,
                constraints=NonlinearConstraint(search.flat, 0.0, np.inf),
                options=_OPTIONS,
            )
        x = np.asarray(np.clip(found.x, 0.0, 1.0), np.float64)
        if not search.refine(x):
            break
    return x
