"""One recording of one robot on request (entry point ``mujoco`` of ``hil.sim_sessions``)."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import exp, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hil.errors import ConfigError, unknown
from hil.sim_devices.mujoco_plants import describe, laws
from hil.sim_devices.mujoco_plants.describe import Additions
from hil.sim_devices.mujoco_plants.laws import EffectPlace, PlantState
from hil.sim_devices.mujoco_plants.robots import ROBOTS, SimulatedRobot

# Names of all hidden effects: what each needs, and between which amplitudes it is itself.

#: Smallest and largest amplitude where nothing else is said.
_USUAL = (0.0, 60.0)

#: ``"force"``: a measured force; ``"arm"``: more than one joint; ``"runs"``: a run with and one
#: without; ``"urdf"``: a described robot with its weight on some joint; ``"chain"``: one of three
#: joints or more.
_NEEDS = {
    "coupled-friction": "arm",
    "posture-friction": "arm",
    "capstan-friction": "arm",
    "coupled-load-friction": "arm",
    "coupled-spring": "arm",
    "torque-crosstalk": "arm",
    "coupled-transmission": "arm",
    "differential": "arm",
    "payload": "runs",
    "payload-change": "urdf",
    "outside-slosh": "urdf",
    "joint-zero": "chain",
    "joint-ratio": "chain",
    "torque-gain": "force",
    "filter-lag": "force",
    "force-bias": "force",
    "force-drift": "force",
    "force-gain": "force",
    "force-crosstalk": "force",
}

_RANGES = {
    "friction-drift": (0.0, 40.0),
    "torque-saturation": (0.05, 8.0),
    "torque-gain": (0.0, 8.0),
    "torque-ripple": (0.0, 8.0),
    "asymmetric-gain": (0.0, 8.0),
    "actuator-lag": (0.1, 6.0),
    "delay": (0.1, 5.0),
    "elastic-transmission": (0.15, 8.0),
    "hardening-cable": (0.15, 8.0),
    "encoder-eccentricity": (0.0, 30.0),
    "end-stop": (0.02, 200.0),
    "joint-zero": (0.0, 5.0),
    "joint-ratio": (0.0, 3.0),
    "load-friction": (0.0, 8.0),
    "load-viscous": (0.0, 8.0),
    "coupled-load-friction": (0.0, 8.0),
    "coupled-spring": (0.0, 10.0),
    "gain-drift": (0.0, 8.0),
    "varying-gain": (0.0, 10.0),
    "capstan-friction": (0.0, 8.0),
    "filter-lag": (0.1, 6.0),
}

#: Laws that came after the plans had numbered the others: they are numbered last.
LATER = (
    "sublinear-viscous",
    "local-friction",
    "two-stops",
    "differential",
    "asymmetric-gain",
    "joint-zero",
    "joint-ratio",
    "posture-friction",
    "varying-gain",
    "capstan-friction",
    "load-viscous",
    "coupled-load-friction",
    "coupled-spring",
)
#: Laws that had no name then: they keep their numbers.
UNNAMED = {
    "dead-zone": "outside-dead-zone",
    "gain-drift": "outside-warm-gain",
    "relaxation": "outside-creeping-hose",
}

NAMES = sorted(
    {"payload-change"}.union(
        laws.MOTOR,
        laws.LINK,
        laws.DRIVES,
        laws.ENCODERS,
        laws.RECORDED,
        describe.SHAFTS,
        describe.STRUCTURES,
    ).difference(LATER),
    key=lambda name: UNNAMED.get(name, name),
) + list(LATER)


def kinds() -> dict[str, tuple[str, float, float]]:
    """Name -> what it needs, smallest and largest amplitude."""
    return {name: (_NEEDS.get(name, ""), *_RANGES.get(name, _USUAL)) for name in NAMES}


# Reference motions of the test plants: wandering sines, shuttles, way points.

FloatArray = NDArray[np.float64]
#: Seconds within which a motion swells, and comes to rest again.
SWELL = 1.5


def reference(robot: SimulatedRobot, kind: str, seed: int, step: float) -> FloatArray:
    """Place, speed and acceleration of every joint, (n, d, 3) [rad or m, per s, per s^2].

    Parameters
    ----------
    robot : Robot
    kind : str
        One of `MOTIONS`.
    seed : int
        Chooses the motion.
    step : float
        Time between samples [s].
    """
    rng = np.random.default_rng([seed, sorted(MAKERS).index(kind), 0x30CA])
    t = step * np.arange(round(robot.seconds / step), dtype=np.float64)
    out = np.empty((t.size, len(robot.links), 3))
    for k, link in enumerate(robot.links):
        x = MAKERS[kind](rng, t, link.reach, link.speed)
        # within the reach and the speed of the joint
        x = x * min(1.0, link.reach / np.abs(x).max())
        speed = np.abs(np.gradient(x, t)).max()
        x = link.middle + _swell(t) * x * min(1.0, link.speed / speed)
        v = np.gradient(x, t, edge_order=2)
        out[:, k, 0], out[:, k, 1], out[:, k, 2] = x, v, np.gradient(v, t, edge_order=2)
    return out


def _swell(t: FloatArray) -> FloatArray:
    """Quintic from rest at both ends."""
    u: FloatArray = np.clip(np.minimum(t, t[-1] - t) / SWELL, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2)


def _sines(rng: np.random.Generator, t: FloatArray, reach: float, speed: float) -> FloatArray:
    """Sines of no common period, each of which comes and goes."""
    out = np.zeros_like(t)
    for f in 0.07 * 26.0 ** rng.uniform(0.0, 1.0, 11):
        phase, slow = rng.uniform(0.0, 2 * np.pi, 2)
        height = min(0.55 * reach, 0.16 * speed / f)
        breath = 0.6 + 0.4 * np.cos(2 * np.pi * rng.uniform(0.02, 0.07) * t + slow)
        out += height * breath * np.sin(2 * np.pi * f * t + phase)
    return out


def _shuttle(rng: np.random.Generator, t: FloatArray, reach: float, speed: float) -> FloatArray:
    """There and back at speeds from a twentieth of the largest on; corners rounded."""
    knots, places, side = [0.0], [0.0], 1.0
    while knots[-1] < t[-1]:
        goal = side * reach * rng.uniform(0.35, 1.0)
        pace = speed * 14.0 ** rng.uniform(-1.0, 0.0) * 0.75
        knots.append(knots[-1] + max(abs(goal - places[-1]) / pace, 0.35))
        places.append(goal)
        side = -side
    return _rounded(np.interp(t, knots, places), t[1] - t[0], 0.12)


def _rounded(x: FloatArray, step: float, width: float) -> FloatArray:
    """Mean over `width` seconds, three times: corners of the third order."""
    m = max(1, round(width / step))
    kernel = np.ones(m) / m
    for _ in range(3):
        x = np.convolve(np.pad(x, (m // 2, m - 1 - m // 2), mode="edge"), kernel, "valid")
    return x


def _points(rng: np.random.Generator, t: FloatArray, reach: float, speed: float) -> FloatArray:
    """A cubic spline through random points at random times."""
    knots, places = [-1.0, 0.0], [0.0, 0.0]
    while knots[-1] < t[-1] + 1.0:
        goal = reach * rng.uniform(-1.0, 1.0)
        pause = rng.uniform(1.2, 3.4) * max(abs(goal - places[-1]), 0.15 * reach) / speed
        knots.append(knots[-1] + max(pause, 0.25))
        places.append(goal)
    x: FloatArray = CubicSpline(knots, places)(t)
    return x


MotionMaker = Callable[[np.random.Generator, FloatArray, float, float], FloatArray]
MAKERS: dict[str, MotionMaker] = {"wander": _sines, "shuttle": _shuttle, "points": _points}


def push(robot: SimulatedRobot, seed: int, step: float) -> FloatArray:
    """Force ON the tip in the base frame (n, 3) [N]: coloured by two poles, a few newtons' worth.

    Its size follows from the motors: a fifteenth of the weakest effort over the longest lever.
    """
    rng = np.random.default_rng([seed, 0x9054])
    n = round(robot.seconds / step)
    lever = 0.1 + sum(sum(x * x for x in link.along) ** 0.5 for link in robot.links)
    strong = max(link.effort if not link.slides else link.effort * lever for link in robot.links)
    knots = np.arange(-1.0, robot.seconds + 1.0, 0.22)
    x = CubicSpline(knots, rng.standard_normal((knots.size, 3)))(step * np.arange(n))
    return np.asarray(0.05 * strong / lever * x)


# The mechanism in MuJoCo with its controller, stepped from reference to recording.

#: Steps of the physics in one of the controller, where a shaft lies between motor and link.
_FINE = 2
#: Time constant of the controller's speed filter, in its periods.
_SMOOTH = 3.0
#: Relative errors of the controller's own model, and share of the friction it feeds forward.
NOMINAL, FED = 0.93, 0.85


def engine() -> Any:
    """MuJoCo, imported now."""
    try:
        import mujoco
    except ImportError as error:
        raise ConfigError(
            "the test plants need MuJoCo: pip install 'hil-teleop[mujoco]'"
        ) from error
    return mujoco


class Plant:
    """One robot with hidden effects.

    Parameters
    ----------
    robot : Robot
    hidden : list of dict
        ``effect``, ``joint``, ``amplitude``.
    seed : int
        Of what happens at random.
    """

    def __init__(self, robot: SimulatedRobot, hidden: list[dict[str, Any]], seed: int) -> None:
        self.robot, self._mj = robot, engine()
        self.places = [
            EffectPlace(
                robot, int(h["joint"]), float(h["amplitude"]), np.random.default_rng([seed, k])
            )
            for k, h in enumerate(hidden)
        ]
        self._effects = [(str(h["effect"]), p) for h, p in zip(hidden, self.places, strict=True)]
        added = Additions()
        for name, p in self._effects:
            if name in describe.SHAFTS:
                added.geared.add(p.j)
            if name in describe.STRUCTURES:
                describe.STRUCTURES[name](p, added)
        self.substeps = _FINE if added.geared else 1
        self._geared = sorted(added.geared)
        text = describe.mjcf(robot, added, robot.step / self.substeps)
        self.model = self._mj.MjModel.from_xml_string(text)
        self.data = self._mj.MjData(self.model)
        self._link = [self._dof(f"joint{k + 1}") for k in range(len(robot.links))]
        self._motor = [
            self._dof(f"{'motor' if k in added.geared else 'joint'}{k + 1}")
            for k in range(len(robot.links))
        ]
        self._laws()

    def _dof(self, name: str) -> int:
        """Index of a joint's degree of freedom; all joints have one, so of its position, too."""
        return int(self.model.joint(name).dofadr[0])

    def _laws(self) -> None:
        """Closures of the hidden effects, with a state of their own."""
        inertia = inertias(self.robot)
        self._on_motor = [(p.j, laws.MOTOR[e](p)) for e, p in self._effects if e in laws.MOTOR]
        self._on_link = [(p.j, laws.LINK[e](p)) for e, p in self._effects if e in laws.LINK]
        self._drives = [laws.DRIVES[e](p) for e, p in self._effects if e in laws.DRIVES]
        self._encoders = [
            (p.j, laws.ENCODERS[e](p)) for e, p in self._effects if e in laws.ENCODERS
        ]
        self._shafts = [
            (p.j, describe.SHAFTS[e](p, inertia[p.j]))
            for e, p in self._effects
            if e in describe.SHAFTS
        ]
        if self.robot.dry == "smooth":
            self._on_motor += [(k, self._smooth(k)) for k in range(len(self.robot.links))]

    def _smooth(self, k: int) -> laws.EffortLaw:
        """Dry friction of a robot that has not MuJoCo's own."""
        f, w2 = self.robot.links[k].friction, (0.003 * self.robot.links[k].speed) ** 2
        return lambda x: -f * x.w[k] / sqrt(x.w[k] ** 2 + w2)

    def run(
        self,
        reference: FloatArray,
        push: FloatArray | None,
        acting: FloatArray,
        dac: FloatArray,
        asked: bool,
        every: int,
        lost: float,
    ) -> dict[str, FloatArray]:
        """Follow a reference.

        Parameters
        ----------
        reference : ndarray (n, d, 3)
            Place, speed, acceleration.
        push : ndarray (n, 3) or None
            Force ON the tip, base axes [N].
        acting : ndarray (n, d)
            Effort that acts beside the motors' [N m or N].
        dac : ndarray (d,)
            Smallest steps of the efforts sent.
        asked : bool
            Whether the row holds the effort before it was rounded to those steps.
        every : int
            A row is written every so many periods of the controller.
        lost : float
            Distance from the reference [reaches] at which the run ends.

        Returns
        -------
        dict
            ``t``, ``q``, ``qd``, ``tau``, and ``force`` where there is one.
        """
        d, n, tick = len(self.robot.links), len(reference), self.robot.step
        out = np.full((n, 3 * d), np.nan)
        control = FeedforwardController(self.robot, reference, dac)
        x = self._start(reference[0, :, 0])
        reach = [lost * link.reach for link in self.robot.links]
        loads = self._load_changes()
        places, extra = reference[:, :, 0].tolist(), acting.tolist()
        for k in range(n):
            x.t = k * tick
            seen = list(x.m)
            for j, encoder in self._encoders:
                seen[j] += encoder(x)
            q, v, wish, sent = control(k, seen)
            out[k] = [*q, *v, *(wish if asked else sent)]
            if any(abs(a - b) > r for a, b, r in zip(x.q, places[k], reach, strict=True)):
                out[k:] = np.nan
                break
            for load in loads:
                load(x.t)
            if push is not None:
                self._push(push[k])
            self._advance(x, sent, extra[k], tick / self.substeps)
        rows = out[::every]
        found = {
            "t": tick * every * np.arange(len(rows)),
            "q": rows[:, :d].copy(),
            "qd": rows[:, d : 2 * d],
            "tau": rows[:, 2 * d :],
        }
        return found if push is None else found | {"force": push[::every]}

    def _start(self, home: FloatArray) -> PlantState:
        """At rest at `home`."""
        self.data.qpos[self._link] = home
        self.data.qpos[self._motor] = home
        self._mj.mj_forward(self.model, self.data)
        zero = [0.0] * len(self._link)
        return PlantState(q=home.tolist(), v=zero, m=home.tolist(), w=list(zero), u=list(zero))

    def _advance(self, x: PlantState, sent: list[float], extra: list[float], dt: float) -> None:
        """All steps of the physics in one period of the controller."""
        model, data, step = self.model, self.data, self._mj.mj_step
        x.dt = dt
        for _ in range(self.substeps):
            u = list(sent)
            for drive in self._drives:
                drive(u, x)
            x.u = u
            motor = [a + b for a, b in zip(u, extra, strict=True)]
            for j, law in self._on_motor:
                motor[j] += law(x)
            link = [0.0] * len(u)
            for j, law in self._on_link:
                link[j] += law(x)
            for j, pull in self._shafts:
                force = pull(x)
                motor[j] -= force
                link[j] += force
            data.qfrc_applied[:] = 0.0
            data.qfrc_applied[self._motor] = motor
            data.qfrc_applied[self._link] += link
            step(model, data)
            place, speed = data.qpos.tolist(), data.qvel.tolist()
            x.q, x.v = [place[i] for i in self._link], [speed[i] for i in self._link]
            x.m, x.w = [place[i] for i in self._motor], [speed[i] for i in self._motor]
            x.t += dt

    def _push(self, force: FloatArray) -> None:
        """Force at the tip as a wrench on its body."""
        body = self.model.body(f"link{len(self.robot.links)}").id
        arm = self.data.site("tip").xpos - self.data.xipos[body]
        self.data.xfrc_applied[body, :3] = force
        self.data.xfrc_applied[body, 3:] = np.cross(arm, force)

    def _load_changes(self) -> list[Callable[[float], None]]:
        """Loads that are picked up within the run."""
        return [pick_up(self.model, p) for name, p in self._effects if name == "payload-change"]


def pick_up(model: Any, p: EffectPlace) -> Callable[[float], None]:
    """The last link takes a point mass at its tip from an instant on."""
    robot, mass = p.robot, describe.load_mass(p)
    start = p.rng.uniform(0.35, 0.65) * robot.seconds
    link = robot.links[-1]
    com, about = describe.inertia(link)
    at, whole = np.array(link.along), link.mass + mass
    centre = (link.mass * com + mass * at) / whole
    moved = about + _steiner(link.mass, com - centre) + _steiner(mass, at - centre)
    values, axes = np.linalg.eigh(moved)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    body, done = model.body(f"link{len(robot.links)}").id, False

    def load(t: float) -> None:
        nonlocal done
        if t < start or done:
            return
        done = True
        model.body_mass[body], model.body_ipos[body] = whole, centre
        model.body_inertia[body] = values
        engine().mju_mat2Quat(model.body_iquat[body], np.ascontiguousarray(axes).ravel())

    return load


def _steiner(mass: float, r: FloatArray) -> FloatArray:
    return np.asarray(mass * (r @ r * np.eye(3) - np.outer(r, r)))


class FeedforwardController:
    """PD with a nominal inverse dynamics fed forward; encoder counts in, DAC steps out."""

    def __init__(self, robot: SimulatedRobot, reference: FloatArray, dac: FloatArray) -> None:
        w = 2 * pi * robot.bandwidth
        inertia = inertias(robot)
        self._stiff = [i * w * w for i in inertia]
        self._damp = [1.6 * i * w for i in inertia]
        self._fed = forward(robot, reference).tolist()
        self._goal = reference[:, :, 0].tolist()
        self._pace = reference[:, :, 1].tolist()
        self._share, self._tick = 1.0 - exp(-1.0 / _SMOOTH), robot.step
        self._most = [link.effort for link in robot.links]
        self._dac, self._counts = dac.tolist(), robot.counts
        self._q: list[float] = []
        self._v = [0.0] * len(robot.links)

    def __call__(
        self, k: int, place: list[float]
    ) -> tuple[list[float], list[float], list[float], list[float]]:
        """Measured position, filtered speed, effort asked for and sent, of all joints at tick k."""
        counts, share, tick = self._counts, self._share, self._tick
        q = [round(x * counts) / counts for x in place]
        before = self._q or q
        self._v = [
            v + share * ((a - b) / tick - v) for v, a, b in zip(self._v, q, before, strict=True)
        ]
        self._q = q
        asked, sent = [], []
        goal, pace, fed = self._goal[k], self._pace[k], self._fed[k]
        for j, step in enumerate(self._dac):
            u = fed[j] + self._stiff[j] * (goal[j] - q[j]) + self._damp[j] * (pace[j] - self._v[j])
            u = max(-self._most[j], min(self._most[j], u))
            asked.append(u)
            sent.append(step * round(u / step))
        return q, self._v, asked, sent


@lru_cache(maxsize=32)
def _bare(robot: SimulatedRobot) -> tuple[Any, Any]:
    """Model and data of the robot with nothing hidden."""
    mj = engine()
    model = mj.MjModel.from_xml_string(describe.mjcf(robot, Additions(), robot.step))
    return model, mj.MjData(model)


@lru_cache(maxsize=32)
def inertias(robot: SimulatedRobot) -> tuple[float, ...]:
    """Diagonal of the mass matrix in the middle of the motion, motors included [kg m^2 or kg]."""
    mj, (model, data) = engine(), _bare(robot)
    data.qpos[:] = [link.middle for link in robot.links]
    mj.mj_forward(model, data)
    found, d = [], len(robot.links)
    for k in range(d):
        column = np.zeros(d)
        mj.mj_mulM(model, data, column, np.eye(d)[k].copy())
        found.append(float(column[k]))
    return tuple(found)


def forward(robot: SimulatedRobot, reference: FloatArray) -> FloatArray:
    """Effort (n, d) that a nominal model needs for the reference: `NOMINAL` of the true one."""
    true = effort(robot, reference)
    speed = reference[:, :, 1]
    w = 0.02 * np.array([link.speed for link in robot.links])
    dry = FED * np.array([link.friction for link in robot.links]) * np.tanh(speed / w)
    viscous = FED * np.array([link.viscous for link in robot.links]) * speed
    return NOMINAL * true + dry + viscous


def effort(robot: SimulatedRobot, motion: FloatArray) -> FloatArray:
    """Rigid-body effort (n, d) for places, speeds and accelerations (n, d, 3), from MuJoCo.

    Motors' inertias count, friction does not.
    """
    mj, (model, data) = engine(), _bare(robot)
    out = np.zeros(motion.shape[:2])
    for k, row in enumerate(motion):
        data.qpos[:], data.qvel[:], data.qacc[:] = row.T
        mj.mj_inverse(model, data)
        # passive forces hold the damping, constraint forces the dry friction
        out[k] = data.qfrc_inverse + data.qfrc_passive + data.qfrc_constraint
    return out


__all__ = ["MOTIONS", "NOISES", "kinds", "robots", "simulate"]

MOTIONS = tuple(sorted(MAKERS))
NOISES = ("coloured", "dac", "white")
#: Largest relative error of the inertias in a URDF.
WRONG = 0.2
#: A motion further than this from its reference, in reaches, is lost.
_LOST = 1.5
#: Steps of a coarse DAC in standard deviations of the other noises.
_COARSE = 1.8


def robots() -> dict[str, dict[str, Any]]:
    """Name -> ``joints``, ``units``, and ``urdf`` (text, empty for a single axis)."""
    return {
        name: {
            "joints": r.joints,
            "units": tuple("m" if link.slides else "rad" for link in r.links),
            "urdf": urdf(name),
        }
        for name, r in ROBOTS.items()
    }


def urdf(name: str, exact: bool = False) -> str:
    """URDF of a robot, with wrong inertias unless `exact`; empty where it has none."""
    robot = _robot(name)
    if not robot.described:
        return ""
    wrong = 0.0 if exact else WRONG
    return describe.exact_urdf(name, robot, wrong, sorted(ROBOTS).index(name))


def simulate(
    robot: str,
    motion: tuple[str, int],
    hidden: list[dict[str, Any]],
    noise: str = "white",
    seed: int = 0,
    force: bool = False,
    lost: float = 0.0,
) -> dict[str, FloatArray]:
    """Record one session.

    Parameters
    ----------
    robot : str
        One of `robots`.
    motion : (str, int)
        One of `MOTIONS` and its seed.
    hidden : list of dict
        ``effect`` (of `kinds`), ``joint`` (from 0) and ``amplitude`` of every hidden effect.
    noise : str
        One of `NOISES`.
    seed : int
        Of noise and of what happens at random.
    force : bool
        Whether a force acts on the tip and is measured.
    lost : float
        Share of rows that the recording lacks.

    Returns
    -------
    dict
        ``t`` (n,) [s], ``q``, ``tau`` (n, d) [rad, N m or m, N], ``qd`` (n, d) where the robot
        records speeds, ``wrench`` (n, 6) [N, N m] in base axes where a force acts.  Rows after a
        motion that was lost are NaN.
    """
    table = _robot(robot)
    for row in hidden:
        if row["effect"] not in NAMES:
            raise ConfigError(unknown("hidden effect", row["effect"], NAMES))
    tick = table.step
    path = reference(table, *motion, tick)
    pushed = push(table, motion[1], tick) if force else None
    std = table.noise * np.array([link.effort for link in table.links])
    plant = Plant(table, hidden, seed)
    acting = laws.disturbance(noise, len(path), std, tick, seed)
    dac = _COARSE * std if noise == "dac" else 0.02 * std
    every = round(1.0 / (tick * table.rate))
    rows = plant.run(path, pushed, acting, dac, noise == "dac", every, _LOST)
    found = _recorded(table, rows, hidden, noise, std, seed, plant)
    return _lose(found, lost, seed)


def _robot(name: str) -> SimulatedRobot:
    if name not in ROBOTS:
        raise ConfigError(unknown("robot of the test plants", name, ROBOTS))
    return ROBOTS[name]


def _recorded(
    table: SimulatedRobot,
    rows: dict[str, FloatArray],
    hidden: list[dict[str, Any]],
    noise: str,
    std: FloatArray,
    seed: int,
    plant: Plant,
) -> dict[str, FloatArray]:
    """What the recorder writes of the true signals."""
    n, rate = len(rows["t"]), table.rate
    rows["tau"] = rows["tau"] + laws.recorded_noise(noise, n, std, seed)
    force = rows.get("force", np.zeros((n, 3)))
    if "force" in rows:
        rng = np.random.default_rng([seed, 0xF0C3])
        force = force + 0.01 * np.std(force) * rng.standard_normal(force.shape)
    for place, row in zip(plant.places, hidden, strict=True):
        if row["effect"] in laws.RECORDED:
            laws.RECORDED[row["effect"]](rows["q"], force, rate, place)
    if "force" in rows:
        rows["wrench"] = np.hstack([force, np.zeros((n, 3))])
        del rows["force"]
    if not table.speeds:
        del rows["qd"]
    return rows


def _lose(rows: dict[str, FloatArray], share: float, seed: int) -> dict[str, FloatArray]:
    """Rows that remain where `share` of them are lost, singly and a dozen at a time."""
    if share <= 0.0:
        return rows
    n, rng = len(rows["t"]), np.random.default_rng([seed, 0x1057])
    keep = rng.random(n) >= 0.5 * share
    for start in rng.integers(0, n - 12, max(1, round(0.5 * share * n / 12))):
        keep[start : start + 12] = False
    return {key: x[keep] for key, x in rows.items()}
