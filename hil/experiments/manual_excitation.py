"""Manual excitation: what a hand, the motors, or both determine (thesis paper II).

First synthetic motion of a Premium 1.5 with friction and wrong motor constants: the torques follow
from the equation of motion, plus noise.  Then the simulated rig: a hand moves the leader, the law's
own torques are the dither, and one motor constant is wrong by a known share.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.signal import butter, filtfilt

from hil import terminal
from hil.estimate import manual_excitation
from hil.estimate.manual_excitation import FloatArray, Identified
from hil.experiments.pages import Data, Means, Rows, StudyPage
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
    bare = (manual_excitation.regressor(q, qd, qdd, zero) @ _TRUE).reshape(-1, 3)
    dither = 0.02 * np.sin(2 * np.pi * t[:, None] * np.array([1.1, 1.7, 0.6]))
    cases = {
        "motors, no hand": (bare / _TRUE[14:], zero),
        "hand, motors off": (zero, bare),
        "hand and dither": (dither, bare - dither * _TRUE[14:]),
    }
    rows = []
    for name, (u, tau_s) in cases.items():
        noise = _NOISE * rng.normal(size=q.shape) if tau_s.any() else zero
        found = manual_excitation.identify(q, qd, qdd, u, tau_s + noise)
        known = [n for n in manual_excitation.NAMES if n not in found.undetermined]
        errors = [abs(found.values[n] / _TRUE[manual_excitation.NAMES.index(n)] - 1) for n in known]
        rows.append(ManualExcitationRow(name, found, max(errors, default=float("nan"))))
    return rows


#: Motor constant of joint 2 that the simulated leader hides, and the zero-phase filter [Hz].
WRONG, _CORNER = 1.08, 8.0


def on_the_rig(seed: int = 1, seconds: float = 40.0) -> dict[str, Identified]:
    """Leader of the simulated rig, moved by hand under its law: as built, and with `WRONG`.

    Parameters
    ----------
    seed : int
        Of the hand.
    seconds : float
        Length of each session [s].

    Returns
    -------
    dict
        Which arm -> what was identified.
    """
    gain = {
        "effect": "torque-gain",
        "arm": "leader",
        "joint": "joint2",
        "amplitude": (WRONG - 1.0) / 0.08,
    }
    hand = {"kind": "hand", "frequency": 0.8, "size": [0.06, 0.06, 0.06]}
    out = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, hidden in (("as built", []), (f"motor 2 x {WRONG:g}", [gain])):
            simulation = {"hidden": hidden, "operator": hand, "gel": {"below_home": 0.01}}
            path = Path(folder) / "s.mcap"
            config = load_rig(rig_path("lawrence"), {"simulation": simulation})
            runner.run(config, seconds, seed, "lockstep", path).enabled()
            out[name] = _identified(path)
    return out


def _identified(path: Path) -> Identified:
    """Parameters from a session's leader, everything through the same zero-phase filter."""
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
    return manual_excitation.identify(q[kept], qd[kept], qdd[kept], u[kept], tau_s[kept])


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
    rig = on_the_rig(args.seed)
    kappa = [
        [
            name,
            *(f"{f.values[f'j{j}.kappa']:.3f} +- {f.stderr[f'j{j}.kappa']:.1g}" for j in (1, 2, 3)),
        ]
        for name, f in rig.items()
    ]
    text += "\n\nSimulated rig: a hand on the leader, the law's torques as dither\n"
    text += terminal.table(["motor constants found", "motor 1", "motor 2", "motor 3"], kappa)
    text += (
        "\n  +- takes the samples for independent and the friction for Coulomb and viscous; what"
        "\n  friction really is adds more than that"
    )
    return text, {
        "rows": [asdict(r) for r in rows],
        "rig": {k: asdict(f) for k, f in rig.items()},
    }


def _page_rows(data: Data) -> Rows:
    return {
        r["name"]: (
            float(r["found"]["rank"]),
            float(r["found"]["condition"]),
            float("nan") if r["worst"] is None else 100 * r["worst"],
        )
        for r in data["rows"]
    }


def _page_read(found: Means) -> list[str]:
    ranks = {name: round(values[0].mean) for name, values in found.items()}
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
        "The thesis' 21 to 35 % are of the interaction force on an Omni whose constants nobody "
        "knew; how much there is to gain depends on how wrong they were, which is why no number "
        "of ours stands beside them.",
    ]


PAGE = StudyPage(
    "What a hand, the motors, or both determine",
    "An arm with friction and motor constants that are a few percent wrong is moved by its "
    "motors, by a hand at a force sensor, or by both. The identification says which of its 17 "
    "values the motion determines.",
    "Paper II: excitation by hand lowers the relative error of the interaction force by 21 to "
    "35 % against excitation by the motors.",
    ("excitation", "rank of 17", "condition", "worst error of what is determined %"),
    _page_rows,
    _page_read,
)
