"""Manual excitation: what a hand, the motors, or both determine (thesis paper II).

First synthetic motion of a Premium 1.5 with friction and wrong motor constants: the torques follow
from the equation of motion, plus noise.  Then the simulated rig, as built and with one motor
constant that is wrong by a known share: a hand moves the leader, the law's own torques are the
dither; or the motors move it alone, and their constants are taken as given.  Either model tells the
force of a hand in a session that it has not seen.

Identification by manual excitation, motor constants included (thesis paper II).

    tau_s = Y(q, q', q'') pi + Y_f(q') phi - diag(u) kappa

where the hand's force is measured at the tip, tau_s = J^T F_s, and the motors give kappa u for a
commanded u.  Linear least squares in x = (pi, phi, kappa).  What the data do not determine is
said, not guessed: without a hand's force only ratios of x are known; without motor torque kappa
is not.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt

from hil import terminal
from hil.errors import FitError
from hil.experiments.pages import Means, PageData, StudyPage, TableRows
from hil.models.phantom import Premium
from hil.record.mcap_read import load
from hil.rig.config import load_rig
from hil.rigs import rig_path
from hil.runtime import runner
from hil.terminal import Found

#: Friction fc, fv of the joints, then kappa of the motors.
_TRUE: FloatArray = np.array([
    *Premium.prior, 0.012, 0.001, 0.010, 0.0008, 0.009, 0.0006, 1.04, 0.97, 1.02,
])  # fmt: skip
_NOISE = 1e-3
FloatArray = NDArray[np.float64]
#: Smallest singular value, relative to the largest, that counts.
_TOLERANCE = 1e-6
#: Speed over which the sign of the Coulomb column is resolved [rad/s].
_SOFT = 0.02
PARAMETER_NAMES = (
    *Premium.names,
    *(f"j{j}.{c}" for j in (1, 2, 3) for c in ("fc", "fv")),
    *(f"j{j}.kappa" for j in (1, 2, 3)),
)


@dataclass(frozen=True)
class Identified:
    """Result of an identification.

    Parameters
    ----------
    values, stderr : dict
        By name; standard error infinite where the data do not determine the value.
    rank, condition : int, float
        Of the column-scaled regressor.
    undetermined : tuple of str
        Names of parameters that a direction without information touches.
    text : str
        What that means and what to do.
    """

    values: dict[str, float]
    stderr: dict[str, float]
    rank: int
    condition: float
    undetermined: tuple[str, ...]
    text: str


def hand_regressor(q: FloatArray, qd: FloatArray, qdd: FloatArray, u: FloatArray) -> FloatArray:
    """Columns of (pi, phi, kappa), shape (3 n, 17), joints of an instant together.

    Parameters
    ----------
    q, qd, qdd : ndarray (n, 3)
        Motion [rad, rad/s, rad/s^2], filtered alike.
    u : ndarray (n, 3)
        Commanded motor torque at the joint [N m], filtered like the rest.
    """
    n = len(q)
    out = np.zeros((n, 3, len(PARAMETER_NAMES)))
    out[:, :, :8] = Premium(()).regressor(q, qd, qdd)
    for j in range(3):
        out[:, j, 8 + 2 * j] = np.tanh(qd[:, j] / _SOFT)
        out[:, j, 9 + 2 * j] = qd[:, j]
        out[:, j, 14 + j] = -u[:, j]
    return out.reshape(3 * n, -1)


def identify_with_rank(
    q: FloatArray, qd: FloatArray, qdd: FloatArray, u: FloatArray, tau_s: FloatArray
) -> Identified:
    """Least squares with the truth about its rank.

    Parameters
    ----------
    q, qd, qdd, u : ndarray (n, 3)
        See `hand_regressor`.
    tau_s : ndarray (n, 3)
        Joint torque of the measured force ON the tip, J^T F_s [N m].

    Raises
    ------
    FitError
        If the arm never moves.
    """
    x, y = hand_regressor(q, qd, qdd, u), tau_s.reshape(-1)
    size = np.sqrt((x**2).mean(axis=0))
    if not size[:8].any() or not np.ptp(q, axis=0).any():
        raise FitError("the arm does not move in this record; nothing can be identified")
    unit = x / np.where(size > 0, size, 1.0)
    # scale of the equation itself, for the case tau_s = 0 whose null vector is x
    _, s, vt = np.linalg.svd(unit, full_matrices=False)
    rank = int(np.sum(s > _TOLERANCE * s[0]))
    inverse = vt[:rank].T / s[:rank]
    theta = inverse @ (inverse.T @ (unit.T @ y))
    rest = y - unit @ theta
    variance = float(rest @ rest) / max(y.size - rank, 1)
    spread = np.sqrt(variance * (inverse**2).sum(axis=1))
    lost = (vt[rank:] ** 2).sum(axis=0) > 1e-6 if rank < s.size else np.zeros(s.size, bool)
    with np.errstate(divide="ignore", invalid="ignore"):  # a column of zeros: its value is unknown
        values = np.where(size > 0, theta / size, np.nan)
        stderr = np.where(lost | (size == 0), np.inf, spread / size)
    names = tuple(n for n, out in zip(PARAMETER_NAMES, lost, strict=True) if out)
    return Identified(
        dict(zip(PARAMETER_NAMES, values.tolist(), strict=True)),
        dict(zip(PARAMETER_NAMES, stderr.tolist(), strict=True)),
        rank,
        float(s[0] / s[rank - 1]),
        names,
        _advice(rank, u, y),
    )


def _advice(rank: int, u: FloatArray, tau_s: FloatArray) -> str:
    if rank == len(PARAMETER_NAMES):
        return "all parameters are determined, motor constants included"
    if not np.any(tau_s):
        return (
            "no hand's force: every parameter may be scaled by the same factor, only ratios are "
            "known; push the arm by hand with a force sensor, or take the motor constants as given"
        )
    if not np.any(u):
        return (
            "no motor torque: the motor constants do not act and are not determined; let the "
            "motors give a small torque (gravity compensation, dither) while the hand moves the arm"
        )
    return "the motion is not rich enough; move all joints, in both directions, at several speeds"


def richness(q: FloatArray, qd: FloatArray, qdd: FloatArray, cells: int = 10) -> dict[str, float]:
    """Measures of how rich a motion is (the thesis leaves the word undefined).

    Returns
    -------
    dict
        ``inverse_condition`` of the column-scaled regressor without motors, ``log_det`` of its
        normal matrix (at most 0), ``cells``: share of velocity cells visited, ``entropy`` of the
        velocity histogram relative to a uniform one.
    """
    x = hand_regressor(q, qd, qdd, np.zeros_like(q))[:, :14]
    unit = x / np.maximum(np.sqrt((x**2).mean(axis=0)), 1e-300)
    s = np.linalg.svd(unit, compute_uv=False)
    top = np.abs(qd).max(axis=0)
    at = np.floor((qd / np.maximum(top, 1e-300) + 1) / 2 * (cells - 1e-9)).astype(int)
    _, counts = np.unique(at, axis=0, return_counts=True)
    p = counts / counts.sum()
    return {
        "inverse_condition": float(s[-1] / s[0]),
        "log_det": float(2 * np.log(np.maximum(s / np.sqrt(len(x)), 1e-300)).sum()),
        "cells": float(counts.size / cells**3),
        "entropy": float(-(p * np.log(p)).sum() / np.log(cells**3)),
    }


@dataclass(frozen=True)
class ManualExcitationRow:
    """One excitation.

    Parameters
    ----------
    name : str
        What moves the arm.
    found : Identified
        Result.
    worst : float
        Largest relative error of the parameters that are said to be determined.
    """

    name: str
    found: Identified
    worst: float


def motion(seed: int, seconds: float = 16.0, sines: int = 12) -> tuple[FloatArray, ...]:
    """Hand-like motion at 250 Hz: t (n,), q, q', q'' (n, 3) of random sines up to 3 Hz."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 4e-3)
    w, phase = 2 * np.pi * rng.uniform(0.2, 3.0, (3, sines)), rng.uniform(0, 6.28, (3, sines))
    a = rng.uniform(0.02, 0.08, (3, sines))
    angle = w * t[:, None, None] + phase
    q = (a * np.sin(angle)).sum(-1) + np.array([0.0, 0.4, 0.3])
    return t, q, (a * w * np.cos(angle)).sum(-1), (-a * w**2 * np.sin(angle)).sum(-1)


def study(seed: int = 1) -> list[ManualExcitationRow]:
    """Motors alone, hand alone, hand with a small motor torque."""
    t, q, qd, qdd = motion(seed)
    rng, zero = np.random.default_rng(seed), np.zeros_like(q)
    bare = (hand_regressor(q, qd, qdd, zero) @ _TRUE).reshape(-1, 3)
    dither = 0.02 * np.sin(2 * np.pi * t[:, None] * np.array([1.1, 1.7, 0.6]))
    cases = {
        "motors, no hand": (bare / _TRUE[14:], zero),
        "hand, motors off": (zero, bare),
        "hand and dither": (dither, bare - dither * _TRUE[14:]),
    }
    rows = []
    for name, (u, tau_s) in cases.items():
        noise = _NOISE * rng.normal(size=q.shape) if tau_s.any() else zero
        found = identify_with_rank(q, qd, qdd, u, tau_s + noise)
        known = [n for n in PARAMETER_NAMES if n not in found.undetermined]
        errors = [abs(found.values[n] / _TRUE[PARAMETER_NAMES.index(n)] - 1) for n in known]
        rows.append(ManualExcitationRow(name, found, max(errors, default=float("nan"))))
    return rows


#: Motor constant of joint 2 that the simulated leader hides, and the zero-phase filter [Hz].
HIDDEN_RATIO, _CORNER = 1.08, 8.0


#: Excitations of the rig's leader, and sessions of the motors and of the judge [s].
BY_MOTORS, BY_HAND = "motors", "hand and motors"
_PLAYED, _JUDGED = 20.0, 20.0
#: Part of each session that ``--quick`` takes.
_QUICK = 0.5


@dataclass(frozen=True)
class OnTheRig:
    """One leader of the simulated rig.

    Parameters
    ----------
    name : str
        Which.
    found : Identified
        By hand, with the motor constants.
    error : dict
        Excitation -> error of the force of another hand, of its rms.
    richness : dict
        Excitation -> `richness` of its motion.
    """

    name: str
    found: Identified
    error: dict[str, float]
    richness: dict[str, dict[str, float]]


def on_the_rig(seed: int = 1, seconds: float = 40.0, part: float = 1.0) -> list[OnTheRig]:
    """Leader of the simulated rig, moved by hand under its law: as built, and with `HIDDEN_RATIO`.

    Parameters
    ----------
    seed : int
        Of the hand.
    seconds : float
        Length of the session that a hand moves [s].
    part : float
        Of each session's length.
    """
    gain = {
        "effect": "torque-gain",
        "arm": "leader",
        "joint": "joint2",
        "amplitude": (HIDDEN_RATIO - 1.0) / 0.08,
    }
    out = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "s.mcap"
        for name, hidden in (("as built", []), (f"motor 2 x {HIDDEN_RATIO:g}", [gain])):
            moved = _by_hand(path, hidden, seed, part * seconds)
            played = load_rig(rig_path("identify"), {"simulation": {"hidden": hidden}})
            runner.run_session(played, part * _PLAYED, seed, "lockstep", path).enabled()
            driven = _filtered(path)
            found = identify_with_rank(*moved)
            laws = {
                BY_MOTORS: _by_motors(driven),
                BY_HAND: np.array([found.values[n] for n in PARAMETER_NAMES]),
            }
            judge = _by_hand(path, hidden, seed + _OTHER, part * _JUDGED)
            out.append(
                OnTheRig(
                    name,
                    found,
                    {k: _error(theta, judge) for k, theta in laws.items()},
                    {
                        k: richness(q, qd, qdd)
                        for k, (q, qd, qdd, *_) in ((BY_MOTORS, driven), (BY_HAND, moved))
                    },
                )
            )
    return out


#: The hand that judges is another one, by so many seeds.
_OTHER = 1000
#: What a hand moves the tip by along x, y and z, two standard deviations [m].  It swings more
#: than twice as far; with 6 cm along x one in 90 hands folds joint 3 beyond its range.
_SIZE = (0.05, 0.06, 0.06)


def _by_hand(path: Path, hidden: list[Any], seed: int, seconds: float) -> tuple[FloatArray, ...]:
    """What `_filtered` tells of a session in which a hand moves the leader."""
    hand = {"kind": "hand", "frequency": 0.8, "size": list(_SIZE)}
    simulation = {"hidden": hidden, "operator": hand, "gel": {"below_home": 0.01}}
    config = load_rig(rig_path("lawrence"), {"simulation": simulation})
    runner.run_session(config, seconds, seed, "lockstep", path).enabled()
    return _filtered(path)


def _filtered(path: Path) -> tuple[FloatArray, ...]:
    """q, q', q'', u and tau_s of a session's leader, all through the same zero-phase filter."""
    run = load(path, "leader")
    if run.wrench is None:
        raise RuntimeError("a session of this rig has forces")
    period = 1e-3
    b, a = butter(3, 2 * _CORNER * period)
    push = np.einsum("nkd,nk->nd", Premium(()).jacobian(run.q), run.wrench[:, :3])
    q, u, tau_s = (filtfilt(b, a, x, axis=0) for x in (run.q, run.tau, push))
    qd = np.gradient(q, period, axis=0)
    qdd = np.gradient(qd, period, axis=0)
    # the filter's ends, and the start of the session, stay out
    kept = slice(1000, -500, 4)
    return q[kept], qd[kept], qdd[kept], u[kept], tau_s[kept]


def _by_motors(motion: tuple[FloatArray, ...]) -> FloatArray:
    """All 17 values of an arm that its motors move alone; their constants are taken for 1."""
    q, qd, qdd, u, _ = motion
    x = hand_regressor(q, qd, qdd, u)
    theta, *_ = np.linalg.lstsq(x[:, :-3], u.reshape(-1), rcond=None)
    return np.concatenate([theta, np.ones(3)])


def _error(theta: FloatArray, motion: tuple[FloatArray, ...]) -> float:
    """Error of the force at the tip that a model tells of a motion, over the force's rms."""
    q, qd, qdd, u, tau_s = motion
    told = (hand_regressor(q, qd, qdd, u) @ theta).reshape(-1, 3)
    back = np.linalg.inv(np.swapaxes(Premium(()).jacobian(q), 1, 2))
    off, force = ((back @ x[:, :, None])[:, :, 0] for x in (told - tau_s, tau_s))
    return float(np.sqrt((off**2).sum() / (force**2).sum()))


# ------------------------------------------------------------ the command, and the page


def command(args: argparse.Namespace) -> Found:
    """What a hand, the motors, or both determine of an arm."""
    rows = study(args.seed)
    cells = [
        [
            r.name,
            f"{r.found.rank} of 17",
            f"{r.found.condition:.3g}",
            "-" if math.isnan(r.worst) else f"{100 * r.worst:.2f}",
        ]
        for r in rows
    ]
    head = ["excitation", "rank", "condition", "worst error of what is determined %"]
    text = terminal.table(head, cells)
    text += "".join(f"\n  {r.name}: {r.found.text}" for r in rows)
    rig = on_the_rig(args.seed, part=_QUICK if args.quick else 1.0)
    kappa = [
        [
            r.name,
            *(
                f"{r.found.values[f'j{j}.kappa']:.3f} +- {r.found.stderr[f'j{j}.kappa']:.1g}"
                for j in (1, 2, 3)
            ),
        ]
        for r in rig
    ]
    forces = [
        [
            f"{r.name}, {by}",
            f"{100 * r.error[by]:.1f}",
            f"{r.richness[by]['log_det']:.1f}",
            f"{100 * r.richness[by]['cells']:.0f}",
            f"{r.richness[by]['entropy']:.2f}",
        ]
        for r in rig
        for by in (BY_MOTORS, BY_HAND)
    ]
    text += "\n\nSimulated rig: a hand on the leader, the law's torques as dither\n"
    text += terminal.table(["motor constants found", "motor 1", "motor 2", "motor 3"], kappa)
    text += (
        "\n  +- takes the samples for independent and the friction for Coulomb and viscous; what"
        "\n  friction really is adds more than that\n\n"
    )
    head = ["identified by", "force error %", "log det", "speeds visited %", "entropy"]
    text += terminal.table(head, forces)
    text += (
        "\n  force error: of another hand's force, as the model tells it, of its rms"
        "\n  log det, speeds visited, entropy of the speeds: how rich the motion is"
    )
    return text, {"rows": [asdict(r) for r in rows], "rig": [asdict(r) for r in rig]}


def _page_rows(data: PageData) -> TableRows:
    none = float("nan")
    out: TableRows = {
        r["name"]: (
            float(r["found"]["rank"]),
            float(r["found"]["condition"]),
            none if r["worst"] is None else 100 * r["worst"],
            none,
            none,
        )
        for r in data["rows"]
    }
    for r in data["rig"]:
        for by in (BY_MOTORS, BY_HAND):
            rich = r["richness"][by]
            name = f"rig {r['name']}: {by}"
            out[name] = (none, none, none, 100 * r["error"][by], rich["log_det"])
    return out


def _page_read(found: Means) -> list[str]:
    exact = {n: v for n, v in found.items() if not n.startswith("rig ")}
    ranks = {name: round(values[0].mean) for name, values in exact.items()}
    less = {}
    for name in {n.partition(": ")[0] for n in found if n not in exact}:
        motors, hand = (found[f"{name}: {by}"][3].mean for by in (BY_MOTORS, BY_HAND))
        less[name] = f"{motors:.1f} % by the motors, {hand:.1f} % by hand, " + (
            f"{100 * (1 - hand / motors):.0f} % lower"
            if hand < motors
            else f"{100 * (hand / motors - 1):.0f} % higher"
        )
    most = max(ranks.values())
    whole = [n for n, k in ranks.items() if k == most]
    return [
        "Values that are determined, of 17: "
        + ", ".join(f"{k} by *{n}*" for n, k in ranks.items())
        + ". What a hand adds is a force of known size: without it all torques may be scaled "
        "together.",
        f"Most are determined by *{'* and *'.join(whole)}*, the motor constants among them. The "
        "thesis saw these move to values that it could only presume to be right; here the right "
        "ones are known.",
        "The thesis: the error of the interaction force is 21 to 35 % lower by hand. Here, for the "
        f"force of another hand: {'; '.join(f'{n}: {less[n]}' for n in sorted(less))}. How much "
        "there is to gain is how wrong the motor constants were that the motors' own excitation "
        "takes for right; nobody knew those of the thesis' Omni.",
    ]


PAGE = StudyPage(
    "What a hand, the motors, or both determine",
    "An arm with friction and motor constants that are a few percent wrong is moved by its "
    "motors, by a hand at a force sensor, or by both. The identification says which of its 17 "
    "values the motion determines. Then the leader of the simulated rig, as built and with a "
    f"constant of motor 2 that is {100 * (HIDDEN_RATIO - 1):.0f} % off: its motors move it alone, "
    "or a hand moves it while the law's torques act. *Force error*: of another hand's force at the "
    "tip, as the model tells it, of its rms. *Richness*: logarithm of the determinant of the "
    "scaled normal matrix; 0 is the most.",
    "Paper II: excitation by hand lowers the relative error of the interaction force by 21 to "
    "35 % against excitation by the motors.",
    (
        "excitation",
        "rank of 17",
        "condition",
        "worst error of what is determined %",
        "force error %",
        "richness",
    ),
    _page_rows,
    _page_read,
    quick=f"sessions of {100 * _QUICK:.0f} % of their length",
)
