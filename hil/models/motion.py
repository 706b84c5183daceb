"""What an effect may look at: the measured motion of one run, at the evaluation rate."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from hil.models.robots import Robot

FloatArray = NDArray[np.float64]


class Response(Protocol):
    """How the present model's effort answers small errors of the measured motion."""

    @property
    def inertia(self) -> FloatArray:
        """Derivative of tau_i by qdd_j, shape (n, d, d)."""

    @property
    def gradient(self) -> FloatArray:
        """Derivative of tau_i by q_j at rest, shape (n, d, d)."""

    def weight(self, j: int) -> FloatArray:
        """Derivative of joint j's load at rest by its own position, of masses alone, shape (n,)."""

    def slope(self, j: int) -> FloatArray:
        """Derivative of tau_i by q_j along the motion, with its speeds, shape (n, d)."""

    def coriolis(self, j: int) -> FloatArray:
        """Derivative of tau_i by joint j's speed, of masses alone, shape (n, d)."""

    @property
    def damping(self) -> FloatArray:
        """Viscous coefficient of each joint, shape (d,)."""

    @property
    def rotor(self) -> FloatArray:
        """Reflected inertia of each rotor, where the links' is known apart; else 0, shape (d,)."""

    @property
    def tilt(self) -> FloatArray:
        """Derivative of tau_i by a turn of the base about its x and y axes, shape (n, d, 2)."""

    def unslipped(self, j: int) -> FloatArray:
        """Effort without the jumps of joint j's position, less that with them, shape (n, d)."""


@dataclass(frozen=True)
class Motion:
    """One run of d joints at n instants, after the position filter.

    Parameters
    ----------
    t : ndarray (n,)
        Time since the start of the run [s].
    q, qd, qdd : ndarray (n, d)
        Position, velocity, acceleration [rad, rad/s, rad/s^2 or m, m/s, m/s^2].
    tau : ndarray (n, d)
        Motor effort [N m or N].
    tau_ext : ndarray (n, d)
        External effort ON the robot [N m or N]; zeros where there is none.
    load : ndarray (n, d)
        Effort that the joint transmits (rigid body less external) under the current model;
        without the rotor's inertia, which lies before the transmission, where that is known apart.
    static : ndarray (n, d)
        What stays when the motion stops: gravity and springs, and an offset that no motion tells
        from a spring's own constant.
    v0 : ndarray (d,)
        Speed over which the sign of the velocity is resolved [rad/s or m/s].
    resolution : ndarray (d,)
        Half the speed noise: no sign of a velocity is sharper than this [rad/s or m/s].
    span : ndarray (d, 2)
        Smallest and largest position over *all* runs, so that every run shares one basis.
    contact : ndarray (d, 2)
        Surface position and side (+1: contact above it, -1: below); NaN where there is none.
    robot : Robot
        Geometry and rigid-body regressor.
    average : float
        Time over which a sign is averaged around each instant [s]; 0 = not at all.
    wrench : ndarray (n, 6), or (0, 6) where none was recorded
        Measured force and torque ON the tip, base axes [N, N m].
    grain : ndarray (d,), or (0,) where it is not known
        Resolution of the encoders: a count, or the noise [rad or m].
    temperature : ndarray (n, d), or (0, d) where none was recorded
        Motor temperatures [degC].
    response : Response or None
        Inertia and stiffness of the present model; None before a first fit.
    slips : ndarray (3, n, d), or (3, 0, 0) where there are none
        What jumps of the recorded positions (lost counts) add to q, qd and qdd.
    slipped : ndarray (d,) of bool, or (0,) where there are none
        Joints whose position jumps in any run.
    drive : ndarray (n, d), or (0, 0) where there is no model yet
        Motor effort that the present model predicts [N m or N].  A law that scales the motor's
        effort uses this one: the measured one holds what the model lacks, and would explain itself.
    friction : tuple of (ndarray (n,) or None), one a joint, or empty
        State of each joint's friction, 1 in steady sliding forwards, where it is another one than
        the sign of the speed: every law that scales friction scales this state.
    began : float
        Its first instant after the start of its run, of which it may be a later part [s].
    band : float
        Cut-off of the filter that the efforts pass [Hz]; 0 where none is known.
    run : int
        Number of its run, from 0.
    lengths : tuple of float
        Length of every run [s]; empty where it is the only one.
    """

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    tau: FloatArray
    tau_ext: FloatArray
    load: FloatArray
    static: FloatArray
    v0: FloatArray
    resolution: FloatArray
    span: FloatArray
    contact: FloatArray
    robot: Robot
    average: float = 0.0
    wrench: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))
    temperature: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    grain: FloatArray = field(default_factory=lambda: np.zeros(0))
    response: Response | None = None
    slips: FloatArray = field(default_factory=lambda: np.zeros((3, 0, 0)))
    slipped: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    drive: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    friction: tuple[FloatArray | None, ...] = ()

    began: float = 0.0
    band: float = 0.0
    run: int = 0
    lengths: tuple[float, ...] = ()

    #: Whether an effect is asked for its own joint alone: what others feel of it may be left out.
    lone: ClassVar[bool] = False

    def __post_init__(self) -> None:
        self._remember({})

    def _remember(self, signs: dict[tuple[int, float], FloatArray]) -> None:
        """Signs that were made already of these speeds."""
        object.__setattr__(self, "_signs", signs)

    @property
    def n(self) -> int:
        """Number of instants."""
        return int(self.t.size)

    @property
    def d(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def dt(self) -> float:
        """Evaluation period [s]."""
        return float(self.t[1] - self.t[0])

    @property
    def since(self) -> FloatArray:
        """Time since the start of the run [s], shape (n,)."""
        out: FloatArray = self.t - (self.t[0] - self.began)
        return out

    def after(self, instant: float) -> FloatArray:
        """What is 0 before an instant of the run and 1 after it, between two of them its part."""
        out: FloatArray = np.clip((self.since - instant) / self.dt + 0.5, 0.0, 1.0)
        return out

    def sign(self, j: int, v0: float | None = None) -> FloatArray:
        """State of joint j's friction, shape (n,): the sign of its velocity, tanh(v / v0).

        Without `v0` it is resolved to `v0[j]`; where friction builds up over a displacement, it
        is the state that the present model has for it (`friction`).
        """
        state = self.friction[j] if v0 is None and self.friction else None
        if state is not None:
            return state
        signs: dict[tuple[int, float], FloatArray] = self.__dict__["_signs"]
        key = (j, float(self.v0[j]) if v0 is None else v0)
        found = signs.get(key)
        if found is None:
            if len(signs) >= 4 * self.d:
                signs.clear()
            found = self.sign_of(self.qd[:, j], self.qdd[:, j], key[1])
            found.flags.writeable = False
            signs[key] = found
        return found

    def sign_of(self, v: FloatArray, a: FloatArray, v0: float) -> FloatArray:
        """tanh(v / v0), averaged over `average` around each instant, shape (n,).

        A reversal between two instants would otherwise be placed on one of them, an error of
        half a period that no later filter takes back.  With constant acceleration a and
        h = a average / 2 the average is

            v0 / (2 h) [ln cosh((v + h) / v0) - ln cosh((v - h) / v0)].
        """
        if not self.average:
            return np.tanh(v / v0)
        h = np.abs(a) * self.average / 2
        if not np.any(h > 0.1 * v0):
            return np.tanh(v / v0)
        h = np.maximum(h, 0.01 * v0)
        up, down = np.abs(v + h) / v0, np.abs(v - h) / v0
        rise = up - down
        # ln cosh x = |x| + ln(1 + exp(-2 |x|)) - ln 2, of which far away |x| alone is left
        near = np.flatnonzero(np.minimum(up, down) < 20.0)
        few = np.exp(-2 * up[near]), np.exp(-2 * down[near])
        rise[near] = rise[near] + np.log1p(few[0]) - np.log1p(few[1])
        return v0 / (2 * h) * rise

    def scaled(self, j: int) -> FloatArray:
        """Position of joint j mapped to [-1, 1] over the recorded span, shape (n,)."""
        low, high = self.span[j]
        out: FloatArray = (2.0 * self.q[:, j] - low - high) / max(high - low, 1e-12)
        return out

    def driven(self, j: int) -> FloatArray:
        """Effort of joint j's motor as the present model predicts it, (n,); else as measured."""
        out: FloatArray = (self.drive if self.drive.size else self.tau)[:, j]
        return out

    def at_rest(self) -> Motion:
        """The same postures without speed and acceleration."""
        return self.with_(qd=np.zeros_like(self.qd), qdd=np.zeros_like(self.qdd))

    def of_one(self) -> Motion:
        """The same run, of which an effect is asked for its own joint alone."""
        out = object.__new__(type(self))
        out.__dict__.update(self.__dict__, lone=True)
        return out

    def jumps(self, j: int) -> bool:
        """Whether the recorded position of joint j jumps in any run."""
        return bool(self.slipped.size and self.slipped[j])

    def at_states(
        self,
        q: FloatArray,
        qd: FloatArray,
        qdd: FloatArray,
        load: FloatArray,
        static: FloatArray,
        drive: FloatArray,
    ) -> Motion:
        """Unconnected states (w, d) in place of the run: no time and no averaging of signs.

        `drive` is the motors' effort that moves them.  Effects that explain the recorded effort
        (`tau`, `tau_ext`) see none.
        """
        # its fields at once: `replace`, or `copy`, would cost more than most effects
        out, none = object.__new__(type(self)), np.zeros(q.shape)
        out.__dict__.update(
            self.__dict__,
            t=np.arange(len(q), dtype=np.float64),
            q=q,
            qd=qd,
            qdd=qdd,
            load=load,
            static=static,
            tau=none,
            tau_ext=none,
            average=0.0,
            drive=drive,
            friction=(),
            _signs={},
        )
        return out

    def with_(self, **changes: FloatArray) -> Motion:
        """Copy with some arrays replaced."""
        moved = {"q", "qd"} & set(changes) and "friction" not in changes
        out: Motion = replace(self, **changes, **({"friction": ()} if moved else {}))  # type: ignore[arg-type]
        if not {"qd", "qdd", "average"} & set(changes):
            out._remember(self.__dict__["_signs"])
        return out
