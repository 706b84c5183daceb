"""When nothing can be concluded: too little motion, another robot or gravity, wrong forces."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.optimize
from numpy.typing import NDArray

from hil.diagnosis.candidates import model_groups, paired
from hil.diagnosis.constants import (
    BEYOND,
    CERTAIN,
    DISAGREEMENT,
    HALF,
    LITTLE,
    NEAR_FLOOR,
    OPEN,
    SHORTEST,
    SURE,
    TENTH,
    WHOLE,
)
from hil.diagnosis.grams import GramTable, Group, Split
from hil.errors import plural
from hil.identify.design import Term, head
from hil.identify.problem import Problem
from hil.identify.regression import inflation
from hil.identify.result import FitResult
from hil.models.contact import penetration
from hil.models.effect import Trait
from hil.models.model import RobotModel
from hil.models.parts import TELLING_PUSH
from hil.record.consistency import DataFault
from hil.record.recording import Recording, RobotSource

FloatArray = NDArray[np.float64]


# ------------------------------------------------------------ motion


def undetermined(result: FitResult) -> list[tuple[str, str]]:
    """Reasons (code, sentence) why nothing can be concluded; empty if something can.

    *No motion*: every joint holds its place, or its speed stays below what the encoder and filter
    resolve.
    *Rigid contact*: the force varies while the position hardly does, so stiffness is bounded
    from below only: least squares of force on position and of position on force then differ
    by 1 / R^2, the attenuation that noise in the position causes.
    """
    problem = result.problem
    if result.model.explains == "external":
        return _rigid(result)
    if np.all(problem.holds):
        return [("no-motion", _all_held(problem))]
    speed = np.sqrt(np.mean(problem.qd**2, axis=1))
    if np.all(speed < CERTAIN * problem.speed_noise):
        return [("no-motion", _slow(problem, speed))]
    return _short(problem)


def _all_held(problem: Problem) -> str:
    """How little every joint moves."""
    spans = np.ptp(np.concatenate([r.q for r in problem.recordings]), axis=0)
    units = zip(problem.joints, spans.tolist(), problem.robot.units, strict=True)
    parts = ", ".join(f"{joint} moves by {x:.2g} {unit}" for joint, x, unit in units)
    return (
        f"every joint holds its place: {parts}. Such a recording tells nothing of friction and "
        "inertia. Move faster or wider, by a hundred steps of each encoder or more"
    )


def _slow(problem: Problem, speed: FloatArray) -> str:
    """What the joints move, what that drowns in, and what helps."""
    parts = [
        f"{joint} moves at {v:.2g} {unit}/s (rms), and the steps of the encoder give a noise of "
        f"{noise:.2g} {unit}/s"
        for joint, v, noise, unit in zip(
            problem.joints, speed, problem.speed_noise, problem.robot.units, strict=True
        )
    ]
    band = problem.rates
    return (
        f"{'; '.join(parts)} after the filter of {band.position:.3g} Hz: the motion is too small "
        "for "
        f"this encoder. Move faster or wider, use a finer encoder, or narrow the band in the "
        f"model file, under [signal]: position_hz = {band.position / 3:.2g}, "
        f"effort_hz = {band.effort / 3:.2g}"
    )


def _short(problem: Problem) -> list[tuple[str, str]]:
    """Reason if all runs together are too short to name an effect."""
    left = problem.n / problem.rate
    if left >= SHORTEST:
        return []
    recorded = sum(float(r.t[-1] - r.t[0]) for r in problem.recordings)
    # the filter's edges go at both ends of every run, so they come on top
    wanted = math.ceil(SHORTEST + max(recorded - left, 0.0))
    text = (
        f"the recordings last {recorded:.2g} s, and {left:.2g} s are left after the filter's "
        "edges; "
        f"at least {SHORTEST:g} s are needed to tell an effect from chance. Record "
        f"{wanted} s or more, or give several runs"
    )
    return [("too-short", text)]


def _rigid(result: FitResult) -> list[tuple[str, str]]:
    problem, out = result.problem, []
    for j, joint in enumerate(problem.joints):
        r2 = _agreement(result, j)
        if r2 < 1 / DISAGREEMENT:
            out.append(
                (
                    "not-identifiable",
                    f"{joint}: while touching, position explains only {100 * r2:.0f} % of the "
                    "contact effort's variance, so its stiffness is bounded from below only "
                    f"(forward and reverse regression differ by a factor {1 / max(r2, 1e-3):.1f}):"
                    " the object is too stiff for this position sensor, or there is no contact. "
                    "Use a softer object, a finer encoder or a stiffer mount",
                )
            )
    return out if len(out) == problem.d else []


def _agreement(result: FitResult, j: int) -> float:
    """Squared correlation of effort and penetration over the rows in contact."""
    problem = result.problem
    y = problem.y[j]
    if not np.isfinite(problem.motions[0].contact[j]).all():
        return 1 - float(np.mean(result.residual[j] ** 2) / max(np.var(y), 1e-300))
    depth = problem.filtered([penetration(m, j)[0][:, None] for m in problem.motions])[:, 0]
    touching = depth > LITTLE * depth.max()
    if np.sum(touching) < 20 or np.std(depth[touching]) == 0:
        return 0.0
    return float(np.corrcoef(depth[touching], y[touching])[0, 1] ** 2)


def without_effort(recordings: Sequence[Recording]) -> list[DataFault]:
    """Fault where no joint's effort changes in any run, so that there is nothing to explain.

    One run of a constant effort beside others is sound, as of a motor that is fed by steps.

    Parameters
    ----------
    recordings : sequence of Recording
        All runs that are fitted.
    """
    if any(r.wrench is not None or r.tau_ext is not None for r in recordings):
        return []
    if len({r.d for r in recordings}) > 1:  # of several robots, which is refused with their names
        return []
    efforts = np.concatenate([r.tau for r in recordings])
    if not efforts.size or np.any(np.ptp(efforts, axis=0) > 0):
        return []
    names = recordings[0].joints
    each = ", ".join(
        f"tau{k + 1} ({n}) is {x:.4g}"
        for k, (n, x) in enumerate(zip(names, efforts[0], strict=True))
    )
    text = (
        f"no effort changes in the whole recording: {each} throughout. Is the channel dead, or is "
        "it another column? Name the column of the measured effort in a map, or record it again"
    )
    return [DataFault(CONSTANT_EFFORT, "error", "", text)]


#: Code of the fault that no effort ever changes.
CONSTANT_EFFORT = "constant-effort"
OTHER_ROBOT = "other-robot"


# ------------------------------------------------------------ robot


def other_robot(model: RobotModel, recordings: Sequence[Recording]) -> list[tuple[str, str]]:
    """Warning (code, sentence) where a model is of another kind of robot than the runs.

    Of a session that names no robot, or independent axes, any model may be tried.

    Parameters
    ----------
    model : RobotModel
        The model.
    recordings : sequence of Recording
        Runs that it is given.
    """
    ours = _kind(model.robot)
    for r in recordings:
        theirs = _kind(r.robot)
        known = r.robot.urdf or r.robot.preset not in ("", "single-axis")
        if known and ours != theirs:
            return [(OTHER_ROBOT, _sentence(ours, theirs, r.name))]
    return []


def _kind(robot: RobotSource) -> str:
    """What a robot is, in words."""
    if robot.urdf:
        return "a URDF"
    if robot.preset in ("", "single-axis"):
        return "independent axes (no gravity, no coupling of joints)"
    return f"the robot {robot.preset!r}"


def _sentence(ours: str, theirs: str, name: str) -> str:
    return (
        f"the model is of {ours}, the session {name} of {theirs}: its errors may be the robot's; "
        "without --model the base model of the session's own robot is taken"
    )


# ------------------------------------------------------------ the description of the robot


@dataclass(frozen=True)
class Weighed:
    """Gravity of one joint by the data, in shares of what the description says.

    Parameters
    ----------
    joint : int
        Its index.
    ratio, stderr : float
        Slope of the fitted gravity over the described one along the motion, and standard error.
    share : float
        Rms of the described gravity without its mean, as a share of the joint's rms effort.
    """

    joint: int
    ratio: float
    stderr: float
    share: float


def weighed(result: FitResult) -> list[Weighed]:
    """Gravity of every joint that moves, by the data beside the description; empty without one.

    Of joints whose described gravity the effort can show: of an upright axis it is none.

    With gravity  g(q) = G(q) theta  of the fit and  g_0 = G theta_0  of the description, both
    without their means (an offset is not gravity),

        ratio = g_0'g / g_0'g_0,

    a linear function of theta, whose variance follows from that of the fit.
    """
    return [w for w in _every(result) if w.share >= LITTLE]


def _body(result: FitResult) -> Iterator[tuple[Term, slice]]:
    """The free rigid body of a fit beside a description, and the place of its coefficients."""
    if result.problem.robot.tree is None or result.pull is not None:
        return
    for t, where in zip(result.terms, result.slices, strict=True):
        if Trait.BODY in t.effect.traits and not t.fixed:
            yield t, where


def _every(result: FitResult) -> list[Weighed]:
    """The same of all joints of which the described or the fitted gravity can be seen."""
    problem, out = result.problem, list[Weighed]()
    for t, where in _body(result):
        parts = problem.at_rest(t.effect, t.joint, t.shape)
        for j in np.flatnonzero(~problem.holds).tolist():
            found = _weighed(result, where, [(some, g[:, j]) for some, g in parts], j)
            out += [found] if found else []
    return out


def _weighed(
    result: FitResult,
    where: slice,
    parts: Sequence[tuple[NDArray[np.int_], FloatArray]],
    j: int,
) -> Weighed | None:
    problem = result.problem
    size = where.stop - where.start
    wide = [np.zeros((len(g), size)) for _, g in parts]
    for total, (some, g) in zip(wide, parts, strict=True):
        total[:, some] = g - g.mean(axis=0)
    columns = np.concatenate(wide)
    said = columns @ problem.robot.prior
    power = float(said @ said)
    rms = float(problem.rms(problem.effort)[j])
    share = float(np.sqrt(power / len(said))) / max(rms, 1e-300)
    if power <= 0.0:
        return None
    slope = said @ columns / power
    ratio = float(slope @ result.theta[where])
    if share * max(abs(ratio), 1.0) < LITTLE:
        return None
    # in the fit's own directions: var(c'theta) = |c' V / (S scale)|^2, times what colour takes
    b = result.basis
    spread = (slope / b.scale[where]) @ (b.v[where] / b.s)
    stderr = (
        float(np.linalg.norm(spread)) * float(inflation(result.residual[j], problem.run)) ** 0.5
    )
    return Weighed(j, ratio, stderr, share)


#: Code of the warning that a fit predicts less than nothing does.
LOST = "foretells-nothing"


def lost(result: FitResult, heldout: FloatArray) -> list[tuple[str, str]]:
    """Warning (code, sentence) of joints (d,) whose left-out error [%] exceeds their effort."""
    problem = result.problem
    bad = [j for j, e in enumerate(heldout) if e / 100 > 1.0 and not problem.holds[j]]
    if not bad:
        return []
    names = ", ".join(problem.joints[j] for j in bad)
    return [
        (
            LOST,
            f"{names}: the fitted model predicts left-out data worse than no model at all. Its "
            "values are not those of masses and friction. Look for a cause outside the model: does "
            "something touch the robot (give its force, or cut these stretches), do efforts and "
            "positions belong to the same joint, are their units right?",
        )
    ]


#: Code of the warning that gravity by the data is not that of the robot's description.
GRAVITY_WARNING = "description-gravity"


#: Code of the warning that the efforts are in another scale than the description.
EFFORT_SCALE = "effort-scale"
#: Postures at which a described gravity is compared, and steps of a zero around the turn.
_POSTURES, _STEPS = 500, 24


def _times(every: Sequence[Weighed]) -> str:
    """What was measured, e.g. ``0.02`` or ``-0.03 to 0.02``."""
    told = [f"{x:.2g}" for x in sorted(w.ratio for w in every)]
    return told[0] if told[0] == told[-1] else f"{told[0]} to {told[-1]}"


def _other_gravity(result: FitResult, every: Sequence[Weighed]) -> str:
    """Sentence where all joints give no gravity, or the opposite one; else empty."""
    sign = (
        "friction comes out as zero, as it does where all efforts have the wrong sign: is that so? "
        "Then set sign = -1 for them in a map and import again"
    )
    for times, seen, why, text in (
        (
            0.0,
            "the efforts contain hardly any gravity",
            "are they too small by the ratio of a gear or by a unit? Or were they recorded after a "
            "gravity compensation, or does the robot lie flat?",
            "0 0 0",
        ),
        (-1.0, "gravity acts upwards", "does the robot hang from a ceiling?", "0 0 9.81"),
    ):
        if every and all(abs(w.ratio - times) < TENTH for w in every):
            lead = (
                f"{seen}: the data give {_times(every)} times the gravity of the robot "
                f"description, on {plural(len(every), 'joint')}; "
            )
            if times < 0.0 and driven(result):
                return lead + sign
            return (
                f"{lead}{why} Then write <gravity>{text}</gravity> within <robot> of the URDF and "
                "import again"
            )
    return ""


def driven(result: FitResult) -> bool:
    """Whether all friction lies on its bound, zero: free masses take a wrong sign, it cannot."""
    friction = Trait.DRY | Trait.VISCOUS
    rubbing = [t for t in result.terms if t.effect.traits & friction]
    every = [f"{head(t.effect, t.joint)}.{t.effect.params[0].name}" for t in rubbing]
    names = [n for n in every if n in result.values]
    return bool(names) and all(result.values[n].at_bound for n in names)


def _scaled(result: FitResult) -> str:
    """Sentence where gravity and inertia of all joints are one and the same multiple; else empty.

    Of ten times or more, or a tenth and less.  A counterweight lowers gravity alone, and a rotor
    raises the inertia alone.
    """
    every = _every(result)
    ratios = np.array([w.ratio for w in every])
    if not every or any(w.ratio < CERTAIN * w.stderr for w in every):
        return ""
    times = float(np.exp(np.mean(np.log(ratios))))
    if TENTH < times < 1 / TENTH or np.ptp(ratios) > TENTH * float(ratios.max()):
        return ""
    felt = _inertia(result)
    if any((x > HALF) if times < 1 else (x < 1 / HALF) for x in felt):
        return ""
    # masses are those of several joints: each one's own effort must be of that size, too
    if any(not TENTH < times * w.share < 1 / TENTH for w in every):
        return ""
    part = f" (1/{1 / times:.3g})" if times < 1 else ""
    size = f"{times:.3g}" if times < 100 else f"{times:.0f}"
    return (
        f"all efforts are {size}{part} times what the robot description asks for, gravity "
        f"and inertia alike, on {plural(len(every), 'joint')}: is that a unit (mN m, mA, per "
        "cent) or the ratio of a gear? Then multiply them in a map "
        f"(scale = {1 / times:.2g}) and import again, or correct the masses of the description"
    )


def _inertia(result: FitResult) -> list[float]:
    """Inertia of every joint that moves, by the data, in shares of what the description says."""
    problem = result.problem
    rotor = {t.joint: float(result.theta[w][0]) for t, w in _of(result, Trait.ROTOR)}
    states = [x[:, _picked(problem)].T for x in (problem.q, problem.qd, problem.qdd)]
    out: list[float] = []
    for _, where in _body(result):
        still = np.zeros_like(states[0])
        moved = problem.robot.regressor(*states) - problem.robot.regressor(states[0], still, still)
        for j in np.flatnonzero(~problem.holds & ~problem.silent).tolist():
            said = moved[:, j] @ problem.robot.prior
            found = moved[:, j] @ result.theta[where] + rotor.get(j, 0.0) * states[2][:, j]
            power = float(said @ said)
            out += [float(said @ found) / power] if power > 0.0 else []
    return out


def _of(result: FitResult, trait: Trait) -> list[tuple[Term, slice]]:
    """Terms of effects with a trait, with the place of their coefficients."""
    both = zip(result.terms, result.slices, strict=True)
    return [(t, where) for t, where in both if t.effect.traits & trait]


def _picked(problem: Problem) -> NDArray[np.int_]:
    """Some instants, spread over all runs."""
    return np.unique(np.linspace(0, problem.n - 1, _POSTURES).astype(np.int_))


def _turned(result: FitResult) -> str:
    """Sentence where another zero of one joint makes the described gravity that of the data.

    With g the fitted gravity and g_0(q) the described one, both without their means, the zero z of
    the joint k that leaves least of  g - g_0(q + z e_k).  It must leave far less than the
    description as it is, no gravity, and the opposite one do.
    """
    problem = result.problem
    q = problem.q[:, _picked(problem)].T
    still, size = np.zeros_like(q), np.maximum(problem.rms(problem.effort), 1e-300)
    moves = np.flatnonzero(~problem.holds & ~problem.silent)

    def gravity(at: FloatArray, masses: FloatArray) -> FloatArray:
        g = (problem.robot.regressor(at, still, still) @ masses) / size
        return np.asarray((g - g.mean(axis=0))[:, moves])

    for _, where in _body(result):
        found, said = gravity(q, result.theta[where]), gravity(q, problem.robot.prior)

        def left(k: int, z: float, found: FloatArray = found) -> float:
            at = q + z * (np.arange(problem.d) == k)
            return float(np.sum((gravity(at, problem.robot.prior) - found) ** 2))

        turning = [k for k in moves.tolist() if problem.robot.units[k] == "rad"]
        step = 2 * np.pi / _STEPS
        tried = [(left(k, step * n), k, step * n) for k in turning for n in range(1, _STEPS)]
        if not tried:
            return ""
        _, k, z = min(tried)
        best = scipy.optimize.minimize_scalar(
            lambda x, k=k: left(k, float(x)), bounds=(z - step, z + step), method="bounded"
        )
        most = OPEN**2 * min(float(np.sum(x**2)) for x in (found - said, found, found + said))
        if float(best.fun) >= most:  # without a described gravity both are zero
            return ""
        # a quarter of a turn where that does, too
        near = np.pi / 2 * round(float(best.x) / (np.pi / 2))
        z = near if left(k, near) <= most else float(best.x)
        z = float((z + np.pi) % (2 * np.pi) - np.pi)
        ratios = ", ".join(f"{w.ratio:.2f} on {problem.joints[w.joint]}" for w in weighed(result))
        return (
            f"the zero of q{k + 1} ({problem.joints[k]}) seems to be another one than in the robot "
            f"description: with shift = {z:.3g} rad ({np.degrees(z):.3g} deg) for it in a map, the "
            f"described masses give the gravity of the data. As it is, the data give so many times "
            f"the described gravity: {ratios}. Check this zero first; if it is right, the centres "
            "of mass lie in another direction than described"
        )
    return ""


def contradicted(result: FitResult, over: FloatArray | None = None) -> list[tuple[str, str]]:
    """Warnings (code, sentence) where the data surely give another gravity than the description.

    By more than a little of the joint's effort.  Where the model leaves more than noise on a joint,
    what it lacks may act over the posture as gravity does: the description is not doubted there.

    Parameters
    ----------
    result : FitResult
        A fit.
    over : ndarray (d,), optional
        Error over the noise floor, where that is known.
    """
    if scaled := _scaled(result):
        return [(EFFORT_SCALE, scaled)]
    every = weighed(result)
    off = [w for w in every if _doubted(w)]
    if not off:
        return []
    said = _turned(result) or _other_gravity(result, every)
    if said:
        return [(GRAVITY_WARNING, said)]
    every_one = [(w, _advice(result.problem.joints[w.joint], w, over)) for w in off]
    # what is said of the masses of several joints is said once
    masses = [w for w, advice in every_one if advice == _MASSES]
    told = [(masses, _MASSES)] if masses else []
    told += [([w], advice) for w, advice in every_one if advice != _MASSES]
    return [(GRAVITY_WARNING, f"{_ratios(result, some)}. {advice}") for some, advice in told]


#: What to do where the data surely give other masses than the description; of one joint, whose
#: effort is of another order.
_MASSES = (
    "Check the masses and centres of mass of the links that follow, the zeros of the positions, "
    "and whether the description lacks a spring or a counterweight"
)
_UNITS = "Check the unit of its effort (or the ratio of a gear), t" + _MASSES.removeprefix(
    "Check t"
)


def _ratios(result: FitResult, some: Sequence[Weighed]) -> str:
    """Sentence on the gravity of joints, by the data over the description."""
    joints = [result.problem.joints[w.joint] for w in some]
    ratios = [f"{w.ratio:.2f}" for w in some]
    if len(some) == 1:
        return (
            f"gravity of {joints[0]}: the data give {ratios[0]} times the value of the robot "
            f"description (standard error {some[0].stderr:.2g})"
        )
    return (
        f"gravity of {', '.join(joints)}: the data give {', '.join(ratios)} times the values of "
        f"the robot description (standard errors up to {max(w.stderr for w in some):.2g})"
    )


def _advice(joint: str, w: Weighed, over: FloatArray | None) -> str:
    """What to do about the gravity of a joint."""
    unit, left = not TENTH < w.ratio < 1 / TENTH, 0.0 if over is None else float(over[w.joint])
    if _upwards(w) and over is not None and left <= NEAR_FLOOR:
        return BALANCED
    if _upwards(w):
        return (
            f"{NO_MASSES}: does something touch the robot (give its force, or cut these "
            "stretches), or does gravity act in another direction than described?"
        )
    if left > NEAR_FLOOR and not unit:
        return (
            f"But the model leaves {left:.1f} times the noise floor on {joint}: what it lacks "
            "may act over the posture as gravity does (a spring, a cable, a contact). This "
            "value says nothing of the masses before that is explained"
        )
    return _UNITS if unit else _MASSES


def _doubted(w: Weighed) -> bool:
    """Whether a joint's gravity surely is another one, by more than a little of its effort."""
    return abs(w.ratio - 1) > max(LITTLE / max(w.share, LITTLE), CERTAIN * w.stderr)


#: Words of a gravity that acts against the description, where forces from outside may be it.
NO_MASSES = "No masses of the links do that"
#: The same where the model explains all.
BALANCED = (
    "It acts upwards, as a counterweight or a balancer does that the description lacks. Else check "
    "the zero of the position, and the direction of gravity"
)


def _upwards(w: Weighed) -> bool:
    """Whether a joint's gravity surely acts against the description."""
    return w.ratio + SURE * w.stderr < 0.0


def touched(result: FitResult, heldout: FloatArray) -> bool:
    """Whether no masses fit: some joint's gravity acts upwards, and much of its effort is left.

    Forces that nobody measured do that.  Names of effects beside such masses mean nothing.

    Parameters
    ----------
    result : FitResult
        The fit.
    heldout : ndarray (d,)
        Left-out errors [%].
    """
    return any(heldout[j] / 100 > TENTH for j in upwards(result))


def upwards(result: FitResult) -> list[int]:
    """Joints whose gravity surely acts against the description in a fit, as no masses do.

    None where another direction of gravity, or another zero of a joint, says the same of all.
    """
    every = weighed(result)
    against = [w.joint for w in every if _upwards(w)]
    return [] if not against or _other_gravity(result, every) or _turned(result) else against


# ------------------------------------------------------------ external effort


def external_effort_gains(result: FitResult, split: Split) -> dict[int, float]:
    """Gain g of the external effort on the joints whose held-out error falls with it.

    Parameters
    ----------
    result : FitResult
        Of the given model.
    split : Split
        Blocks to judge on.
    """
    problem = result.problem
    if result.model.explains != "motor":
        return {}
    columns = {
        j: problem.gated([m.tau_ext[:, j : j + 1] for m in problem.motions], j)
        for j in range(problem.d)
        if _pushed(problem, j)
    }
    free = np.array([np.inf])
    groups = [Group(("external", j), j, x, -free, free, np.zeros(1)) for j, x in columns.items()]
    if not groups:
        return {}
    base = model_groups(result)
    table = GramTable(problem, split, result.sigma, [*base, *groups])
    keys = [g.key for g in base]
    before, out = table.errors(keys), {}
    for g in groups:
        j = int(g.joint or 0)
        after = table.errors([*keys, g.key])
        fall = before.squared[:, j] - after.squared[:, j]
        if after.power[j] < WHOLE * before.power[j] and paired(fall) > BEYOND:
            out[j] = 1.0 - float(table.coefficients([*keys, g.key])[g.key][0])
    return out


def _pushed(problem: Problem, j: int) -> bool:
    """Whether an external effort is more than a sensor's noise beside the motor's: else no gain.

    Noise in a regressor draws its coefficient to zero, which would look like a wrong ratio.
    """
    push, own = (
        float(np.sqrt(np.mean(np.concatenate([x[:, j] for x in each]) ** 2)))
        for each in ([m.tau_ext for m in problem.motions], [m.tau for m in problem.motions])
    )
    return push > TELLING_PUSH * own


_TURN = "with the other sign the model fits. Set scale = -1 for fx, fy and fz in a map file"


def _one_sensor(problem: Problem) -> bool:
    """Whether all external efforts are those of a force at the tip."""
    return all(r.wrench is not None and r.tau_ext is None for r in problem.recordings)


def doubts(result: FitResult, split: Split) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Faults and warnings (code, sentence): wrong signs, and ratios to confirm."""
    faults, warnings = [], []
    found = external_effort_gains(result, split)
    wrong = [g for g in found.values() if abs(g + 1) < OPEN]
    if len(wrong) > 1 and len(wrong) == len(found) and _one_sensor(result.problem):
        return [("external-sign", f"the measured force has the wrong sign: {_TURN}")], []
    for j, g in found.items():
        joint, column = result.problem.joints[j], f"tauext{j + 1}"
        if abs(g + 1) < OPEN:
            faults.append(
                (
                    "external-sign",
                    f"the external effort of {joint} has the wrong sign: with the other sign "
                    f"the model fits. Set scale = -1 for {column} (or fx, fy, fz) in a map file",
                )
            )
        elif abs(g - 1) > OPEN:
            warnings.append(
                (
                    "external-ratio",
                    f"the external effort of {joint} fits best at {g:.3g} times its values. "
                    "Check the ratio, the unit and the place of the sensor, then set this scale "
                    "for "
                    f"{column} in a map file",
                )
            )
    return faults, warnings
