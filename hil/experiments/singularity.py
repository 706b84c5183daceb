"""How close to the force estimation singularity a teleoperator may come (thesis 5.2, open).

A law that estimates both forces solves Q f = -R(v); the relative distance of Q to the nearest
singular matrix is 1 / kappa.  The thesis asks for the safe distance of given hardware, and which
part of the hardware shortens it.  Here one axis of two arms runs in time, each a rotor and a tip
on an elastic cable with Stribeck friction, between a hand that moves up and down and a gel.  One
thing is changed at a time; for each, kappa is raised until the run is

    not stable      the arms leave the workspace, or shake above 15 Hz
    not accurate    the estimated forces are wrong by more than a share of their rms

All designs and conditions of a seed run side by side.  The plant is this file's own: nothing of
the law's kernels or of the simulated rig is in it.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hil import terminal
from hil.experiments.pages import Means, PageData, SeedMean, StudyPage, TableRows
from hil.teleop import force_sensor_free, gate
from hil.teleop.architecture import Design, MotionTerm, Realisation, RobotImpedance
from hil.teleop.hybrid import FloatArray, Impedance
from hil.teleop.sampled_loop import Cable, SampledLoop, dominant_mode
from hil.terminal import Found

_PERIOD, _SUBSTEPS, _SECONDS = 1e-3, 8, 5.0
#: Hand's motion [Hz], [m]; the gel's surface is at zero.
_HZ, _SIZE = 1.0, 0.012
#: Law: motion gains [N/m], [N s/m], local force gains, corner of the speed's filter [Hz].
_PULL, _LOCAL, _VELOCITY_HZ = MotionTerm(130.0, 0.8), 0.1, 80.0
#: Masses of master and slave at the tip with rotor, and of the rotors [kg]; cable [N/m], [N s/m].
_MASSES, _ROTOR, _CABLE = (0.125, 0.07), 0.0035, (3500.0, 0.5)
#: Friction at the rotor: Coulomb, Stribeck's rise [N], its speed [m/s], viscous [N s/m].
_COULOMB, _RISE, _STRIBECK, _VISCOUS = 0.05, 0.02, 0.01, 0.15
#: Speed over which the sign of friction turns [m/s]; noise of an accelerometer [m/s^2].
_TURN, _NOISE = 1e-3, 0.05
#: What is unsafe: place [m], speed above 15 Hz [m/s] rms; what is inaccurate: share of the rms.
_FAR, _SHAKE_HZ, _SHAKE, _ACCURATE = 0.1, 15.0, 0.01, 0.25
#: Conditions of Q that are tried.
KAPPAS: FloatArray = np.geomspace(1.1, 8.0, 16)
QUICK_KAPPAS: FloatArray = KAPPAS[::2]


@dataclass(frozen=True)
class Hardware:
    """What the hardware and its model are worth.

    Parameters
    ----------
    friction : float
        Part of the friction that the law's model holds and compensates.
    accelerometer : str
        ``""``: speed's difference; ``"motor"`` or ``"tip"``: where an accelerometer sits.
    step : float
        Encoder's resolution at the tip [m]; 0 = exact.
    corner : float
        Of the acceleration's filter [Hz].
    delay : int
        Of the channel, each way [ticks].
    """

    friction: float = 0.9
    accelerometer: str = ""
    step: float = 30e-6
    corner: float = 5.0
    delay: int = 0


BASE = Hardware()
#: Factor -> level -> hardware; one thing differs from `BASE` at a time.
_FACTORS: Mapping[str, Mapping[str, Hardware]] = {
    "friction model": {
        f"{100 * s:.0f} % known": replace(BASE, friction=s) for s in (0.0, 0.5, 1.0, 1.1)
    },
    "acceleration": {
        f"accelerometer at the {p}": replace(BASE, accelerometer=p) for p in ("motor", "tip")
    },
    "encoder": {
        f"{1e6 * s:g} um" if s else "exact": replace(BASE, step=s) for s in (120e-6, 7.5e-6, 0.0)
    },
    "filter corner": {f"{f:g} Hz": replace(BASE, corner=f) for f in (1.0, 2.0, 10.0, 30.0)},
    "delay": {f"{d} ms": replace(BASE, delay=d) for d in (1, 2, 5, 10)},
}
AS_BUILT = "as built"


@dataclass(frozen=True)
class SingularityRow:
    """One condition.

    Parameters
    ----------
    factor, level : str
        What was changed, and to what.
    stable, accurate : float
        Largest kappa up to which runs are stable, and also accurate; 1 = none that was tried.
    handed_back : float
        c2 = c3 at `stable`: the share of the force that the law hands over.
    linear : float
        Largest kappa with stable eigenvalues, no friction and exact encoders; NaN with an
        accelerometer, which the linear loop has not.
    """

    factor: str
    level: str
    stable: float
    accurate: float
    handed_back: float
    linear: float


def share(kappa: Any) -> Any:
    """c2 = c3 of the design with this condition of Q: kappa = (1 + c5 + c2) / (1 + c5 - c2)."""
    return (1 + _LOCAL) * (kappa - 1) / (kappa + 1)


def design(kappa: float) -> Design:
    """Force-sensor-free equivalent of the four-channel design with this condition of Q."""
    c2 = float(share(kappa))
    own = Design(
        c1=_PULL, c4=-_PULL, c7=_PULL, c8=_PULL, c2=c2, c3=c2, c5=_LOCAL, c6=_LOCAL,
        master=RobotImpedance(_MASSES[0]), slave=RobotImpedance(_MASSES[1]), name="four-channel",
    )  # fmt: skip
    return force_sensor_free.transform(own, limit=float("inf"))


def study(seed: int = 1, kappas: FloatArray = KAPPAS) -> list[SingularityRow]:
    """All conditions with the plant of one seed."""
    names = [("", AS_BUILT), *((f, level) for f, levels in _FACTORS.items() for level in levels)]
    wares = [BASE, *(h for levels in _FACTORS.values() for h in levels.values())]
    stable, accurate = verdicts(wares, seed, kappas)
    rows = []
    for (factor, level), ware, runs, right in zip(names, wares, stable, accurate, strict=True):
        far = _last(kappas, runs)
        near = _last(kappas, runs & right)
        rows.append(
            SingularityRow(factor, level, far, near, float(share(far)), linear(ware, kappas))
        )
    return rows


def _last(kappas: FloatArray, good: Any) -> float:
    """Largest kappa before the first that is not good."""
    n = int(np.argmin(good)) if not good.all() else len(good)
    return float(kappas[n - 1]) if n else 1.0


def linear(ware: Hardware, kappas: FloatArray = KAPPAS) -> float:
    """Largest kappa whose eigenvalues are stable with the seeds' middle hand and gel."""
    if ware.accelerometer:
        return float("nan")
    late = ware.delay * _PERIOD
    real = Realisation(_VELOCITY_HZ, ware.corner, 60.0, late, late)
    hand, cable = Impedance(0.25, 3.0, 120.0), Cable(*_CABLE, _ROTOR)

    def good(kappa: float) -> bool:
        loop = SampledLoop(design(kappa), real, cable=cable, friction=(_VISCOUS, _VISCOUS))
        pairs = (Impedance(0.0, 0.0, 0.0), Impedance(0.0, 1.5, 350.0))
        return all(dominant_mode(loop, hand, ze, _PERIOD)[0] <= 1.0 + gate.GROWTH for ze in pairs)

    low, high = 0, len(kappas)
    while low < high:
        middle = (low + high) // 2
        low, high = (middle + 1, high) if good(float(kappas[middle])) else (low, middle)
    return float(kappas[low - 1]) if low else 1.0


# ---------------------------------------------------------------- the plant, all lanes at once


def verdicts(wares: Sequence[Hardware], seed: int, kappas: FloatArray) -> tuple[Any, Any]:
    """Whether each condition (rows) is stable and accurate with each kappa (columns)."""
    lanes = _Lanes(wares, seed, kappas)
    ticks = round(_SECONDS / _PERIOD)
    for k in range(ticks):
        lanes.tick(k, watched=k * _PERIOD >= 2.0)
    shape = (len(wares), len(kappas))
    shake, wrong = lanes.found()
    stable = ~lanes.lost & (shake < _SHAKE)
    return stable.reshape(shape), (wrong < _ACCURATE).reshape(shape)


class _Lanes:
    """One axis of both arms, for every condition and kappa; arrays (arms, lanes)."""

    def __init__(self, wares: Sequence[Hardware], seed: int, kappas: FloatArray) -> None:
        self._draw(np.random.default_rng(seed))
        n, each = len(wares) * len(kappas), len(kappas)
        self._laws([design(float(k)) for k in kappas], len(wares))

        def of(name: str) -> Any:
            return np.repeat([float(getattr(w, name)) for w in wares], each)

        self.known, self.step, self.late = of("friction"), of("step"), of("delay").astype(int)
        self.alpha = 1 - np.exp(-2 * np.pi * of("corner") * _PERIOD)
        where = np.repeat([("", "motor", "tip").index(w.accelerometer) for w in wares], each)
        self.motor, self.tip = where == 1, where == 2

        def z() -> Any:
            return np.zeros((2, n))

        self.xr, self.vr, self.xt, self.vt = z(), z(), z(), z()
        self.xr -= 0.25 * _SIZE
        self.xt -= 0.25 * _SIZE
        self.ar, self.at, self.v, self.raw, self.a = z(), z(), z(), z(), z()
        self.past: Any = None
        self.line = np.zeros((int(self.late.max()) + 1, 3, 2, n))
        self.slow, self.sums = np.zeros((2, 2, n)), np.zeros((3, 2, n))
        self.lost, self.pick = np.zeros(n, bool), np.arange(n)

    def _draw(self, rng: np.random.Generator) -> None:
        """Arms that are not quite those of the model; a hand; a gel; noise."""
        self.rng = rng
        masses = np.array(_MASSES) * rng.uniform(0.95, 1.05, 2)
        self.rub = rng.uniform(0.8, 1.2, (2, 1))
        self.hand = (rng.uniform(0.1, 0.4), 3.0, rng.uniform(60.0, 180.0))
        self.gel = (rng.uniform(200.0, 500.0), 1.5)
        self.phase = rng.uniform(0.0, 2 * np.pi)
        self.mt = (masses - _ROTOR)[:, None] + np.array([[self.hand[0]], [0.0]])

    def _laws(self, designs: Sequence[Design], times: int) -> None:
        """Gains (k, b, a) of the transform, and of the original law for its estimate."""

        def row(name: str) -> Any:
            terms = [getattr(d, name) for d in designs]
            return np.tile(np.array([[c.k, c.b, c.a] for c in terms]).T, times)

        self.c1, self.c4, self.c7, self.c8 = (row(c) for c in ("c1", "c4", "c7", "c8"))

    def friction(self, v: Any) -> Any:
        """Force of the friction against a speed [N]."""
        level = _COULOMB + _RISE * np.exp(-((v / _STRIBECK) ** 2))
        return self.rub * (level * np.tanh(v / _TURN) + _VISCOUS * v)

    def _sense(self) -> Any:
        """What the law sees: place, speed, acceleration, (3, arms, lanes)."""
        x = np.where(
            self.step > 0, np.floor(self.xr / np.maximum(self.step, 1e-9)) * self.step, self.xr
        )
        raw = np.zeros_like(x) if self.past is None else (x - self.past) / _PERIOD
        self.v += (1 - np.exp(-2 * np.pi * _VELOCITY_HZ * _PERIOD)) * (raw - self.v)
        told = np.where(self.motor, self.ar, self.at) + _NOISE * self.rng.normal(size=(2, 1))
        a = np.where(self.motor | self.tip, told, (raw - self.raw) / _PERIOD)
        self.a += self.alpha * (a - self.a)
        self.past, self.raw = x, raw
        return np.stack([x + 0.25 * _SIZE, self.v, self.a])

    def tick(self, k: int, watched: bool) -> None:
        """One period: sense, law, plant."""
        own = self._sense()
        n = len(self.line)
        self.line[k % n] = own
        heard = (
            self.line[(k - self.late) % n, :, :, self.pick] if k >= n else own.transpose(2, 0, 1)
        )
        far = heard.transpose(1, 2, 0)

        def pull(c: Any, w: Any) -> Any:
            return c[0] * w[0] + c[1] * w[1] + c[2] * w[2]

        asked = np.stack(
            [
                -pull(self.c4, far[:, 1]) - pull(self.c8, own[:, 0]),
                pull(self.c1, far[:, 0]) - pull(self.c7, own[:, 1]),
            ]
        )
        helped = self.known * self.friction(own[1])
        felt = self._move(k, asked + helped)
        bad = ~(np.abs(self.xr) < _FAR).all(0)
        self.lost |= bad
        for x in (self.xr, self.vr, self.xt, self.vt, self.v, self.raw, self.a, self.ar, self.at):
            x[:, self.lost] = 0.0
        if watched:
            self._watch(own[2], asked, felt)

    def _move(self, k: int, u: Any) -> Any:
        """The plant over one period; forces f_m on the master, f_s by the slave [N]."""
        dt, (mh, bh, kh), (kg, bg) = _PERIOD / _SUBSTEPS, self.hand, self.gel
        last = self.vr.copy(), self.vt.copy()
        forces = np.zeros_like(u)
        for j in range(_SUBSTEPS):
            w, t = 2 * np.pi * _HZ, (k + j / _SUBSTEPS) * _PERIOD
            up = min(t, 1.0)
            goal, speed = _SIZE * up * np.sin(w * t), _SIZE * up * w * np.cos(w * t)
            stretch = _CABLE[0] * (self.xr - self.xt) + _CABLE[1] * (self.vr - self.vt)
            # friction at the end of the step, else its slope at rest is too steep
            push = self.vr + dt / _ROTOR * (u - stretch)
            slope = self.rub * ((_COULOMB + _RISE) / _TURN + _VISCOUS) * dt / _ROTOR
            rub = self._rubbed(push, slope)
            self.vr = rub
            hand = kh * (goal - 0.25 * _SIZE - self.xt[0]) + bh * (speed - self.vt[0])
            gel = np.where(self.xt[1] > 0, np.maximum(kg * self.xt[1] + bg * self.vt[1], 0.0), 0.0)
            rate = (stretch + np.stack([hand, -gel])) / self.mt
            self.vt = self.vt + dt * rate
            self.xr = self.xr + dt * self.vr
            self.xt = self.xt + dt * self.vt
            forces += np.stack([hand - mh * rate[0], gel]) / _SUBSTEPS
        self.ar, self.at = (self.vr - last[0]) / _PERIOD, (self.vt - last[1]) / _PERIOD
        return forces

    def _rubbed(self, push: Any, slope: Any) -> Any:
        """Speed v with v + dt/m friction(v) = push, by Newton steps that a bracket keeps."""
        gain = _PERIOD / _SUBSTEPS / _ROTOR
        low, high = np.minimum(push, 0.0), np.maximum(push, 0.0)
        v = push / (1 + slope)
        for _ in range(3):
            off = v + gain * self.friction(v) - push
            high, low = np.where(off > 0, v, high), np.where(off > 0, low, v)
            c = np.cosh(np.clip(v / _TURN, -30, 30))
            steep = 1 + gain * self.rub * (_COULOMB / _TURN / c**2 + _VISCOUS)
            v = v - off / steep
            v = np.where((v < low) | (v > high), 0.5 * (low + high), v)
        return v

    def _watch(self, a: Any, asked: Any, felt: Any) -> None:
        """Sums for shaking above 15 Hz, and for the error of the estimates."""
        fast = self.vr
        for slow in self.slow:  # two high-passes in a row
            slow += (1 - np.exp(-2 * np.pi * _SHAKE_HZ * _PERIOD)) * (fast - slow)
            fast = fast - slow
        # the transform holds no force: what moves the robot less what was asked of it
        masses = np.array(_MASSES)[:, None]
        guess = (masses * a - asked) * np.array([[1.0], [-1.0]])
        self.sums += np.stack([fast**2, (guess - felt) ** 2, felt**2])

    def found(self) -> tuple[Any, Any]:
        """Speed above 15 Hz [m/s] rms, and the error of the forces over their rms; (lanes,)."""
        watched = round((_SECONDS - 2.0) / _PERIOD)
        shake, wrong, size = self.sums
        share = np.sqrt(wrong.sum(0) / np.maximum(size.sum(0), 1e-12))
        return np.sqrt(shake.max(0) / watched), share


# ------------------------------------------------------------ the command, and the page


def command(args: argparse.Namespace) -> Found:
    """How close to the force estimation singularity the hardware lets a law come."""
    rows = study(args.seed, QUICK_KAPPAS if args.quick else KAPPAS)
    cells = [
        [
            r.factor,
            r.level,
            *(f"{x:.2f}" for x in (r.stable, r.handed_back, r.accurate)),
            "-" if math.isnan(r.linear) else f"{r.linear:.2f}",
        ]
        for r in rows
    ]
    head = ["changed", "to", *PAGE.head[1:]]
    return terminal.table(head, cells), {"rows": [asdict(r) for r in rows]}


def _page_rows(data: PageData) -> TableRows:
    return {
        f"{r['factor']}: {r['level']}" if r["factor"] else r["level"]: (
            r["stable"],
            r["handed_back"],
            r["accurate"],
            float("nan") if r["linear"] is None else r["linear"],
        )
        for r in data["rows"]
    }


def _page_read(found: Means) -> list[str]:
    built = next(v for k, v in found.items() if ": " not in k)
    levels: dict[str, dict[str, Sequence[SeedMean]]] = {}
    for name, values in found.items():
        factor, colon, level = name.partition(": ")
        if colon:
            levels.setdefault(factor, {})[level] = values
    order = {k: _best(levels, built, k) for k in (0, 2)}
    firm, exact = (
        ", ".join(f"{n} ({lv}: {gain:+.2f})" for n, (lv, gain) in order[k].items()) for k in (0, 2)
    )
    worst = {n: min(v.items(), key=lambda x: x[1][0].mean) for n, v in levels.items()}
    friction, acceleration = (order[0][n][1] for n in ("friction model", "acceleration"))
    first = "acceleration" if acceleration > friction else "friction"
    past = [v for v in found.values() if np.isfinite(v[3].mean)]
    sooner = sum(v[0].mean < v[3].mean for v in past)
    return [
        f"The safe distance as built: stable up to kappa {built[0]}, so that {built[1]} of the "
        f"force can be handed over; estimates right to a quarter up to kappa {built[2]}.",
        f"What helps stability, ranked by the kappa that the best level gains: {firm}.",
        f"What helps the estimates, ranked in the same way: {exact}.",
        "What costs most, by the stable kappa of the worst level: "
        + ", ".join(
            f"{n} ({lv}: {v[0].mean:.2f})"
            for n, (lv, v) in sorted(worst.items(), key=lambda x: x[1][1][0].mean)
        )
        + ".",
        f"The thesis' question, friction or acceleration: the measurement of {first} counts more "
        f"for stability ({acceleration:+.2f} against {friction:+.2f} in kappa).",
        f"Eigenvalues of the linear loop promise more than runs keep in {sooner} of {len(past)} "
        "conditions: they know neither the steps of the encoder nor dry friction nor the loss of "
        "contact.",
    ]


def _best(
    levels: Mapping[str, Means], built: Sequence[SeedMean], k: int
) -> dict[str, tuple[str, float]]:
    """Best level of each factor and what it gains in column k, the largest gain first."""
    best = {n: max(v.items(), key=lambda x: x[1][k].mean) for n, v in levels.items()}
    gains = {n: (lv, v[k].mean - built[k].mean) for n, (lv, v) in best.items()}
    return dict(sorted(gains.items(), key=lambda x: -x[1][1]))


PAGE = StudyPage(
    "The safe distance to the force estimation singularity",
    "One axis of two arms with elastic cables, dry friction, encoders and filters runs a law "
    "that estimates both forces. One thing of the hardware is changed at a time. The condition "
    "kappa of Q is raised until the arms shake or leave the workspace (stable), or the "
    "estimated forces are wrong by more than 25 % of their rms (accurate); 1 is the farthest "
    "from the singularity, and stands where no kappa that was tried is safe. Arms, friction, "
    "hand and gel differ with the seed.",
    "Section 5.2, open: which distance to the singularity is safe for given hardware, and what "
    "makes it shorter most cheaply; for example, accurate friction estimation or accurate "
    "acceleration measurement?",
    ("hardware", "stable kappa", "force handed over", "accurate kappa", "by eigenvalues"),
    _page_rows,
    _page_read,
    "Largest condition of Q that is safe",
    (0, 2),
    quick=f"{len(QUICK_KAPPAS)} kappas of {len(KAPPAS)}",
)
