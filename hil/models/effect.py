"""One physical effect: an equation, its parameters, and how it betrays itself.

An effect says which effort the motor must supply because of it,

    tau_j = sum_k  theta_k  x_k(motion; shape),

linear in the coefficients theta and non-linear in at most a few *shape* parameters (a speed,
a length, an order, a delay).  Identification eliminates theta and searches the shape.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from hil.models.motion import FloatArray, Motion
from hil.models.param import INF, Param

__all__ = ["INF", "SURE", "Effect", "Param", "log_grid", "margins", "typical_speed"]
#: Standard errors from which on a value is not chance.
SURE = 2.0


class Effect(ABC):
    """Base class of every effect, built in or a user's own.

    A subclass states its class attributes and `columns`; with shape parameters also `grid`.

    Attributes
    ----------
    name : str
        Name in the catalogue.
    family : str
        ``friction``, ``actuator``, ``mass``, ``stiffness``, ``transmission``, ``contact``,
        ``sensor``, ``structure``.
    equation, signature, confused_with, shown_by, source : str
        For people: what it is, how it shows, what it is mistaken for, which motion shows it.
    params : tuple of Param
        The linear coefficients, one a column.
    shape : tuple of Param
        The non-linear parameters.
    replaces : tuple of str
        Effects of the same joint that this one takes the place of.
    explains : tuple of str
        Which measured effort it can be part of: ``"motor"`` and/or ``"external"``.
    whole_robot : bool
        True if one set of coefficients acts on all joints (then `columns` is (n, d, m)).
    candidate : bool
        False for the parts every model has; they are never proposed as "missing".
    """

    name: ClassVar[str]
    family: ClassVar[str]
    equation: ClassVar[str]
    signature: ClassVar[str]
    confused_with: ClassVar[tuple[str, ...]] = ()
    shown_by: ClassVar[str]
    source: ClassVar[str]
    params: ClassVar[tuple[Param, ...]] = ()
    shape: ClassVar[tuple[Param, ...]] = ()
    replaces: ClassVar[tuple[str, ...]] = ()
    explains: ClassVar[tuple[str, ...]] = ("motor",)
    whole_robot: ClassVar[bool] = False
    candidate: ClassVar[bool] = True
    #: Whether it belongs to no joint though it has a shape (an effect of the force sensor).
    jointless: ClassVar[bool] = False
    #: Whether a local search may refine the shape after the grid.
    refine: ClassVar[bool] = True
    #: Rounds in which `across` and then the first value again are searched; with any, the forms of
    #: the grid are climbed each from its own best value, where those differ.
    rounds: ClassVar[int] = 0
    #: Whether the lower end of the shape's grid is what the data resolve, hence no bound.
    ends_at_resolution: ClassVar[bool] = False
    #: Whether the columns depend on `Motion.load`, hence on the model's own estimate.
    uses_load: ClassVar[bool] = False
    #: Whether the columns depend on position, speed, acceleration and robot alone: made once.
    motion_only: ClassVar[bool] = False
    #: Whether the columns hold time, a measured effort or a state: a simulation takes them
    #: from the measured run.
    replayed: ClassVar[bool] = False
    #: Whether every run has its own coefficients where there are several.
    per_run: ClassVar[bool] = False
    #: Whether it passes the load on smoother, and the noise of the positions less with it.
    smooths: ClassVar[bool] = False
    #: Whether it is tried only where a value of the model changes at one instant.
    sudden: ClassVar[bool] = False
    #: Whether only differences between runs can be seen: the first run's coefficients are zero.
    relative: ClassVar[bool] = False
    #: Shape that such an effect is tried with in a single run.
    single: ClassVar[tuple[float, ...]] = ()
    #: Whether all coefficients must lie within their bounds for the effect to be proposed.
    strict: ClassVar[bool] = False
    #: Simpler effect that this one becomes in a limit; real parts are near it, not at it.
    limit: ClassVar[str] = ""
    #: What the law leaves out, where that moves its values by more than their standard errors,
    #: which count noise alone; said beside the values.
    caveat: ClassVar[str] = ""
    #: Whether it is a free function that stands for what no law explains; never a name.
    correction: ClassVar[bool] = False
    #: Whether it stands for a robot description that is missing: tried before any named effect.
    geometry: ClassVar[bool] = False
    #: What a correction is a function of, in words.
    variables: ClassVar[str] = ""
    #: Whether the columns are [sin, cos] of 2 pi f t with f the only shape: screened at once.
    spectral: ClassVar[bool] = False

    @property
    def of_robot(self) -> bool:
        """Whether one term stands for the whole robot, so that no joint is named."""
        return self.whole_robot and (not self.shape or self.jointless)

    @abstractmethod
    def columns(self, motion: Motion, j: int, shape: Sequence[float]) -> FloatArray:
        """Effort of unit coefficients on joint j.

        Parameters
        ----------
        motion : Motion
            The run.
        j : int
            Joint index (ignored by effects of the whole robot).
        shape : sequence of float
            Values of the shape parameters, in the order of `shape`.

        Returns
        -------
        ndarray (n, m), or (n, d, m) for an effect of the whole robot
        """

    def foils(self, motion: Motion, j: int, shape: Sequence[float]) -> Sequence[FloatArray]:
        """Columns of laws without a name that must explain less than this one.

        Each (n, m), or (n, d, m) of an effect of the whole robot.

        Nearby forms that the catalogue does not hold: where one of them fits better, the effect
        would be a wrong name for it, however much it explains.
        """
        return ()

    def grid(self, motion: Motion, j: int) -> list[tuple[float, ...]]:
        """Shape values worth trying for this motion (coarse; a local search refines)."""
        if self.shape:
            raise NotImplementedError(f"effect {self.name!r} has shape parameters but no grid")
        return [()]

    def across(self, motion: Motion, j: int, shape: Sequence[float]) -> list[tuple[float, ...]]:
        """Shapes that differ from a found one in another value than the first.

        Tried once the first value is found, the usual ones before the unusual: the first of them
        that leaves no more than 1 % above the best is taken.  A grid of both would be the product.
        """
        return []

    def others(
        self, motion: Motion, j: int, shape: Sequence[float]
    ) -> tuple[list[tuple[float, ...]], Effect, list[tuple[float, ...]]] | None:
        """Unusual forms about a found shape, and what they must beat: an effect and its shapes.

        A form that holds another effect in itself is taken only where it leaves clearly less
        than the two beside each other; else both could not be named.
        """
        return None

    def carrier(self, motion: Motion, j: int) -> FloatArray | None:
        """Factor w (n,) if the columns are w times two harmonics over position, else None.

        With the order as the only shape; a long grid of orders is then screened at once.
        """
        return None

    def powers(self, motion: Motion, j: int) -> NDArray[np.complex128] | None:
        """Factors w_m (n, m) if the columns are waves whose size changes with their order.

        On the own joint the real and imaginary part of  sum_m k^m w_m exp(i k q), k = 2 pi p,
        with p the first shape; else None.  For screening, as `carrier`.
        """
        return None

    def terms(self, motion: Motion, j: int) -> tuple[Param, ...]:
        """Coefficients for joint j of this robot (most effects: always the same)."""
        return self.params

    def recorded(self, shape: Sequence[float]) -> bool:
        """Whether the columns hold what only a recorded run has: time, an effort or a state."""
        return self.replayed

    def state(
        self, motion: Motion, j: int, shape: Sequence[float], beta: Sequence[float]
    ) -> FloatArray | None:
        """State of the joint's friction that takes the place of the speed's sign; None if none.

        Shape (n,), 1 in steady sliding forwards.  Every law that scales friction scales it.
        """
        return None

    def twins(self, motion: Motion) -> tuple[str, ...]:
        """Effects with the very same columns on such data: no motion tells them apart."""
        return ()

    def credible(
        self, motion: Motion, j: int, shape: Sequence[float], beta: Sequence[float],
        error: Sequence[float] = (),
    ) -> bool:  # fmt: skip
        """Whether values that fit can be physics: else they are no finding, however well they fit.

        Parameters
        ----------
        motion : Motion
            The run.
        j : int
            Joint index.
        shape, beta : sequence of float
            Shape values and coefficients.
        error : sequence of float
            Standard errors of the coefficients; empty where unknown, then none counts.

        Returns
        -------
        bool
            Here: whether all lie within their bounds, but for `SURE` standard errors.
        """
        if len(self.params) != len(beta):
            return True
        slack = margins(beta, error)
        return all(
            p.lower - e <= b <= p.upper + e
            for p, b, e in zip(self.params, beta, slack, strict=True)
        )

    def remark(self, values: Mapping[str, float], errors: Mapping[str, float]) -> str:
        """What its fitted values say that a reader might miss, by short names; empty if nothing."""
        return ""

    def belongs(self, shape: Sequence[float]) -> bool:
        """Whether coefficients are of one run alone, so that any other run has its own."""
        return False

    def dated(self, shape: Sequence[float]) -> bool:
        """Whether it acts at instants of a run that are seen there: no other run can confirm it."""
        return False

    def available(self, motion: Motion, j: int) -> str:
        """Say why the effect cannot be tried on these data; empty if it can."""
        return ""


def margins(beta: Sequence[float], error: Sequence[float]) -> list[float]:
    """`SURE` standard errors of every coefficient; zero where unknown."""
    known = error if len(error) == len(beta) else [0.0] * len(beta)
    return [SURE * e if math.isfinite(e) else 0.0 for e in known]


def brakes(w: FloatArray, beta: Sequence[float], slack: Sequence[float]) -> bool:
    """Whether friction  F = c tanh(w / v0) + v w  takes power,  w F >= 0,  at every speed seen.

    Beside the joints' own friction the viscous part alone may come out below zero.

    Parameters
    ----------
    w : ndarray (n,)
        Relative speed [rad/s or m/s].
    beta, slack : sequence of float
        c and v, and what each may lack.
    """
    (c, v), (dc, dv), top = beta, slack, float(np.max(np.abs(w), initial=0.0))
    return c >= -dc and c + v * top >= -dc - dv * top


def log_grid(low: float, high: float, count: int) -> list[tuple[float, ...]]:
    """`count` logarithmically spaced one-parameter shapes from low to high."""
    return [(float(x),) for x in np.geomspace(low, max(high, low * 1.001), count)]


def typical_speed(motion: Motion, j: int) -> float:
    """Root mean square speed of joint j, never zero [rad/s or m/s]."""
    return max(float(np.sqrt(np.mean(motion.qd[:, j] ** 2))), 1e-9)
