"""What a fit returns: values with errors, residuals, and what the data do not determine."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.regression import Basis
from hil.identify.solve import DESCRIBED, Pull
from hil.models.model import RobotModel, Value, in_words
from hil.shown import Shown

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, repr=False, eq=False)
class FitResult(Shown):
    """A fitted model.

    Parameters
    ----------
    model : RobotModel
        The model with values.
    problem : Problem
        Runs and filters it was fitted on.
    terms : list of Term
        Bound terms, with the shape values found.
    theta : ndarray (p,)
        Coefficients in the order of the terms.
    names : list of str
        Their full names.
    values : dict of str to Value
        Coefficients and shape values.
    residual : ndarray (d, n)
        Target minus model, after the filter [N m or N].
    sigma : ndarray (d,)
        Weights' noise scale by joint.
    basis : Basis
        Determined directions of the weighted regressor.
    prior : ndarray (p,)
        Where undetermined directions stay.
    pull : Pull or None
        What draws the masses towards the robot's description.
    """

    model: RobotModel
    problem: Problem
    terms: list[Term]
    theta: FloatArray
    names: list[str]
    values: dict[str, Value]
    residual: FloatArray
    sigma: FloatArray
    basis: Basis
    prior: FloatArray
    x: FloatArray = field(repr=False, default_factory=lambda: np.empty((0, 0)))
    slices: list[slice] = field(repr=False, default_factory=list)
    #: Code and sentence of what the user should know, e.g. ``outside-range``.
    warnings: list[tuple[str, str]] = field(default_factory=list)
    pull: Pull | None = None

    def __repr__(self) -> str:
        each = zip(self.problem.joints, self.relative, strict=True)
        errors = ", ".join(f"{joint} {x:.2f} %" for joint, x in each)
        return f"FitResult({len(self.values)} values, relative error {errors})"

    @property
    def rms(self) -> FloatArray:
        """Root mean square residual by joint (d,)."""
        return self.problem.rms(self.residual)

    @property
    def relative(self) -> FloatArray:
        """100 rms(residual) / rms(measured effort), by joint (d,) [%]."""
        return relative(self.residual, self.problem.effort)

    def not_identifiable(self) -> list[str]:
        """Names of the parameters that these data do not determine by themselves."""
        return [name for name, v in self.values.items() if not v.identifiable]

    def of_description(self) -> list[str]:
        """Names of the parameters whose values are the robot description's more than the data's."""
        return [name for name, v in self.values.items() if v.source == DESCRIBED]

    def as_dict(self) -> dict[str, object]:
        """`hil fit --json`."""
        joints = self.problem.joints
        return {
            "schema": "hil.fit/1",
            "parameters": {
                name: {
                    "value": v.value,
                    "stderr": v.stderr if np.isfinite(v.stderr) else None,
                    "unit": v.unit,
                    "at_bound": v.at_bound,
                    "identifiable": v.identifiable,
                    **({"text": said} if (said := in_words(name, v.value, joints)) else {}),
                }
                for name, v in self.values.items()
            },
            "relative": dict(zip(joints, map(float, self.relative), strict=True)),
            "rms": dict(zip(joints, map(float, self.rms), strict=True)),
            "rank": self.basis.rank,
            "columns": int(self.x.shape[1]),
            "condition": self.basis.condition if self.basis.rank else None,
            "not_identifiable": self.not_identifiable(),
            "description": (
                {"error": self.pull.error, "parameters": self.of_description()}
                if self.pull
                else None
            ),
            "band_hz": {
                "position": self.problem.rates.position,
                "effort": self.problem.rates.effort,
            },
            "warnings": [{"code": code, "text": text} for code, text in self.warnings],
        }


def relative(residual: FloatArray, effort: FloatArray) -> FloatArray:
    """100 rms(residual) / rms(effort) along the last axis [%]."""
    size = np.sqrt(np.mean(effort**2, axis=-1))
    out: FloatArray = 100 * np.sqrt(np.mean(residual**2, axis=-1)) / np.maximum(size, 1e-300)
    return out
