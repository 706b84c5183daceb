"""What a fit of the base model says of a recording's own time: lateness, and factors of a clock.

Efforts against positions are late by a part of a sample, or by more.

Measured velocities that are f times the derivative of the positions say that one of the two is
wrong: the velocities by f, the clock by 1 / f, or the positions by f.  Gravity depends on the
posture alone and inertia on the square of the clock, and both hold the same first moments, so
that a rigid body's effort tells them apart wherever a joint lifts something:

    tau = M(q) qdd + c(q, qd) + g(q);    t -> t / f:  qdd -> f^2 qdd,  g as it was.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hil.errors import HilError
from hil.identify.bands import Rates
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.identify.slow_motion import FINEST, KNOWN, longest_shift, slow_delay
from hil.identify.timing import filter_text, fit_aligned, growing
from hil.models.model import base_model
from hil.record.consistency import velocity_factor
from hil.record.recording import Recording

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Lateness:
    """By how much the efforts of a recording are late, as a diagnosis with the base model has it.

    Parameters
    ----------
    seconds : float or None
        Lateness against the positions [s], negative where they are early; None = not known.  Where
        it grows, that at the start.
    samples : float or None
        The same in samples.
    text : str
        One sentence without its full stop.
    """

    seconds: float | None
    samples: float | None
    text: str


def lateness(recording: Recording) -> Lateness:
    """Lateness of the efforts within one sample, by a fit of the base model.

    Parameters
    ----------
    recording : Recording
        With its robot; several joints without a description have no model to tell it by.
    """
    source = recording.robot
    if recording.d > 1 and not source.urdf and source.preset in ("", "single-axis"):
        return Lateness(
            None,
            None,
            "the delay between efforts and positions is unknown without the robot's geometry: "
            "import with --robot ARM.urdf",
        )
    try:
        problem = Problem([recording], source)
        result = fit_aligned(problem, base_model(source))
    except HilError as error:
        return Lateness(None, None, f"the delay between efforts and positions is unknown: {error}")
    longest, samples = longest_shift(problem), min(problem.sources)
    if problem.given_shift is not None:
        given = problem.given_shift
        said = f"the efforts are shifted by {given * 1e3:.3g} ms, as [signal] in the map file says"
        return Lateness(-given, -given * samples, said)
    known = [
        slow_delay(result, j, friction=True)[1] for j in np.flatnonzero(~problem.holds).tolist()
    ]
    proven = problem.alignment.late > longest
    if not proven and min(known, default=np.inf) >= KNOWN * longest:
        return Lateness(
            None,
            None,
            "this motion does not show the delay between efforts and positions to half a sample; "
            "to learn it, record a minute of strokes that last about a second each and take much "
            "effort",
        )
    late = problem.alignment.late
    if problem.alignment.rate:
        said = f"efforts against positions: {growing(problem)}, by a fit of the base model"
        fix = "a diagnosis corrects it (to change it, set clock_ppm and shift_s under [signal])"
        return Lateness(late, late * samples, f"{said}; {fix}")
    size, side = abs(late), "late" if late > 0 else "early"
    side += f", through {filter_text(problem.alignment)}" if problem.alignment.lag else ""
    if size < longest / FINEST:
        return Lateness(late, late * samples, "efforts against positions: in time, as far as seen")
    return Lateness(
        late,
        late * samples,
        f"efforts against positions: {size * 1e3:.3g} ms {side} ({size * samples:.2g} samples), by "
        "a fit of the base model; a diagnosis corrects it (to change it, set shift_s under "
        "[signal])",
    )


#: Correlation of measured velocity and derivative from which a factor is believed, and the factor
#: up to which nothing is said (as in `hil.record.checks`).
SURE, ALIKE = 0.95, 1.25
#: Factors of different joints that are one, as a ratio: the clock is common to all of them.
COMMON = 1.05
#: Base-model error of one reading over that of the other from which the dynamics decide.  On
#: simulated arms with gravity the wrong reading leaves several times as much; half a per cent
#: either way is chance.
DECIDES = 1.1


@dataclass(frozen=True)
class Reading:
    """One explanation of a factor between velocities and positions.

    Parameters
    ----------
    what : str
        ``"velocity"``, ``"clock"`` or ``"position"``: what is wrong.
    text : str
        The same as the part of a sentence.
    error : float
        What the base model leaves over under it, over the effort, geometric mean of the joints.
    """

    what: str
    text: str
    error: float


def factors(r: Recording) -> FloatArray:
    """Measured velocity over derivative of the position (d,); 1 where it is not to be told."""
    out = np.ones(r.d)
    if r.qd is None:
        return out
    for k in range(r.d):
        factor, correlation = velocity_factor(r.t, r.q[:, k], r.qd[:, k])
        if correlation > SURE and factor > 0:
            out[k] = factor
    return out


def readings(r: Recording) -> list[Reading]:
    """Explanations of a factor between velocities and positions, best first; none without one."""
    found = factors(r)
    off = np.flatnonzero((found > ALIKE) | (found < 1 / ALIKE))
    if not off.size or r.qd is None:
        return []
    f = float(np.median(found[off]))
    who = ", ".join(r.joints[k] for k in off)
    tried = [("velocity", f"the velocities of {who} are {f:.4g} times too large", r)]
    moved = np.flatnonzero(found != 1.0)
    common = off.size == moved.size and np.ptp(np.log(found[off])) < np.log(COMMON)
    if common:
        t = r.t[0] + (r.t - r.t[0]) / f
        tried.append(("clock", f"the time advances {f:.4g} times too fast", replace(r, t=t)))
    scale = np.ones(r.d)
    scale[off] = found[off]
    if not common or r.d == 1:
        text = f"the positions of {who} are {1 / f:.4g} times too large"
        tried.append(("position", text, replace(r, q=r.q * scale)))
    rates = Problem([r], r.robot).rates
    # the same filters in samples, so that the same rows are compared
    by = {"clock": replace(rates, position=f * rates.position, effort=f * rates.effort)}
    out = [Reading(what, text, _error(x, by.get(what, rates))) for what, text, x in tried]
    return sorted(out, key=lambda x: x.error)


def _error(r: Recording, rates: Rates) -> float:
    """Geometric mean over the joints of the base model's error over the effort; inf without."""
    try:
        problem = Problem([r], r.robot, rates=rates)
        result = fit(problem, base_model(r.robot))
    except HilError:
        return float("inf")
    left = problem.y - (result.x @ result.theta).reshape(problem.y.shape)
    share = problem.rms(left) / np.maximum(problem.rms(problem.effort), 1e-300)
    return float(np.exp(np.mean(np.log(np.maximum(share[~problem.holds], 1e-12)))))


def reading_notes(r: Recording) -> list[tuple[str, str]]:
    """Both readings and which one the dynamics support: (code, sentence); none if all agrees."""
    found = readings(r)
    if len(found) < 2:
        return [("velocity-scale", x.text) for x in found]
    either = " or ".join(x.text for x in found)
    first, second = found[0], found[1]
    if second.error > DECIDES * first.error:
        decided = (
            f"the dynamics fit better if {first.text} (base model error {100 * first.error:.3g} % "
            f"against {100 * second.error:.3g} %)"
        )
    else:
        decided = "the dynamics fit both equally well"
    return [("velocity-scale", f"either {either}; {decided}. Set its scale in a map file")]
