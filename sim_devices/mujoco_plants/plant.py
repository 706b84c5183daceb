"""The mechanism in MuJoCo with its controller, stepped from reference to recording."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import exp, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError
from hil.sim_devices.mujoco_plants import describe, drives, laws, sensors, structure
from hil.sim_devices.mujoco_plants.describe import Additions
from hil.sim_devices.mujoco_plants.laws import Place, State
from hil.sim_devices.mujoco_plants.robots import Robot

FloatArray = NDArray[np.float64]
#: Steps of the physics in one of the controller, where a shaft lies between motor and link.
FINE = 2
#: Time constant of the controller's speed filter, in its periods.
SMOOTH = 3.0
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

    def __init__(self, robot: Robot, hidden: list[dict[str, Any]], seed: int) -> None:
        self.robot, self._mj = robot, engine()
        self.places = [
            Place(robot, int(h["joint"]), float(h["amplitude"]), np.random.default_rng([seed, k]))
            for k, h in enumerate(hidden)
        ]
        self._effects = [(str(h["effect"]), p) for h, p in zip(hidden, self.places, strict=True)]
        added = Additions()
        for name, p in self._effects:
            if name in structure.SHAFTS:
                added.geared.add(p.j)
            if name in structure.STRUCTURES:
                structure.STRUCTURES[name](p, added)
        self.substeps = FINE if added.geared else 1
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
        self._drives = [drives.DRIVES[e](p) for e, p in self._effects if e in drives.DRIVES]
        self._encoders = [
            (p.j, sensors.ENCODERS[e](p)) for e, p in self._effects if e in sensors.ENCODERS
        ]
        self._shafts = [
            (p.j, structure.SHAFTS[e](p, inertia[p.j]))
            for e, p in self._effects
            if e in structure.SHAFTS
        ]
        if self.robot.dry == "smooth":
            self._on_motor += [(k, self._smooth(k)) for k in range(len(self.robot.links))]

    def _smooth(self, k: int) -> laws.Law:
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
        control = Controller(self.robot, reference, dac)
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

    def _start(self, home: FloatArray) -> State:
        """At rest at `home`."""
        self.data.qpos[self._link] = home
        self.data.qpos[self._motor] = home
        self._mj.mj_forward(self.model, self.data)
        zero = [0.0] * len(self._link)
        return State(q=home.tolist(), v=zero, m=home.tolist(), w=list(zero), u=list(zero))

    def _advance(self, x: State, sent: list[float], extra: list[float], dt: float) -> None:
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


def pick_up(model: Any, p: Place) -> Callable[[float], None]:
    """The last link takes a point mass at its tip from an instant on."""
    robot, mass = p.robot, structure.load_mass(p)
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


class Controller:
    """PD with a nominal inverse dynamics fed forward; encoder counts in, DAC steps out."""

    def __init__(self, robot: Robot, reference: FloatArray, dac: FloatArray) -> None:
        w = 2 * pi * robot.bandwidth
        inertia = inertias(robot)
        self._stiff = [i * w * w for i in inertia]
        self._damp = [1.6 * i * w for i in inertia]
        self._fed = forward(robot, reference).tolist()
        self._goal = reference[:, :, 0].tolist()
        self._pace = reference[:, :, 1].tolist()
        self._share, self._tick = 1.0 - exp(-1.0 / SMOOTH), robot.step
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
def _bare(robot: Robot) -> tuple[Any, Any]:
    """Model and data of the robot with nothing hidden."""
    mj = engine()
    model = mj.MjModel.from_xml_string(describe.mjcf(robot, Additions(), robot.step))
    return model, mj.MjData(model)


@lru_cache(maxsize=32)
def inertias(robot: Robot) -> tuple[float, ...]:
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


def forward(robot: Robot, reference: FloatArray) -> FloatArray:
    """Effort (n, d) that a nominal model needs for the reference: `NOMINAL` of the true one."""
    true = effort(robot, reference)
    speed = reference[:, :, 1]
    w = 0.02 * np.array([link.speed for link in robot.links])
    dry = FED * np.array([link.friction for link in robot.links]) * np.tanh(speed / w)
    viscous = FED * np.array([link.viscous for link in robot.links]) * speed
    return NOMINAL * true + dry + viscous


def effort(robot: Robot, motion: FloatArray) -> FloatArray:
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
