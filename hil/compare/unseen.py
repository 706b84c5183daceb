"""What a motion could not have shown, so that no evidence for it is no evidence against it.

Computed from the recorded motion, joint by joint; each limit is one of mechanics:

- Stribeck friction acts at low speed.  Its excess over Coulomb friction, fading over a fiftieth of
  the top speed, is fitted beside everything else; what is smaller than  se sqrt(3 ln n)  (its
  price, n the effective instants) is not found: said where that is a tenth of Coulomb friction.
- Presliding and backlash act behind a reversal.  Each of the few states that are fitted needs
  several; below `TURNS` reversals one odd one decides.
- What repeats or grows over position needs the range; the part that was not visited is unknown.
- Friction under load needs a load that changes otherwise than the acceleration.
- Warming takes minutes.
- Without a measured external force a gain of the effort is a unit of all parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.compare.evidence import Evidence
from hil.excite.limits import of_robot
from hil.excite.recorded import output_words, robot_word
from hil.identify.design import Term
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.friction import Stribeck

FloatArray = NDArray[np.float64]
#: Share of the top speed that is low, and of Coulomb friction that would be missed there.
LOW, MISSED = 0.02, 0.10
#: Reversals.
TURNS = 10
#: Share of a joint's range, and of the effort's rms by which a static load must change.
RANGE, LOAD = 0.5, 0.1
#: Shortest recording in which something can warm up [s].
MINUTE = 60.0


@dataclass(frozen=True)
class Unseen:
    """Effects that a motion could not show, and why.

    Parameters
    ----------
    effects, joints : tuple of str
        What, and where; no joint is the whole robot.
    why : str
        Half a sentence.
    command : str
        What plans a motion that would; empty where none does.
    """

    effects: tuple[str, ...]
    joints: tuple[str, ...]
    why: str
    command: str = ""

    def hides(self, effect: str, joint: str) -> bool:
        """Whether it is this effect on this joint that could not be shown."""
        return effect in self.effects and (not self.joints or joint in self.joints)

    @property
    def text(self) -> str:
        """One line for people."""
        where = f" on {', '.join(self.joints)}" if self.joints else ""
        how = f": {self.command}" if self.command else ""
        return f"{', '.join(self.effects)}{where}: {self.why}{how}"


def unseen(result: FitResult, evidence: Evidence) -> list[Unseen]:
    """What the fitted runs could not show; effects that the model has already are left out.

    Parameters
    ----------
    result : FitResult
        The last fit.
    evidence : Evidence
        Beside it.
    """
    problem = result.problem
    if result.model.explains != "motor":
        return []
    found: dict[tuple[tuple[str, ...], str], list[str]] = {}
    for j in np.flatnonzero(~problem.holds).tolist():
        there = {t.effect.name for t in result.terms if t.joint == j or t.effect.whole_robot}
        for effects, why in _of_joint(problem, j):
            new = tuple(e for e in effects if e not in there)
            if new:
                found.setdefault((new, why), []).append(problem.joints[j])
    out = [
        Unseen(effects, tuple(joints), why, _command(effects[0], problem, joints))
        for (effects, why), joints in found.items()
    ]
    return [*_low_speed(result, evidence), *out, *_of_all(problem)]


def _command(effect: str, problem: Problem, joints: Sequence[str]) -> str:
    """What plans a motion that shows an effect; empty where the robot's own motion cannot."""
    places = [problem.joints.index(name) for name in joints]
    loaded = any(np.any(m.static[:, places]) for m in problem.motions)
    if effect == "load-friction" and not loaded:
        return ""
    where = f" --joint {joints[0]}" if len(joints) == 1 and problem.d > 1 else ""
    out = " ".join(output_words(problem))
    return f"hil excite {robot_word(problem)} --for {effect}{where} {out}"


def _low_speed(result: FitResult, evidence: Evidence) -> list[Unseen]:
    """Stribeck friction that would go unseen, over all joints with Coulomb friction."""
    problem, missed = result.problem, {}
    for j in np.flatnonzero(~problem.holds).tolist():
        fc = result.values.get(f"j{j + 1}.coulomb.fc")
        share = _missed(result, evidence, j) / fc.value if fc and fc.value > 0 else 0.0
        if share > MISSED and (Stribeck.name, j) not in {t.key for t in result.terms}:
            missed[problem.joints[j]] = share
    if not missed:
        return []
    why = (
        f"too little motion is slower than {100 * LOW:g} % of the top speed; friction that rises "
        f"only there goes unseen{_up_to(max(missed.values()))}"
    )
    command = _command(Stribeck.name, problem, list(missed))
    return [Unseen((Stribeck.name, "presliding"), tuple(missed), why, command)]


def _up_to(share: float) -> str:
    """How much of Coulomb friction is missed, where that says anything."""
    return f" up to {100 * share:.2g} % of Coulomb friction" if share < 1.0 else ", however large"


def _missed(result: FitResult, evidence: Evidence, j: int) -> float:
    """Excess of static friction that pays no more than its price [N m or N]; infinite if unseen."""
    problem, floor, projector = result.problem, evidence.floor, evidence.projector
    speed = np.abs(problem.qd[j][problem.live[j]])
    if projector is None or not speed.size:
        return 0.0
    vs = LOW * float(np.quantile(speed, 0.995))
    effect = Stribeck()
    _, _, inverse, _ = projector.score(Term(effect, j, (vs, 2.0)))
    noise = (floor.scale[j] / result.sigma[j]) ** 2 * floor.inflation[j]
    instants = max(float(floor.effective(problem)[j]), 2.0)
    count = len(effect.params) + len(effect.shape)
    return float(np.sqrt(inverse[0, 0] * noise * count * np.log(instants)))


def _of_joint(problem: Problem, j: int) -> Iterator[tuple[tuple[str, ...], str]]:
    """Effects and reasons of one joint."""
    turns = _reversals(problem, j)
    if turns < TURNS:
        yield ("presliding", "backlash"), f"fewer than {TURNS} reversals"
    limits = of_robot(problem.source)
    if limits is not None and np.ptp(problem.q[j]) < RANGE * (limits.high[j] - limits.low[j]):
        yield ("position-torque", "cogging", "end-stop"), "less than half of its range was visited"
    if _steady(problem, j):
        yield ("load-friction",), "its static and external load hardly change"


def _reversals(problem: Problem, j: int) -> int:
    """Changes of the direction of motion, standstill left out, within the runs."""
    count = 0
    for k in range(len(problem.recordings)):
        v = problem.qd[j][(problem.run == k) & problem.live[j]]
        count += int(np.sum(np.diff(np.sign(v[v != 0.0])) != 0))
    return count


def _steady(problem: Problem, j: int) -> bool:
    """Whether neither gravity, springs nor an external force change the load."""
    static = np.concatenate([m.static[:, j] + m.tau_ext[:, j] for m in problem.motions])
    size = float(np.sqrt(np.mean(problem.effort[j] ** 2)))
    return bool(np.std(static) < LOAD * size)


def _of_all(problem: Problem) -> list[Unseen]:
    """What concerns the whole robot."""
    out = []
    length = max(float(r.t[-1] - r.t[0]) for r in problem.recordings)
    if length < MINUTE:
        why = f"the longest recording has {length:.3g} s, and warming mostly takes minutes"
        out.append(Unseen(("friction-drift",), (), why))
    if not any(np.any(m.tau_ext) or np.any(m.wrench) for m in problem.motions):
        why = "no external force was measured; without one it scales all parameters alike"
        out.append(Unseen(("torque-gain",), (), why))
    return out
