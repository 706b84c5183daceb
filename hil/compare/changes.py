"""A value of the model that is another one from some instant of a run on.

A gain that was set, a screw that came loose, a load that was picked up: laws that hold throughout
can but imitate it, and the noise floor hides what no candidate explains.  So the columns x of a few
values of each joint, cut at instants s of every run, are tried beside the fit with residual r and
orthonormal columns Q:

    c = x [t > s],   gain = (c' r)^2 / (c'c - |Q'c|^2),   value = c' r / (c'c - |Q'c|^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from hil.compare.floor import ADEQUATE
from hil.identify.assemble import in_units
from hil.identify.problem import Problem
from hil.identify.projector import Projector
from hil.identify.regression import inflation
from hil.identify.result import FitResult

FloatArray = NDArray[np.float64]
#: A run and an instant of it [s].
Cut = tuple[int, float]
CODE = "changed"
#: Instants of a run that are tried, and those around the best of them.
INSTANTS, AROUND = 15, 16
#: Factor by which a change must explain more than the same throughout.
MORE = 1.1
#: False alarms a report.
LEVEL = 0.01
#: Share of a column below which it is the model's own.
NEW = 1e-4
ADVICE = (
    "a gain that was set, a screw come loose, something that leans on it? Give what was recorded "
    "before and after as two sessions"
)
#: What may change, and its unit.
VALUES = (
    ("effort at rest", "{F}"),
    ("Coulomb friction", "{F}"),
    ("viscous friction", "{F} s/{x}"),
    ("inertia", "{F} s^2/{x}"),
    ("stiffness", "{F}/{x}"),
    ("scale of all efforts", "1"),
)


@dataclass(frozen=True)
class Change:
    """One value that changed once on one joint.

    Parameters
    ----------
    joint, what, unit : str
        Joint, the value in words, its unit.
    run : str
        Name of the run.
    at : float
        Instant, since the start of the run [s]; zero where the whole run differs from others.
    value : float
        By how much it changed.
    share : float
        Share of the squared error that goes with it.
    fall : float
        The same as the fall of the weighted residual sum of squares.
    """

    joint: str
    what: str
    unit: str
    run: str
    at: float
    value: float
    share: float
    fall: float

    @property
    def text(self) -> str:
        """One sentence without its full stop."""
        when = f"from {self.at:.3g} s of {self.run} on" if self.at else f"in {self.run}"
        size = f"{self.value:+.3g} {self.unit}"
        if self.unit == "1":
            size = f"{100 * self.value:+.3g} % against the rest"
        fall = 100 * (1 - np.sqrt(1 - self.share))
        return (
            f"{self.joint}: another {self.what} {when} ({size}) would lower the error by "
            f"{fall:.0f} %"
        )


def told(found: Sequence[Change]) -> list[tuple[str, str]]:
    """Notes (code, sentence), the last with what to do."""
    texts = [c.text for c in found]
    return [(CODE, t) for t in [*texts[:-1], *(f"{t}; {ADVICE}" for t in texts[-1:])]]


def changes(result: FitResult, projector: Projector | None = None) -> tuple[Change, ...]:
    """The change that explains most, joint by joint, where the error falls by a tenth or more.

    Parameters
    ----------
    result : FitResult
        A fit.
    projector : Projector, optional
        That of the same fit.
    """
    if result.model.explains != "motor":
        return ()
    projector = projector or Projector(result.problem, result.terms, result.sigma)
    moves = np.flatnonzero(~result.problem.holds).tolist()
    found = (_of_joint(projector, result, j) for j in moves)
    return tuple(c for c in found if c is not None)


def _of_joint(projector: Projector, result: FitResult, j: int) -> Change | None:
    """What changed on joint j, if it is more than chance and matters."""
    problem, columns = result.problem, _columns(result, j)
    cuts = _coarse(result)
    gain, value, what, cut = _best(projector, j, columns, range(len(VALUES)), cuts)
    if gain < MORE * _throughout(projector, j, columns[:, what]):
        return None
    if cut[1]:
        # the instant itself, between its neighbours
        gain, value, what, cut = _best(projector, j, columns, [what], _fine(result, cut))
    rows = slice(j * problem.n, (j + 1) * problem.n)
    r = projector.residual[rows]
    left = r - value * _beside(projector, j, columns[:, what] * _later(problem, cut))
    rss, rest = float(r @ r), float(left @ left)
    tried = len(cuts) * len(VALUES) * problem.d
    # gain / (noise * inflation) ~ chi2(1), Bonferroni over all that was tried
    noise = rest / max(float(problem.count[j]), 1.0) * inflation(r, problem.run)
    chance = gain < chi2.isf(LEVEL / tried, 1) * max(noise, 1e-300)
    if chance or rest * ADEQUATE**2 > rss:
        return None
    name, unit = VALUES[what]
    run, at = problem.recordings[cut[0]].name, cut[1]
    unit = in_units(unit, problem, j)
    return Change(problem.joints[j], name, unit, run, at, value, 1 - rest / rss, rss - rest)


def _throughout(projector: Projector, j: int, c: FloatArray) -> float:
    """Gain of a column (n,) of joint j that acts throughout: what an offset does is no change."""
    rows = slice(j * projector.problem.n, (j + 1) * projector.problem.n)
    whole = float(c @ c)
    free = whole - float(np.sum(projector.inner(rows, c[:, None]) ** 2))
    along = float(c @ projector.residual[rows])
    return along**2 / free if free > NEW * whole else 0.0


def _beside(projector: Projector, j: int, c: FloatArray) -> FloatArray:
    """Part of a column (n,) of joint j that the base does not do, on the same rows."""
    n, (q, u) = projector.problem.n, projector.parts[j]
    known = projector.inner(slice(j * n, (j + 1) * n), c[:, None])
    out: FloatArray = c - (q @ (u @ known))[:, 0]
    return out


def _later(problem: Problem, cut: Cut) -> NDArray[np.bool_]:
    """Rows (n,) of a run from an instant on."""
    own = problem.run == cut[0]
    out: NDArray[np.bool_] = own & (problem.t >= float(problem.t[own].min()) + cut[1])
    return out


def _columns(result: FitResult, j: int) -> FloatArray:
    """Columns (n, 6) of `VALUES` on joint j, weighted as the rows are."""
    problem = result.problem
    raw = [
        np.stack([np.ones(m.n), m.sign(j), m.qd[:, j], m.qdd[:, j], m.q[:, j]], axis=1)
        for m in problem.motions
    ]
    made = np.column_stack([problem.gated(raw, j), problem.y[j] - result.residual[j]])
    return np.asarray(made / result.sigma[j], dtype=np.float64)


def _coarse(result: FitResult) -> list[Cut]:
    """Instants over every run; of several runs each one as a whole, too."""
    motions = result.problem.motions
    whole = [(k, 0.0) for k in range(1, len(motions))]
    inside = np.arange(1, INSTANTS + 1) / (INSTANTS + 1)
    return whole + [(k, float(m.since[-1] * x)) for k, m in enumerate(motions) for x in inside]


def _fine(result: FitResult, cut: Cut) -> list[Cut]:
    """Instants around one of the coarse ones, itself among them."""
    step = float(result.problem.motions[cut[0]].since[-1]) / (INSTANTS + 1) / AROUND
    return [(cut[0], cut[1] + step * x) for x in range(1 - AROUND, AROUND)]


def _best(
    projector: Projector, j: int, columns: FloatArray, which: Sequence[int], cuts: list[Cut]
) -> tuple[float, float, int, Cut]:
    """Gain, value, number of the value and cut of what explains most on joint j."""
    problem = projector.problem
    rows = slice(j * problem.n, (j + 1) * problem.n)
    later = [_later(problem, cut) for cut in cuts]
    found = [(0.0, 0.0, which[0], cuts[0])]
    for k in which:
        c = columns[:, k : k + 1] * np.stack(later, axis=1)
        whole = np.sum(c**2, axis=0)
        free = whole - np.sum(projector.inner(rows, c) ** 2, axis=0)
        free = np.where(free > NEW * whole, free, np.inf)
        along = c.T @ projector.residual[rows]
        b = int(np.argmax(along**2 / free))
        found.append((float(along[b] ** 2 / free[b]), float(along[b] / free[b]), k, cuts[b]))
    return max(found, key=lambda x: x[0])
