"""Recordings that the tests make: plants whose physics is known, written for the tests alone.

No equation, filter or robot of the library takes part; arms follow Pinocchio or a Lagrangian
(`premium_terms` alone takes the model apart, to which the loop is compared).  All are seeded, so
that a test sees the same numbers every time.

The groups, in this order: one axis on a prescribed motion, several of them, axes simulated forward
under control (with friction that sticks), arms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numba
import numpy as np
import pinocchio as pin
import pytest
import scipy.signal

from hil.record.recording import COLUMNS, Recording, RobotSource

Path3 = tuple[np.ndarray, np.ndarray, np.ndarray]


def seeds(first: object, *more: object) -> list:
    """Values of a test: the first in every run of the tests, the others in the slow ones."""
    return [first, *map(further, more)]


def further(*values, **named):
    """Parameters that only the slow tests take: the quick ones show the same with others."""
    return pytest.param(*values, marks=pytest.mark.slow, **named)


SINGLE = RobotSource("single-axis")


def sines(t: np.ndarray, w: np.ndarray, size: np.ndarray, phase: np.ndarray) -> Path3:
    """Position, speed and acceleration (n, ...) of sums of sines; tones on the last axis."""
    angle = t.reshape(-1, *[1] * np.ndim(w)) * w + phase
    parts = size * np.sin(angle), size * w * np.cos(angle), -size * w**2 * np.sin(angle)
    q, v, a = (x.sum(axis=-1) for x in parts)
    return q, v, a


def single(
    name: str, t: np.ndarray, q: np.ndarray, tau: np.ndarray, joint: str = "joint1", **more: object
) -> Recording:
    """Recording of one joint from (n,) columns."""
    return Recording(name, "arm", (joint,), t, q[:, None], tau[:, None], **more)  # type: ignore[arg-type]


# --- one axis on a prescribed motion ---------------------------------------------------------


def smooth_axis(seed=0, seconds=30.0, rate=500.0, extra=None, push=None, noise=0.01):
    """One axis: inertia 0.1, Coulomb 0.3, viscous 0.1, offset 0.05; eight sines up to 2 Hz.

    `extra(t, q, v, a)` is an effort more that the motor supplies; `push(t, q, v)` an external one.
    """
    t = np.arange(int(seconds * rate)) / rate
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * rng.uniform(0.1, 2.0, 8)
    q, v, a = sines(t, w, rng.normal(0.0, 0.5, 8) / np.sqrt(w), rng.uniform(0.0, 2 * np.pi, 8))
    tau = 0.1 * a + 0.3 * np.tanh(v / 0.02) + 0.1 * v + 0.05
    outside = None
    if push is not None:
        outside = push(t, q, v)
        tau = tau - outside
    if extra is not None:
        tau = tau + extra(t, q, v, a)
    tau = tau + noise * np.random.default_rng(seed + 100).normal(size=t.size)
    ext = None if outside is None else outside[:, None]
    return single(f"axis{seed}", t, q, tau, tau_ext=ext, robot=SINGLE)


def moved_axis(seed, rate=200.0, seconds=30.0, took=(0.3, 0.9), rest=(0.1, 0.5), extra=None):
    """One axis of inertia 0.1, Coulomb 0.05, viscous 0.02, moved from point to point with rests.

    `took` and `rest` are the shortest and the longest of each [s]; the run begins at rest.
    """
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * rate)) / rate
    q, v, a = np.zeros((3, t.size))
    start, at = 0.5, 0.0
    while start < seconds - took[1] - 0.5:
        time, size = rng.uniform(*took), rng.uniform(-1.0, 1.0) - at
        s = np.clip((t - start) / time, 0.0, 1.0)
        q += size * s**3 * (10 - 15 * s + 6 * s**2)
        v += size * 30 * s**2 * (1 - s) ** 2 / time
        a += size * 60 * s * (1 - s) * (1 - 2 * s) / time**2
        at, start = at + size, start + time + rng.uniform(*rest)
    tau = 0.1 * a + 0.05 * np.tanh(v / 0.01) + 0.02 * v + 0.004 * rng.normal(size=t.size)
    if extra is not None:
        tau = tau + extra(t, q, v, a)
    return single(f"moves{seed}", t, q, tau, robot=SINGLE)


def warming_axis(seed: int, seconds: float = 60.0) -> Recording:
    """One axis whose friction falls as its own losses warm it, now busy and now hardly moving."""
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * 200)) / 200.0
    w, slow = 2 * np.pi * rng.uniform(0.2, 1.2, 5), 2 * np.pi / rng.uniform(30.0, 40.0)
    size, phase = 0.8 / np.sqrt(w), rng.uniform(0, 2 * np.pi, 5)
    # a wave that swells is three waves
    tones, heights = np.concatenate([w, w - slow, w + slow]), np.repeat([0.55, 0.22, 0.22], 5)
    q, v, a = sines(t, tones, heights * np.tile(size, 3), np.tile(phase, 3))
    warmth, friction = 0.0, np.empty(t.size)
    for k in range(t.size):
        cold = 0.6 * np.tanh(v[k] / 0.01) + 0.4 * v[k]
        friction[k] = cold * np.exp(-warmth)
        warmth += (0.4 * friction[k] * v[k] - warmth) / 15.0 / 200.0
    tau = 0.1 * a + friction + 0.005 * rng.standard_normal(t.size)
    return single(f"run{seed}", t, q, tau, robot=SINGLE)


def heated_axis(time: float, by_motion: bool, seconds: float = 60.0) -> Recording:
    """A slide to and fro; its friction grows by the clock, or as its own motion heats it."""
    t = np.arange(int(seconds * 200)) / 200.0
    q, v, a = sines(t, 2 * np.pi * np.array([0.31, 0.93]), np.array([0.2, 0.03]), np.zeros(2))
    heat, now = np.empty(t.size), 0.0
    for k in range(t.size):
        heat[k] = now
        now += (abs(v[k]) - now) / time / 200.0
    warm = heat if by_motion else np.mean(np.abs(v)) * (1 - np.exp(-t / time))
    tau = 6.0 * a + (4.0 + 15.0 * warm) * np.tanh(v / 1e-3) + 20.0 * v
    tau += 0.01 * np.random.default_rng(0).standard_normal(t.size)
    return single("heated", t, q, tau, robot=SINGLE)


def ringing_axis(seed: int, seconds: float = 120.0) -> Recording:
    """A clean axis: strokes to random places, whose servo rings, 20 000 counts a turn, 100 Hz."""
    rng, fine = np.random.default_rng(seed), 1000
    t = np.arange(int(seconds * fine)) / fine
    speed, at, place = np.zeros(t.size), 0.5, 0.0
    while at < seconds - 3.0:
        way = rng.uniform(-2.0, 2.0) - place
        top = 3.0 * rng.uniform(0.35, 1.0)
        ramp = min(top / 12.0, np.sqrt(abs(way) / 12.0))
        top = min(top, 12.0 * ramp)
        last, u = abs(way) / top + ramp, t - at
        speed += np.sign(way) * top * np.clip(np.minimum(u, last - u) / ramp, 0.0, 1.0)
        at, place = at + last + rng.uniform(0.3, 1.0), place + way
    servo = scipy.signal.butter(2, 14.0, fs=fine, output="sos")
    q = scipy.signal.sosfilt(servo, np.cumsum(speed) / fine)
    v = np.gradient(q, t)
    tau = 0.08 * np.gradient(v, t) + 0.5 * np.tanh(v / 0.01) + 0.12 * v + 0.02
    tau += 0.01 * rng.standard_normal(t.size)
    count, pick = 2 * np.pi / 20000, slice(None, None, 10)
    return single("rings", t[pick], np.round(q[pick] / count) * count, tau[pick], robot=SINGLE)


def bench_axis(name: str, seed: int, drag: float = 0.0, seconds: float = 20.0) -> Recording:
    """A light axis with friction and, if asked, drag; the motion repeats every 5 s."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * 500)) / 500
    w = 2 * np.pi * np.arange(1, 9) * 0.2
    q, v, a = sines(t, w, rng.uniform(0.1, 0.3, 8), rng.uniform(0, 6.3, 8))
    tau = 0.01 * a + 0.03 * np.tanh(v / 0.002) + 0.01 * v + drag * v * np.abs(v)
    tau = tau + 0.004 * rng.standard_normal(t.size)
    return single(name, t, q, tau, robot=RobotSource())


def axis_on_tones(tones, sizes, seconds=20.0, ext=False, low=0.0, noise=0.005):
    """One axis with Coulomb friction on tones [Hz]; `low` is a Stribeck peak below 0.03 rad/s."""
    rng, rate = np.random.default_rng(0), 500.0
    t = np.arange(int(seconds * rate)) / rate
    w = 2 * np.pi * np.array(tones)
    q = (np.array(sizes) * np.sin(np.outer(t, w) + np.arange(len(tones)))).sum(axis=1)
    v = np.gradient(q, t)
    tau = 0.05 * np.gradient(v, t) + 0.2 * np.tanh(v / 1e-3) + 0.1 * v
    tau += low * np.exp(-((v / 0.03) ** 2)) * np.tanh(v / 1e-3)
    tau += noise * rng.standard_normal(t.size)
    more = {"tau_ext": 0.5 * np.sin(0.7 * t)[:, None]} if ext else {}
    if ext:
        tau -= more["tau_ext"][:, 0]
    q += 2e-6 * rng.standard_normal(t.size)
    return single("run", t, q, tau, **more)


#: Tones [Hz] and sizes [rad] of the belt and of the axis with a rough encoder.
_SIX = 1.125 * np.array([0.07, 0.13, 0.31, 0.53, 0.97, 1.7])
_SIZES = np.array([1.0, 0.7, 0.35, 0.2, 0.1, 0.05])


def belt(change, hum=0.0, seed=1, mass=8.0, name="monday", phase=0.4):
    """A belt on six tones; `change` is added to mass, friction and stiffness at half time."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 25.0, 0.001)
    q, v, a = sines(t, 2 * np.pi * _SIX, 0.17 * _SIZES, rng.uniform(0, 6.28, 6))
    later = t > 12.5
    more, friction, stiffness = (x * later for x in change)
    tau = (mass + more) * a + (12.0 + friction) * np.tanh(v / 0.004) + 30.0 * v + stiffness * q
    tau += hum * np.sin(2 * np.pi * 1.6 * t + phase) + 0.5 * rng.standard_normal(t.size)
    return single(name, t, q + 1e-6 * rng.standard_normal(t.size), tau)


def rough_encoder_axis(noise: float, seed: int = 1, law=None, seconds: float = 25.0) -> Recording:
    """An axis on six tones; what its encoder says is off by white noise."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.001)
    q, v, a = sines(t, 2 * np.pi * _SIX, 0.17 * _SIZES, rng.uniform(0, 6.28, 6))
    tau = 8.0 * a + 2.0 * np.tanh(v / 0.004) + 5.0 * v + 0.1 * rng.standard_normal(t.size)
    if law is not None:
        tau += law(q, v)
    return single("axis", t, q + noise * rng.standard_normal(t.size), tau)


#: Instants of `dry_axis` [s].
DRY_T = np.arange(0.0, 25.0, 0.001)


def dry_axis(extra, seed=1, colour=0.0):
    """An axis on six tones with dry friction, on which `extra` (n,) at DRY_T acts, too."""
    rng, t = np.random.default_rng(seed), DRY_T
    tones = np.array([0.08, 0.19, 0.31, 0.53, 1.1, 1.9])
    q, v, a = sines(t, 2 * np.pi * tones, 0.2 * _SIZES, rng.uniform(0, 6.28, 6))
    noise = scipy.signal.lfilter([1 - colour], [1, -colour], rng.standard_normal(t.size))
    tau = 8.0 * a + 6.0 * np.sign(v) + 20.0 * v + extra + noise
    return single("monday", t, q + 1e-6 * rng.standard_normal(t.size), tau)


#: Coulomb friction [N m] of `screw`, its Stribeck rise, and the speed of that [rad/s].
SCREW_FC, _RISE, _SPEED = 0.05, 0.04, 0.12


def _stribeck(v: np.ndarray) -> np.ndarray:
    return _RISE * np.exp(-((v / _SPEED) ** 2))


@numba.njit(cache=True)
def _bristle(v: np.ndarray, level: np.ndarray, dt: float) -> np.ndarray:
    """LuGre: sigma_0 z + sigma_1 z', z' = v - sigma_0 |v| z / level; Euler's method."""
    stiffness, damping, z, out = 8.0, 0.05, 0.0, np.zeros(v.size)
    for k in range(v.size):
        rate = v[k] - stiffness * abs(v[k]) * z / level[k]
        z += rate * dt
        out[k] = stiffness * z + damping * rate
    return out


@numba.njit(cache=True)
def stuck(q: np.ndarray, width: float) -> np.ndarray:
    """Deflection of an element that sticks within +-width."""
    z, out = 0.0, np.zeros(q.size)
    for k in range(1, q.size):
        z = min(max(z + q[k] - q[k - 1], -width), width)
        out[k] = z
    return out


def lugre(q, v, dt):
    """LuGre friction with a Stribeck curve."""
    return _bristle(v, SCREW_FC + _stribeck(v), dt)


def loops(q, v, dt):
    """Coulomb and Stribeck friction, and five elements that stick and slip."""
    out = (0.2 * SCREW_FC + _stribeck(v)) * np.tanh(v / 2e-3)
    for width in np.array([1.5, 3.0, 5.0, 8.0, 15.0]) * 1e-3:
        out += 0.16 * SCREW_FC * stuck(q, width) / width
    return out


def curve(q, v, dt):
    """Coulomb and Stribeck friction alone."""
    return (SCREW_FC + _stribeck(v)) * np.tanh(v / 2e-3)


def screw(law, seed: int) -> Recording:
    """An axis with reversals of all sizes and a law of friction, evaluated at 10 kHz."""
    rate, fine = 500, 20
    t = np.arange(20 * rate * fine) / (rate * fine)
    w = 2 * np.pi * np.array([0.13, 0.31, 0.83, 1.9, 3.1])
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, 5)
    q, v, a = sines(t, w, np.array([0.3, 0.15, 0.06, 0.03, 0.012]), phase)
    tau = (0.01 * a + 0.02 * v + law(q, v, 1 / (rate * fine)))[::fine]
    noise = np.random.default_rng([seed, 1]).normal(size=(2, tau.size))
    return single("axis", t[::fine], q[::fine] + 2e-6 * noise[0], tau + 1e-3 * noise[1], "a")


#: Waves per radian of the cogging of `cogging_axis`.
COGGING_ORDER = 1.7


def cogging_axis(
    seed: int, third: float, other: float = 3 * COGGING_ORDER, first: float = 0.03, tight=0.0
) -> Recording:
    """A joint with cogging of one order, its third harmonic or another wave, and noise.

    `tight`: how much larger its dry friction is on one side of a place.
    """
    rng, t = np.random.default_rng(seed), np.arange(10000) / 500.0
    w = 2 * np.pi * np.array([0.11, 0.37, 0.9]) * (1 + 0.07 * seed)
    q, v, a = sines(t, w, np.array([0.9, 0.5, 0.15]), np.array([0.0, 1.0, 2.0]))
    dry = 0.15 * (1 + tight * (0.5 + 0.5 * np.tanh((q - 0.4) / 0.1)))
    tau = 0.02 * a + dry * np.tanh(v / 0.01) + 0.05 * v
    tau += first * np.sin(2 * np.pi * COGGING_ORDER * q)
    tau += third * np.sin(2 * np.pi * other * q + 1.0) + 0.004 * rng.standard_normal(t.size)
    return single(f"run{seed}", t, q, tau)


def axis_with_stop(swing: float, seed: int) -> Recording:
    """One axis that swings up to 0.65 rad times `swing`, with a stop at 0.5 rad."""
    rng, t = np.random.default_rng(seed), np.arange(20000) / 1000.0
    w, phase = 2 * np.pi * np.array([0.11, 0.53, 1.3]), np.array([0.0, 1.0, 2.0]) * seed
    q, v, a = sines(t, w, swing * np.array([0.35, 0.2, 0.1]), phase)
    tau = 0.02 * a + 0.15 * np.tanh(v / 0.01) + 0.05 * v + 8.0 * np.maximum(q - 0.5, 0.0)
    return single(f"stop{seed}", t, q, tau + 0.004 * rng.standard_normal(t.size))


def stribeck_axis(
    seed: int, noise: float = 0.05, rho: float = 0.0, vs: float = 0.15, n: float = 2.0
) -> Recording:
    """One motion with Stribeck friction of exponent n; white or coloured noise."""
    t, w = np.arange(10000) / 250.0, 2 * np.pi * np.array([0.11, 0.3, 0.7])
    q, v, a = sines(t, w, np.full(3, 0.15), np.array([1.0, 3.0, 5.0]))
    white = np.random.default_rng(seed).normal(size=t.size)
    e = scipy.signal.lfilter([np.sqrt(1 - rho**2)], [1, -rho], white)
    tau = 2.0 * a + 0.3 * v + (0.5 + 0.4 * np.exp(-(np.abs(v / vs) ** n))) * np.sign(v) + noise * e
    return single("axis", t, q, tau)


def sprung_axis(seed: int, spring: float = 3.0, seconds: float = 8.0) -> Recording:
    """One axis with viscous friction and a spring of the third power, 500 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(500 * seconds)) / 500
    f, size = rng.uniform(0.3, 1.0, 3), rng.uniform(0.5, 1.0, 3)
    q, v, a = sines(t, 2 * np.pi * f, size, rng.uniform(0, 6, 3))
    tau = 0.1 * a + 0.3 * v + spring * q**3 + 0.2 + 0.02 * rng.normal(size=t.size)
    return single(f"run{seed}", t, q, tau, "j1", robot=SINGLE)


def delayed_axis(seconds: float = 8.0, late: int = 0) -> Recording:
    """A single axis on a sum of sines; its effort `late` samples late."""
    t = np.arange(int(500 * seconds)) / 500
    w = 2 * np.pi * np.array([0.31, 0.73, 1.9])
    q, v, a = sines(t, w, np.full(3, 0.3), np.arange(3))
    tau = 0.1 * a + 0.3 * np.tanh(v / 0.01) + 0.1 * v
    tau += 0.005 * np.random.default_rng(0).normal(size=t.size)
    return single("run", t, q, np.roll(tau, -late), "x")


def two_tone_axis(
    seconds: float = 10.0, sizes=(0.5, 0.1), speeds=(1.3, 7.1), phase: float = 0.0, dry: float = 0.2
) -> Recording:
    """An axis on two tones [rad, rad/s], with friction and noise."""
    t = np.arange(int(500 * seconds)) / 500.0
    q = sizes[0] * np.sin(speeds[0] * t) + sizes[1] * np.sin(speeds[1] * t + phase)
    v = np.gradient(q, t)
    noise = 0.01 * np.random.default_rng(0).standard_normal(t.size)
    tau = 0.05 * np.gradient(v, t) + dry * np.tanh(v / 0.01) + 0.1 * v + noise
    return single("run", t, q, tau)


def tight_axis() -> Recording:
    """An axis whose dry friction is larger at the middle of its range."""
    rng, t = np.random.default_rng(0), np.arange(12000) / 500.0
    w = 2 * np.pi * np.array([0.31, 0.73, 1.13])
    q, v, a = sines(t, w, np.full(3, 0.3), rng.uniform(0, 6, 3))
    middle = (q.min() + q.max()) / 2
    tight = 0.4 * np.exp(-(((q - middle) / 0.15) ** 2)) * np.sign(v)
    tau = 0.1 * a + 0.3 * np.sign(v) + 0.1 * v + tight + 0.05 * rng.normal(size=t.size)
    return single("run", t, q, tau, "x")


def wave_over_position(order: float, friction: bool) -> Recording:
    """A wave over the position alone, or one that turns round with the motion."""
    t = np.arange(0, 20, 2e-3)
    q = 0.7 * np.sin(0.9 * t) + 0.2 * np.sin(4.1 * t + 1)
    side = np.sign(np.gradient(q, t)) if friction else 1.0
    noise = 0.02 * np.random.default_rng(3).normal(size=t.size)
    return single("wave", t, q, 0.1 * np.sin(2 * np.pi * order * q + 0.4) * side + noise)


def counted_axis(
    seconds: float = 30.0, fs: float = 1000.0, seed: int = 0, noise: float = 0.02
) -> Recording:
    """An axis with inertia, and friction; counts of 2e-5 rad, white effort noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * fs)) / fs
    return counted_at(t, t, rng, noise)


def counted_motion(t: np.ndarray) -> np.ndarray:
    """Position of `counted_axis`."""
    return 0.6 * np.sin(2 * np.pi * 0.37 * t) + 0.2 * np.sin(2 * np.pi * 1.13 * t + 1.0)


def counted_at(
    stamps: np.ndarray, t: np.ndarray, rng: np.random.Generator, noise: float
) -> Recording:
    """What `counted_axis` measures at instants t and logs with other stamps."""
    h, q = 1e-4, counted_motion
    v = (q(t + h) - q(t - h)) / (2 * h)
    a = (q(t + h) - 2 * q(t) + q(t - h)) / h**2
    tau = 0.02 * a + 0.05 * v + 0.3 * np.tanh(v / 0.003) + noise * rng.normal(size=t.size)
    return single("run", stamps, np.round(q(t) / 2e-5) * 2e-5, tau)


# --- several axes on prescribed motions ------------------------------------------------------

#: Laws that act on the second of `two_axes`.
LAWS = {
    "": lambda x, v, a: 0.0 * v,
    "offset": lambda x, v, a: 0.3 + 0.0 * v,
    "cogging": lambda x, v, a: 0.4 * np.sin(6 * np.pi * x),
    "stribeck": lambda x, v, a: 0.4 * np.exp(-((v / 0.1) ** 2)) * np.tanh(v / 0.01),
    "coulomb": lambda x, v, a: 0.25 * np.tanh(v / 0.01),
    "gain": lambda x, v, a: 0.15 * (0.3 * a + 0.8 * np.tanh(v / 0.01) + 0.5 * v),
}
_FOUR = np.array([0.23, 0.41, 0.77, 1.1])


def _apart(rng: np.random.Generator, t: np.ndarray, d: int, slow: float = 1.0) -> Path3:
    """Motions (n, d) on four tones, each joint a little faster than the one before."""
    paths = []
    for j in range(d):
        w, phase = 2 * np.pi * _FOUR * slow * (1 + 0.07 * j), rng.uniform(0, 2 * np.pi, 4)
        paths.append(sines(t, w, 0.25 / _FOUR**0.7, phase))
    q, v, a = (np.stack(x, axis=1) for x in zip(*paths, strict=True))
    return q, v, a


def two_axes(law: str, seed: int, name: str, slow: float = 1.0) -> Recording:
    """Two axes with Coulomb and viscous friction; a law of LAWS acts on the second."""
    rng, t = np.random.default_rng(seed), np.arange(8000) / 500.0
    q, v, a = _apart(rng, t, 2, slow)
    tau = 0.3 * a + 0.8 * np.tanh(v / 0.01) + 0.5 * v + 0.02 * rng.standard_normal(q.shape)
    tau[:, 1] += LAWS[law](q[:, 1], v[:, 1], a[:, 1])
    q += 1e-6 * rng.standard_normal(q.shape)
    return Recording(name, "arm", ("joint1", "joint2"), t, q, tau)


def coupled_axes(v0: float, seed: int = 1) -> Recording:
    """Two axes, the first without friction of its own; its motor turns with half the second."""
    rng, t = np.random.default_rng(seed), np.arange(8000) / 500.0
    q, v, a = _apart(rng, t, 2)
    w = v[:, 0] + 0.5 * v[:, 1]
    motor = 0.2 * (a[:, 0] + 0.5 * a[:, 1]) + np.tanh(w / v0) + 0.3 * w
    tau = 0.3 * a + np.outer(motor, [1.0, 0.5]) + 0.01 * rng.standard_normal(q.shape)
    tau[:, 1] += 0.4 * np.tanh(v[:, 1] / 0.004) + 0.5 * v[:, 1]
    return Recording("couple", "arm", ("joint1", "joint2"), t, q, tau)


def late_axes(samples: tuple[int, int], seed: int = 1) -> Recording:
    """Efforts of `two_axes` that act some samples of 2 ms after they were recorded, by joint."""
    run, n = two_axes("", seed, "late"), max(samples)
    tau = np.stack([run.tau[k : run.n - n + k, j] for j, k in enumerate(samples)], axis=1)
    return replace(run, t=run.t[:-n], q=run.q[:-n], tau=tau)


def tanh_axes(
    effect: str = "", d: int = 1, joints: tuple[str, ...] = (), noise: float = 0.02
) -> Recording:
    """Independent axes with inertia, Coulomb and viscous friction, and one effect on the last."""
    rng, t = np.random.default_rng(3), np.arange(3000) / 200.0
    q, v, a = _apart(rng, t, d)
    tau = 0.3 * a + 0.8 * np.tanh(v / 0.02) + 0.5 * v
    x, s = q[:, -1], v[:, -1]
    tau[:, -1] += {
        "": 0.0 * s,
        "quadratic-drag": 0.9 * s * np.abs(s),
        "cogging": 0.8 * np.sin(2 * np.pi * 3.0 * x),
        "unknown": 1.5 * np.sin(2 * np.pi * 0.9 * t),
    }[effect]
    tau += 0.02 * rng.standard_normal(q.shape)
    names = joints or tuple(f"joint{k + 1}" for k in range(d))
    return Recording("run", "arm", names, t, q + 1e-6 * rng.standard_normal(q.shape), tau)


def coulomb_axes(
    seed: int = 0,
    n: int = 6000,
    fv: float = 0.3,
    d: int = 1,
    fs: float = 500.0,
    drag: float = 0.0,
) -> Recording:
    """Axes of 2 kg m^2 with Coulomb 0.5, viscous fv and quadratic friction, white noise."""
    rng, t = np.random.default_rng(seed), np.arange(n) / fs
    w = 2 * np.pi * np.array([0.3, 0.7, 1.1])
    q, v, a = sines(t, np.tile(w, (d, 1)), np.full((d, 3), 0.2), rng.uniform(0, 6, (d, 3)))
    tau = 2 * a + 0.5 * np.sign(v) + fv * v + drag * v * np.abs(v)
    tau = tau + 0.05 * rng.normal(size=q.shape)
    return Recording(f"axis{seed}", "arm", tuple(f"joint{k + 1}" for k in range(d)), t, q, tau)


def leaking_axis(seed: int, stiffness: float, seconds: float = 50.0) -> Recording:
    """An axis on a spring with dry friction, and beside it a spring that yields within 0.6 s."""
    dt, rng = 1e-3, np.random.default_rng(seed)
    t = np.arange(0, seconds, dt)
    w = 2 * np.pi * np.geomspace(0.06, 2.0, 8)
    q, v, a = sines(t, w, 0.05 / np.sqrt(np.arange(1, 9)) / 2, rng.uniform(0, 6.3, 8))
    slow = scipy.signal.lfilter([dt / 0.6], [1.0, dt / 0.6 - 1.0], q - q[0]) + q[0]
    tau = 6.5 * a + 15 * np.tanh(v / 0.002) + 45 * v + 300 * q + stiffness * (q - slow)
    pick = slice(None, None, 5)
    tau = tau[pick] + 0.5 * rng.normal(size=t[pick].size)
    return single("leaks", t[pick], np.round(q[pick], 5), tau, robot=SINGLE)


def touching_axis(seed: int = 0, hysteresis: float = 0.0) -> Recording:
    """A lever that presses a damped spring of 200 N m/rad from 0.05 rad on."""
    run = coulomb_axes(seed)
    q, v = run.q, np.gradient(run.q, 1 / 500.0, axis=0)
    ext = np.where(q > 0.05, -200 * (q - 0.05) - 3 * v, 0.0)
    return replace(run, tau_ext=ext + 0.1 * np.random.default_rng(9).normal(size=q.shape))


#: Speed [rad/s] over which the friction of `smooth_friction_axes` changes its sign.
SIGN = 0.01


def smooth_friction_axes(
    d: int,
    seed: int = 1,
    lingering: bool = False,
    noise: float = 0.02,
    speed: float = 0.15,
) -> Recording:
    """Axes with inertia, smooth dry friction and viscous friction; the first is always the same.

    lingering: the first nearly comes to a halt now and then, at speeds well below SIGN.
    """
    fs = 500.0
    t = np.arange(0, 20.0, 1 / fs)
    q, v, tau = [], [], []
    for j in range(d):
        rng = np.random.default_rng((seed, j))
        w = 2 * np.pi * rng.uniform(0.1, 0.9, 5)
        angle = t[:, None] * w + rng.uniform(0, 6, 5)
        pace = np.ones(t.size)
        if lingering and j == 0:
            pace = np.clip(1.2 + 1.5 * np.sin(2 * np.pi * 0.15 * t), 3e-3, 1.0)
            angle = np.cumsum(pace)[:, None] / fs * w + rng.uniform(0, 6, 5)
        size = speed / w
        q.append((size * np.sin(angle)).sum(axis=1))
        v.append(pace * (size * w * np.cos(angle)).sum(axis=1))
        a = np.gradient(v[-1], 1 / fs)
        noise = noise * rng.normal(size=t.size)
        tau.append(0.2 * a + 0.9 * np.tanh(v[-1] / SIGN) + 0.3 * v[-1] + noise)
    names = tuple(f"a{j + 1}" for j in range(d))
    return Recording("axes", "arm", names, t, np.stack(q, axis=1), np.stack(tau, axis=1))


def grasping_axis(seed: int = 3, spring: float = 0.0) -> Recording:
    """A cable tool against a measured load: Dahl's hysteresis with the load, and a weak spring."""
    t = np.arange(6000) / 200.0
    w = 2 * np.pi * np.array([0.13, 0.31, 0.7]) * (1 + 0.07 * (seed - 3))
    q, v, a = sines(t, w, np.array([0.3, 0.2, 0.05]), np.array([0.0, 1.0, 2.0]))
    state = np.zeros(t.size)
    for k in range(1, t.size):  # dz/dq = (1 - z sgn v) / s
        side = np.sign(q[k] - q[k - 1])
        state[k] = side + (state[k - 1] - side) * np.exp(-abs(q[k] - q[k - 1]) / 0.05)
    load = 0.12 * (1 + np.sin(2 * np.pi * 0.17 * t)) + 0.3 * np.maximum(q, 0)
    tau = 1e-4 * a + 0.002 * v + (0.012 + 0.16 * load) * state + load + spring * q
    noise = 5e-4 * np.random.default_rng(seed).standard_normal(t.size)
    return replace(single(f"grasp{seed}", t, q, tau + noise), tau_ext=-load[:, None])


def slow_axes(seed: int, vs: float = 0.0, d: int = 3) -> Recording:
    """Axes without inertia: smooth friction and, if asked, a Stribeck curve of speed vs."""
    rng, t = np.random.default_rng(seed), np.arange(5000) / 250.0
    w, phase = 2 * np.pi * rng.uniform(0.1, 1.5, (d, 5)), rng.uniform(0, 6, (d, 5))
    q, v, _ = sines(t, w, 0.4 / w, phase)
    tau = 0.2 * np.tanh(v / 0.02) + 0.1 * v + 0.01 * rng.normal(size=q.shape)
    if vs:
        tau += 0.15 * np.exp(-((v / vs) ** 2)) * np.sign(v)
    return Recording("run", "arm", tuple(f"joint{k + 1}" for k in range(d)), t, q, tau)


def joints(
    d: int = 2, seconds: float = 6.0, rate: float = 500.0, seed: int = 0, unit: str = "rad"
) -> Recording:
    """Clean motion of d joints with inertia, friction and a little noise; speeds are recorded."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    f = rng.uniform(0.3, 1.2, (2, d))
    q = sum(0.2 * np.sin(2 * np.pi * f[k] * t[:, None] + rng.uniform(0, 6, d)) for k in (0, 1))
    qd = np.gradient(q, t, axis=0)
    qdd = np.gradient(qd, t, axis=0)
    tau = 0.05 * qdd + 0.1 * qd + 0.3 * np.tanh(qd / 0.02) + 0.002 * rng.normal(size=q.shape)
    names = tuple(f"joint{k + 1}" for k in range(d))
    return Recording("run", "arm", names, t, q, tau, qd, metadata={"unit": unit})


def without(r: Recording, *rows: np.ndarray | tuple[int, int]) -> Recording:
    """A recording that lacks some rows: an array of them, or pairs (first, end)."""
    keep = np.ones(r.n, dtype=bool)
    for some in rows:
        keep[slice(*some) if isinstance(some, tuple) else some] = False
    arrays = {k: v[keep] for k in ("t", *COLUMNS) if (v := getattr(r, k)) is not None}
    return replace(r, **arrays)


def queued(r: Recording, sizes: tuple[int, int], seed: int = 0) -> Recording:
    """The same with stamps of arrival: sizes[0] to sizes[1] - 1 rows come within 0.1 ms."""
    rng, t, k = np.random.default_rng(seed), r.t.copy(), 0
    while k < r.n:
        end = min(k + int(rng.integers(*sizes)), r.n)
        t[k:end] = r.t[end - 1] + 1e-4 * np.arange(end - k) / (end - k) * rng.uniform(0.1, 1)
        k = end
    return replace(r, t=t)


def three_joints(robot: RobotSource, seconds: float = 8.0) -> Recording:
    """Three joints a, b, c that gravity alone loads, of a robot that says what it likes."""
    t = np.arange(int(500 * seconds)) / 500.0
    angle = t[:, None] * np.array([1.0, 1.7, 2.3]) + np.arange(3)
    tau = -0.02 * np.sin(angle) + 1e-3 * np.random.default_rng(1).normal(size=angle.shape)
    return Recording("run", "arm", ("a", "b", "c"), t, 0.3 * np.sin(angle), tau, robot=robot)


# --- axes simulated forward, under control ---------------------------------------------------

RATE, J, FV, FC = 500.0, 0.05, 0.3, 0.6
ZERO: Callable[..., float] = lambda *state: 0.0  # noqa: E731


def reference(seed: int, period: float = 0.0) -> Path3:
    """Frequencies [Hz], amplitudes and phases of four sines; multiples of 1 / period if given."""
    rng = np.random.default_rng(seed)
    f = np.array([0.11, 0.27, 0.6, 1.3]) * rng.uniform(0.9, 1.1, 4)
    if period:
        f = np.array([1, 2, 5, 9]) / period
    return f, np.array([0.8, 0.3, 0.1, 0.04]), rng.uniform(0, 6.28, 4)


def axis(
    seed: int = 0,
    seconds: float = 20.0,
    noise: float = 0.02,
    period: float = 0.0,
    extra: Callable[[float, float, float], float] = ZERO,
    warm: Callable[[float], float] = lambda t: 1.0,
    push: Callable[[float], float] = ZERO,
    seen: Callable[[float, float], float] = lambda t, q: q,
    sensor: Callable[[float, float], float] = lambda t, w: w,
    gives: Callable[[float], float] = lambda u: u,
) -> Recording:
    """One axis under PD control with exact dry friction, simulated forward.

    J q'' = gives(tau) + push(t) - extra(t, q, q') - warm(t) (Fv q' + Fc sgn q');
    measured: seen(t, q), sensor(t, push).
    """
    rng = np.random.default_rng(100 + seed)
    f, a, ph = reference(seed, period)
    n, steps = int(seconds * RATE), 4
    h, w = 1 / RATE / steps, 2 * np.pi * f
    q, qd = float(a @ np.sin(ph)), float(a * w @ np.cos(ph))
    rows = np.empty((n, 4))
    t = np.arange(n) / RATE
    goal = np.sin(w * t[:, None] + ph) @ a
    rate = np.cos(w * t[:, None] + ph) @ (a * w)
    for k in range(n):
        tau = 80.0 * (goal[k] - q) + 4.0 * (rate[k] - qd)
        rows[k] = t[k], seen(t[k], q), tau, sensor(t[k], push(t[k]))
        for s in range(steps):
            now = t[k] + s * h
            force = gives(tau) + push(now) - extra(now, q, qd)
            free = (qd + h * force / J) / (1 + h * FV * warm(now) / J)
            drop = h * FC * warm(now) / J
            qd = np.sign(free) * max(abs(free) - drop, 0.0)
            q += h * qd
    measured = rows[:, 1] + 1e-5 * rng.normal(size=n)
    effort = rows[:, 2] + noise * rng.normal(size=n)
    outside = rows[:, 3:4].copy() if push is not ZERO else None
    return single("axis", rows[:, 0], measured, effort, tau_ext=outside)


def axes_apart(seed: int = 1) -> Recording:
    """Two axes of one robot, each with a plant of its own."""
    a, b = axis(seed), axis(seed + 10, warm=lambda t: 2.0)
    q, tau = (np.concatenate(x, axis=1) for x in ((a.q, b.q), (a.tau, b.tau)))
    return replace(a, joints=("joint1", "joint2"), q=q, tau=tau)


#: Inertia, Coulomb and viscous friction of `stiction_axis`.
STICTION_J, STICTION_FC, STICTION_FV = 0.05, 0.6, 0.3


def stiction_axis(
    seed: int,
    drag: float = 0.0,
    peak: float = 0.0,
    late: int = 0,
    seconds: float = 20.0,
    gear: float = 0.0,
    spring: float = 0.0,
) -> Recording:
    """A multisine under PD control; `drag` v|v|, Stribeck `peak` of 0.15 rad/s, `late` samples.

    A `gear` rubs in proportion to the effort, for example that which holds a `spring`.
    """
    rng, rate, fine = np.random.default_rng(seed), 500, 10
    omega = 2 * np.pi * np.array([0.11, 0.27, 0.6, 1.3]) * rng.uniform(0.9, 1.1, 4)
    size, phase = np.array([0.8, 0.3, 0.1, 0.04]), rng.uniform(0, 2 * np.pi, 4)
    n, dt = int(seconds * rate), 1 / rate / fine
    t = np.arange(n) / rate
    goal = np.sin(np.outer(t, omega) + phase) @ size
    speed = np.cos(np.outer(t, omega) + phase) @ (size * omega)
    q, v, out, sent = float(goal[0]), 0.0, np.zeros((n, 2)), [0.0] * (late + 1)
    eased = 1 + dt * STICTION_FV / STICTION_J
    for k in range(n):
        tau = 80.0 * (goal[k] - q) + 4.0 * (speed[k] - v)
        out[k] = q, tau
        sent = [*sent[1:], tau]
        for _ in range(fine):
            free = (v + dt * (sent[0] - drag * v * abs(v) - spring * q) / STICTION_J) / eased
            dry = STICTION_FC + peak * np.exp(-((v / 0.15) ** 2)) + gear * abs(sent[0])
            v = float(np.sign(free) * max(abs(free) - dt * dry / STICTION_J / eased, 0.0))
            q += v * dt
    out += rng.normal(size=out.shape) * [1e-5, 0.02]
    return single("stiction", t, out[:, 0].copy(), out[:, 1].copy())


@numba.njit(cache=True)
def _sent(goal: np.ndarray, mass: float, dry: float, viscous: float, stiff: float) -> np.ndarray:
    """Position and command (n, 2) under PD control at 1 kHz, ten steps each; exact dry friction."""
    out, damp, dt = np.empty((goal.size, 2)), 1.4 * np.sqrt(stiff * mass), 1e-4
    q, v = goal[0], 0.0
    for k in range(goal.size):
        speed = (goal[min(k + 1, goal.size - 1)] - goal[max(k - 1, 0)]) * 500.0
        tau = stiff * (goal[k] - np.round(q * 1e5) * 1e-5) + damp * (speed - v)
        out[k, 0], out[k, 1] = q, tau
        for _ in range(10):
            free = (v + dt * tau / mass) / (1 + dt * viscous / mass)
            v = np.sign(free) * max(abs(free) - dt * dry / mass, 0.0)
            q += v * dt
    return out


def sent_axis(seed: int, rate: float, seconds: float = 40.0) -> Recording:
    """Moves of constant acceleration and short rests, of which every few rows are kept."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 1e-3)
    mass, quick, fast = rng.uniform(1, 20), rng.uniform(0.8, 4), rng.uniform(0.2, 1)
    goal, x = np.empty(0), 0.0
    while goal.size < t.size:
        to = rng.uniform(-0.4, 0.4)
        most = min(fast * rng.uniform(0.3, 1), np.sqrt(quick * abs(to - x)))
        gain = most / quick
        lasts = abs(to - x) / most + gain
        u = np.arange(0.0, lasts, 1e-3)
        rise = 0.5 * quick * (np.clip(u, 0, gain) ** 2 - np.clip(u - lasts + gain, 0, gain) ** 2)
        path = rise + most * np.clip(u - gain, 0, None)
        rest = np.full(int(1e3 * rng.uniform(0.1, 0.6)), to)
        goal, x = np.concatenate([goal, x + np.sign(to - x) * path, rest]), to
    dry, viscous = rng.uniform(0.1, 0.6) * mass * quick, rng.uniform(0.1, 0.5) * mass * quick / fast
    out = _sent(goal[: t.size], mass, dry, viscous, mass * rng.uniform(15, 50) ** 2)
    rows = slice(None, None, round(1e3 / rate))
    q, tau = np.round(out[rows, 0] * 1e5) * 1e-5, out[rows, 1]
    return single(f"sent{seed}", t[rows], q, tau + 0.005 * mass * quick * rng.normal(size=q.size))


#: Inertias of the motor and of the link of `transmission`, and its friction.
MOTOR, LINK, _VISCOUS, _DRY = 0.02, 0.06, 0.25, 0.12
_FAST, _FINE = 500, 40


@numba.njit(cache=True)
def _driven(
    goal: np.ndarray,
    speed: np.ndarray,
    gravity: float,
    frequency: float,
    zeta: float,
    width: float,
    lag: float,
    ripple: float,
    harden: float,
    mode: float,
    mode_hz: float,
    rub: float,
) -> np.ndarray:
    """Motor angle and command (n, 2) under PD control of the motor's side."""
    dt = 1 / (_FAST * _FINE)
    out = np.empty((goal.size, 2))
    q, v, p, w, real = goal[0], 0.0, goal[0], 0.0, 0.0
    x, xv = goal[0], 0.0
    # with the motor held the link swings at sqrt(k / LINK)
    stiff = LINK * (2 * np.pi * frequency) ** 2 if frequency > 0 else 0.0
    damp = 2 * zeta * np.sqrt(stiff * LINK) if stiff > 0 else 0.0
    hold = mode * (2 * np.pi * mode_hz) ** 2
    for k in range(goal.size):
        tau = 40.0 * (goal[k] - q) + 2.0 * (speed[k] - v)
        tau += gravity * np.sin(q)
        out[k, 0], out[k, 1] = q, tau
        for _ in range(_FINE):
            if lag > 0:
                real += dt / lag * (tau - real)
            else:
                real = tau
            drive = real * (1 + ripple * np.sin(9.0 * q))
            side = np.tanh(v / 0.002)
            drag = _VISCOUS * v + _DRY * side
            ring = hold * (q - x) + 0.04 * np.sqrt(hold * mode + 1e-12) * (v - xv)
            if mode > 0:
                xv += dt * ring / mode
                x += dt * xv
            if stiff == 0.0:
                a = (drive - drag - ring - gravity * np.sin(q)) / (MOTOR + LINK)
                v += dt * a
                q += dt * v
                p, w = q, v
                continue
            twist = q - p
            if width > 0:
                twist = twist - min(max(twist, -width / 2), width / 2)
            touch = 1.0 if twist != 0.0 else 0.0
            force = stiff * twist * (1 + harden * abs(stiff * twist)) + damp * (v - w) * touch
            v += dt * (drive - drag - ring - force) / MOTOR
            dry = 0.01 * w + rub * np.tanh(w / 0.002)
            w += dt * (force - gravity * np.sin(p) - dry) / LINK
            q += dt * v
            p += dt * w
    return out


def transmission(
    seed: int, gravity: float = 0.0, seconds: float = 20.0, fast: float = 1.0, **what: float
) -> Recording:
    """A motor and a link behind a spring or a play, a lagging amplifier; `what` is hidden.

    A multisine up to about 5 Hz.
    """
    rng = np.random.default_rng(seed)
    omega = fast * 2 * np.pi * np.array([0.13, 0.37, 0.9, 2.1, 4.7]) * rng.uniform(0.9, 1.1, 5)
    size, phase = np.array([0.5, 0.25, 0.15, 0.08, 0.04]), rng.uniform(0, 2 * np.pi, 5)
    t = np.arange(int(seconds * _FAST)) / _FAST
    goal = np.sin(np.outer(t, omega) + phase) @ size
    speed = np.cos(np.outer(t, omega) + phase) @ (size * omega)
    names = ("frequency", "zeta", "width", "lag", "ripple", "harden", "mode", "mode_hz", "rub")
    values = {"zeta": 0.05, "mode_hz": 9.0, **what}
    out = _driven(goal, speed, gravity, *(float(values.get(n, 0.0)) for n in names))
    out += rng.normal(size=out.shape) * [2e-6, 0.01]
    return single("drive", t, out[:, 0].copy(), out[:, 1].copy())


def counted_loop(seed: int, counts: int, seconds: float = 25.0) -> Recording:
    """J q'' = u - Fc sgn q' - Fv q', u a PD law with feedforward on the counted position."""
    inertia, dry, viscous, fine = 0.018, 0.12, 0.05, 4
    rng, h, step = np.random.default_rng(seed), 1e-3, 2 * np.pi / counts
    t = np.arange(0.0, seconds, h)
    f = np.array([0.07, 0.16, 0.4, 0.9]) * rng.uniform(0.9, 1.1, 4)
    w, angle = 2 * np.pi * f, np.outer(t, 2 * np.pi * f) + rng.uniform(0, 6.28, 4)
    a = np.array([0.9, 0.5, 0.25, 0.08])
    goal, rate = np.sin(angle) @ a, np.cos(angle) @ (a * w)
    speed_up = -np.sin(angle) @ (a * w**2)
    q, v, before = float(goal[0]), float(rate[0]), 0.0
    seen, effort = np.empty((2, t.size))
    for k in range(t.size):
        seen[k] = np.round(q / step) * step
        moved = (seen[k] - before) / h if k else v
        before = seen[k]
        u = 25.0 * (goal[k] - seen[k]) + 0.7 * (rate[k] - moved) + inertia * speed_up[k]
        effort[k] = u
        for _ in range(fine):
            free = (v + h / fine * u / inertia) / (1 + h / fine * viscous / inertia)
            v = float(np.sign(free) * max(abs(free) - h / fine * dry / inertia, 0.0))
            q += h / fine * v
    effort += 0.01 * rng.standard_normal(t.size)
    return single("axis", t, seen, effort)


def geared_axis(counts: int, seed: int, peak: float = 0.0) -> Recording:
    """A joint that a velocity loop on its counts moves; tanh and, if asked, Stribeck friction."""
    fs = 500.0
    rng, dt, n = np.random.default_rng(seed), 0.2 / fs, int(25 * fs)
    w, phase = 2 * np.pi * rng.uniform(0.05, 0.5, 5), rng.uniform(0, 6, 5)
    step = 2 * np.pi / counts
    q = v = speed = last = integral = 0.0
    start = 0.3 * np.sin(phase).sum()
    rows = np.empty((n, 2))
    for k in range(n):
        angle = w * k / fs + phase
        goal, rate = 0.3 * np.sin(angle).sum() - start, 0.3 * (w * np.cos(angle)).sum()
        seen = step * np.round(q / step)
        speed += 0.1 * ((seen - last) * fs - speed)
        last = seen
        integral += 100.0 * (goal - seen) / fs
        tau = 150.0 * (goal - seen) + 25.0 * (rate - speed) + integral
        rows[k] = seen, tau + 0.1 * rng.normal()
        for _ in range(5):
            rub = (4.0 + peak / (1.0 + (v / 0.08) ** 2)) * np.tanh(v / 0.02) + 6.0 * v
            v += dt * (tau - rub) / 1.6
            q += dt * v
    return single("gear", np.arange(n) / fs, rows[:, 0], rows[:, 1])


def quick_axis(seed, extra=0.0, width=0.0, noise=0.02, seconds=28.0):
    """A quick axis with exact dry friction, or a smooth one over `width` [rad/s]; `extra` at rest.

    J q'' = tau - Fv q' - (Fc + extra / (1 + (q' / 0.1)^2)) sgn q'
    """
    fs, fine, inertia, viscous, coulomb, count = 1000.0, 8, 0.09, 0.2, 0.3, 2 * np.pi / 2**20
    rng, h = np.random.default_rng(seed), 1 / fs / fine
    t = np.arange(int(seconds * fs)) / fs
    f = np.array([0.1, 0.23, 0.41, 0.72, 1.1])
    goal = np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6.28, 5)) @ (
        rng.uniform(0.6, 1, 5) / f**0.8
    )
    goal *= 1.2 / np.abs(goal).max() * np.clip(t / 1.5, 0, 1)
    rate = np.gradient(goal, 1 / fs)
    q, qd, rows = float(goal[0]), 0.0, np.empty((t.size, 2))
    for k in range(t.size):
        seen = np.floor(q / count + 0.5) * count
        tau = 70.0 * (goal[k] - seen) + 4.0 * (rate[k] - qd)
        rows[k] = seen, tau
        for _ in range(fine):
            dry = coulomb + extra / (1 + (qd / 0.1) ** 2)
            free = qd + h * (tau - viscous * qd) / inertia
            if width:
                qd = free - h * dry * np.tanh(qd / width) / inertia
            else:
                qd = np.sign(free) * max(abs(free) - h * dry / inertia, 0.0)
            q += h * qd
    rows[:, 1] += noise * rng.normal(size=t.size)
    return single("run", t, rows[:, 0], rows[:, 1])


def braked_axis(seed: int, peak: float = 0.7, at: float = 9.0, seconds: float = 20.0) -> Recording:
    """A shaft with a bearing and an eddy-current brake, whose torque is largest at a speed `at`.

    tau = J q'' + Fc sgn q' + Fv q' + 2 peak x / (1 + x^2),  x = q' / at
    """
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * 250)) / 250.0
    w, phase = 2 * np.pi * rng.uniform(0.1, 1.2, 6), rng.uniform(0, 2 * np.pi, 6)
    q, v, a = sines(t, w, rng.normal(0.0, 4.0, 6) / np.sqrt(w), phase)
    x = v / at
    tau = 0.015 * a + 0.11 * np.tanh(v / 1e-3) + 0.004 * v + 2 * peak * x / (1 + x * x)
    tau += 0.008 * rng.normal(size=t.size)
    return single(f"brake{seed}", t, q + 1e-5 * rng.normal(size=t.size), tau)


def stepped_axis(seed, step, spring=0.0, sent=False, speeds=(0.05, 0.8), seconds=24.0):
    """A slow axis whose motor gets the effort u that is asked for in whole steps [N m].

    J q'' = h round(u / h) - Fv q' - Fc tanh(q' / 0.01) - k q;  the rows hold u, or where `sent`
    what is sent.
    """
    fs, inertia, viscous, dry, count = 1000.0, 0.08, 0.6, 0.5, 1e-5
    rng, h = np.random.default_rng(seed), 1 / fs
    goal, side = [0.0], 1.0
    while len(goal) < seconds * fs:
        pace, way = rng.uniform(*speeds), rng.uniform(0.3, 0.9)
        goal += list(
            np.linspace(goal[-1], side * way, max(int(abs(side * way - goal[-1]) * fs / pace), 300))
        )
        side = -side
    kernel = np.ones(100) / 100
    path = np.convolve(
        np.pad(goal[: int(seconds * fs)], 99, mode="edge"), np.convolve(kernel, kernel), "valid"
    )
    rate = np.gradient(path, h)
    q, qd, rows = float(path[0]), 0.0, np.empty((path.size, 2))
    for k in range(path.size):
        seen = np.round(q / count) * count
        asked = 60.0 * (path[k] - seen) + 4.0 * (rate[k] - qd) + viscous * rate[k] + spring * seen
        got = step * np.round(asked / step)
        rows[k] = seen, got if sent else asked
        qd += h * (got - viscous * qd - dry * np.tanh(qd / 0.01) - spring * q) / inertia
        q += h * qd
    return single(f"run{seed}", h * np.arange(path.size), rows[:, 0], rows[:, 1])


@numba.njit(cache=True)
def _screwed(path: np.ndarray, h: float) -> np.ndarray:
    """Angle and effort (n, 2) of a screw under a stiff servo, at steps h."""
    inertia, dry, viscous = 8e-4, 0.2, 0.003
    out, q, v, sum_ = np.empty((path.size, 2)), path[0], 0.0, 0.0
    for k in range(path.size):
        ahead = path[min(k + 1, path.size - 1)]
        error = path[k] - q
        sum_ += 200.0 * error * h
        u = 40.0 * error + 0.6 * ((ahead - path[k]) / h - v) + sum_
        out[k] = q, u
        v += h * (u - viscous * v - dry * np.tanh(v / 0.002)) / inertia
        q += h * v
    return out


def sharp_screw(seed, late=0.4e-3, seconds=40.0):
    """A screw whose dry friction turns within 0.002 rad/s; coarse counts, efforts `late` [s]."""
    h, part, noise, count = 2e-5, 50, 0.006, 2 * np.pi / 2**14
    rng = np.random.default_rng(seed)
    t = h * np.arange(int(seconds / h))
    f = np.array([0.1, 0.23, 0.4, 0.77, 1.3, 2.1])
    path = np.sin(2 * np.pi * f * t[:, None] + rng.uniform(0, 6.28, 6)) @ (1.0 / f**0.5)
    path *= 12.0 / np.abs(path).max() * np.clip(t, 0, 1)
    found, back = _screwed(path, h), round(late / h)
    at = np.arange(back, t.size, part)
    tau = found[at - back, 1] + noise * rng.normal(size=at.size)
    return single("screw", h * (at - back), count * np.round(found[at, 0] / count), tau)


#: Mass, Coulomb and viscous friction of `pushed_axes`.
MASS, DRY, VISCOUS = 2.0, 0.5, 1.5


@numba.njit(cache=True)
def _pushed(tau: np.ndarray, rate: float, fine: int) -> np.ndarray:
    """Positions (n, joints) of axes that efforts (n, joints) push from rest."""
    path, h = np.empty_like(tau), 1 / rate / fine
    for j in range(tau.shape[1]):
        q = v = 0.0
        for k in range(len(tau)):
            path[k, j] = q
            for _ in range(fine):
                v = v + h / MASS * (tau[k, j] - VISCOUS * v)
                v = np.sign(v) * max(abs(v) - h * DRY / MASS, 0.0)
                q = q + h * v
    return path


def pushed_axes(seed: int, noise: float, joints: int = 1, seconds: float = 24.0) -> Recording:
    """Axes of 2 kg m^2 with Coulomb 0.5 and viscous 1.5, driven by sums of sines, 500 Hz."""
    rng, rate = np.random.default_rng(seed), 500.0
    t = np.arange(round(seconds * rate)) / rate
    w = 2 * np.pi * rng.uniform(0.3, 1.6, (4, joints))
    tau = 3.0 * np.sin(t[:, None, None] * w + rng.uniform(0, 6, (4, joints))).sum(axis=1)
    path = _pushed(tau, rate, 20)
    names = tuple(f"joint{j + 1}" for j in range(joints))
    measured = path + noise * rng.normal(size=path.shape)
    return Recording(f"plant{seed}", "arm", names, t, measured, tau)


#: A robot of one joint.
ONE_JOINT = """<robot name="one"><link name="base"/><link name="arm"><inertial>
<origin xyz="0.1 0 0"/><mass value="0.5"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/>
<axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint></robot>"""

# --- arms ------------------------------------------------------------------------------------

L1, L2 = 0.215, 0.170
PI = np.array([2.8e-3, 1.1e-3, -3.9e-4, 9.1e-4, 2.4e-3, 9.3e-4, -1.6e-2, -7.4e-2])


def _tip(q: np.ndarray) -> np.ndarray:
    r = L1 * np.cos(q[:, 1]) + L2 * np.sin(q[:, 2])
    z = L1 * np.sin(q[:, 1]) - L2 * np.cos(q[:, 2])
    return np.stack([r * np.cos(q[:, 0]), r * np.sin(q[:, 0]), z], axis=1)


def _mass(q: np.ndarray) -> np.ndarray:
    m = np.zeros((len(q), 3, 3))
    m[:, 0, 0] = (
        PI[0]
        + PI[1] * np.cos(2 * q[:, 1])
        + PI[2] * np.cos(2 * q[:, 2])
        + PI[3] * np.cos(q[:, 1]) * np.sin(q[:, 2])
    )
    m[:, 1, 1], m[:, 2, 2] = PI[4], PI[5]
    m[:, 1, 2] = m[:, 2, 1] = -PI[3] / 2 * np.sin(q[:, 1] - q[:, 2])
    return m


def _slope(f: Callable[[np.ndarray], np.ndarray], q: np.ndarray) -> np.ndarray:
    """Derivative of f (n, ...) by each joint, last axis."""
    e = 1e-6 * np.eye(3)
    return np.stack([(f(q + e[k]) - f(q - e[k])) / 2e-6 for k in range(3)], axis=-1)


def arm(
    seed: int = 0,
    seconds: float = 20.0,
    noise: float = 2e-3,
    force: Callable[[np.ndarray], np.ndarray] | None = None,
    sensor: Callable[[np.ndarray, np.ndarray], np.ndarray] = lambda t, w: w,
    late: float = 0.0,
    joint_error: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
) -> Recording:
    """A PHANTOM Premium: its effort from Lagrange's equations along a prescribed motion.

    tau = M q'' + (dM/dt) q' - 1/2 d(q' M q')/dq + N + friction - J' force; the sensor shows
    sensor(t, force), the encoders the motion `late` seconds ago plus joint_error(t, q).
    """
    rng = np.random.default_rng(seed)
    f = np.array([0.13, 0.31, 0.7, 1.1])
    a = np.array([0.35, 0.15, 0.06, 0.03])
    ph = rng.uniform(0, 6.28, (3, 4))
    scale = f * rng.uniform(0.9, 1.1, (3, 4)) * 2 * np.pi
    t = np.arange(int(seconds * RATE)) / RATE
    home = np.array([0.0, 0.3, 0.4])
    q, qd, qdd = sines(t, scale, a, ph)
    q = home + q
    dm = _slope(_mass, q)
    tau = np.einsum("nij,nj->ni", _mass(q), qdd)
    tau += np.einsum("nijk,nk,nj->ni", dm, qd, qd) - np.einsum("njki,nj,nk->ni", dm, qd, qd) / 2
    tau[:, 1] += PI[6] * np.cos(q[:, 1])
    tau[:, 2] += PI[7] * np.sin(q[:, 2])
    tau += 0.01 * np.sign(qd) + 0.002 * qd
    wrench = None
    if force is not None:
        w = force(t)
        tau -= np.einsum("nkd,nk->nd", _slope(_tip, q), w)
        wrench = np.zeros((t.size, 6))
        wrench[:, :3] = sensor(t, w) + 1e-3 * rng.normal(size=w.shape)
    shown = home + sines(t - late, scale, a, ph)[0]
    shown = shown if joint_error is None else shown + joint_error(t, shown)
    return Recording(
        "arm",
        "arm",
        ("joint1", "joint2", "joint3"),
        t,
        shown + 2e-6 * rng.normal(size=q.shape),
        tau + noise * rng.normal(size=q.shape),
        wrench=wrench,
        robot=RobotSource("phantom-premium-1.5"),
    )


def hand(t: np.ndarray) -> np.ndarray:
    """A hand that pushes in all directions, up to 3 N."""
    parts = [np.sin(2 * np.pi * f * t + p) for f, p in ((0.23, 0.4), (0.41, 1.9), (0.17, 2.8))]
    return 2.0 * np.stack(parts, axis=1) + 0.5


#: A planar arm: masses [kg], length and centres [m], inertias about the centres [kg m^2], friction.
M, L, C, TURN = (1.6, 0.9), 0.3, (0.14, 0.12), (0.014, 0.005)
PLANAR_FC, PLANAR_FV, G = np.array([0.12, 0.08]), np.array([0.1, 0.06]), 9.81

_LINK = """<link name="{0}"><inertial><origin xyz="{1} 0 0"/><mass value="{2}"/>
<inertia ixx="1e-4" iyy="{3}" izz="{3}" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
_JOINT = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>
<origin xyz="{3} 0 0"/><axis xyz="0 -1 0"/><limit lower="-3" upper="3" effort="20" velocity="9"/>
</joint>"""
PLANAR = "".join(
    [
        '<robot name="planar"><link name="base"/>',
        _LINK.format("upper", C[0], M[0], TURN[0]),
        _LINK.format("fore", C[1], M[1], TURN[1]),
        _JOINT.format("shoulder", "base", "upper", 0),
        _JOINT.format("elbow", "upper", "fore", L),
        "</robot>",
    ]
)


def planar(
    seed: int,
    gain=(1.0, 1.0),
    offset=(0.0, 0.0),
    seconds: float = 25.0,
    noise=(0.02, 0.01),
    shared=(0.0, 0.0),
) -> Recording:
    """An arm of two joints in a vertical plane, from its Lagrangian; five tones a joint.

    The motors' commands are gain times their torque, plus offset.  `shared`: inertia [kg m^2] and
    dry friction [N m] of a rotor that turns with the first joint less the second.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 1e-3)
    f = np.array([0.07, 0.16, 0.37, 0.8, 1.4])[:, None] * rng.uniform(0.9, 1.1, (5, 2))
    a = np.array([0.6, 0.4, 0.2, 0.08, 0.03])
    q, v, w = sines(t, 2 * np.pi * f.T, a, rng.uniform(0, 6.28, (5, 2)).T)
    q = q + np.array([-0.3, 0.5])
    (c1, c12), s2 = (np.cos(x) for x in (q[:, 0], q.sum(axis=1))), np.sin(q[:, 1])
    k = M[1] * L * C[1]
    one = TURN[0] + M[0] * C[0] ** 2 + TURN[1] + M[1] * (L**2 + C[1] ** 2) + 2 * k * np.cos(q[:, 1])
    two = TURN[1] + M[1] * C[1] ** 2
    both = two + k * np.cos(q[:, 1])
    heavy = G * M[1] * C[1] * c12
    tau = np.stack(
        [
            one * w[:, 0]
            + both * w[:, 1]
            - k * s2 * v[:, 1] * (2 * v[:, 0] + v[:, 1])
            + G * (M[0] * C[0] + M[1] * L) * c1
            + heavy,
            both * w[:, 0] + two * w[:, 1] + k * s2 * v[:, 0] ** 2 + heavy,
        ],
        axis=1,
    )
    apart = shared[0] * (w[:, 0] - w[:, 1]) + shared[1] * np.sign(v[:, 0] - v[:, 1])
    tau += apart[:, None] * np.array([1.0, -1.0])
    tau += PLANAR_FC * np.sign(v) + PLANAR_FV * v + noise * rng.standard_normal(v.shape)
    tau = tau * gain + offset
    q = q + 1e-6 * rng.standard_normal(q.shape)
    return Recording(
        f"run{seed}", "arm", ("shoulder", "elbow"), t, q, tau, robot=RobotSource("", PLANAR)
    )


#: Joints of `spatial`, its friction, the masses of its links [kg] and the noise of its efforts.
JOINTS = ("base", "upper", "fore")
SPATIAL_FC, SPATIAL_FV = np.array([0.30, 0.25, 0.12]), np.array([0.20, 0.15, 0.05])
TRUE = (3.0, 1.6, 0.8)
NOISE = 0.02


def spatial_urdf(masses: tuple[float, float, float] = TRUE) -> str:
    """Shoulder about z, then two pitch joints; links of 0.3 m with the given masses."""
    axes = ("0 0 1", "0 1 0", "0 1 0")
    links = ['<link name="world"/>']
    joints = []
    parent = "world"
    for name, axis, m in zip(JOINTS, axes, masses, strict=True):
        at = "0 0 0" if parent in ("world", "base_link") else "0.3 0 0"
        links.append(
            f'<link name="{name}_link"><inertial><origin xyz="0.15 0.01 0.02"/>'
            f'<mass value="{m}"/><inertia ixx="{0.002 * m}" iyy="{0.01 * m}" izz="{0.011 * m}" '
            f'ixy="{0.0005 * m}" ixz="0" iyz="0"/></inertial></link>'
        )
        joints.append(
            f'<joint name="{name}" type="revolute"><origin xyz="{at}"/><parent link="{parent}"/>'
            f'<child link="{name}_link"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="99" velocity="9"/></joint>'
        )
        parent = f"{name}_link"
    return f'<robot name="arm">{"".join(links + joints)}</robot>'


def _rnea(model: pin.Model, motion: Path3) -> np.ndarray:
    """Efforts (n, d) by Pinocchio."""
    data = model.createData()
    return np.array([pin.rnea(model, data, *x).copy() for x in zip(*motion, strict=True)])


#: Reflected inertia of the rotor before the belt of `spatial` [kg m^2].
ROTOR = 0.06


def spatial(
    seed: int,
    seconds: float = 20.0,
    name: str = "",
    offset: float = 0.0,
    tilt: tuple[float, float] = (0.0, 0.0),
    belt: float = 0.0,
    play: float = 0.0,
    driven: int = 1,
    rotor: float = ROTOR,
    home: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Recording:
    """Random band-limited motion; effort = rnea + Coulomb and viscous friction + noise.

    With `tilt` the base is turned about its x and y axes [rad]; with `belt` joint number `driven`
    is driven over a spring [N m/rad], with `play` over a play [rad] whose flanks take 0.1 N m to
    reach, by a motor with a rotor and an encoder of its own.
    """
    rng, fs = np.random.default_rng(seed), 500.0
    t = np.arange(int(seconds * fs)) / fs
    w = 2 * np.pi * rng.uniform(0.1, 1.2, (3, 6))
    phase, size = rng.uniform(0, 2 * np.pi, (3, 6)), rng.uniform(0.3, 0.6, (3, 6)) / w**0.5
    q, qd, qdd = sines(t, w, size, phase)
    q += home
    model = pin.buildModelFromXML(spatial_urdf())
    model.gravity.linear = pin.exp3(np.array([*tilt, 0.0])).T @ model.gravity.linear
    tau = _rnea(model, (q, qd, qdd))
    if belt or play:
        load = tau[:, driven]
        q[:, driven] += load / belt if belt else play / 2 * load / (0.1 + np.abs(load))
        qd[:, driven] = np.gradient(q[:, driven], t)
        tau[:, driven] += rotor * np.gradient(qd[:, driven], t)
    tau += SPATIAL_FC * np.sign(qd) + SPATIAL_FV * qd + NOISE * rng.normal(size=tau.shape) + offset
    source = RobotSource("", spatial_urdf())
    return Recording(name or f"run{seed}", "arm", JOINTS, t, q, tau, robot=source)


def taught(seed: int, seconds: float = 30.0) -> Recording:
    """The arm of `spatial`, without its description: one joint moves at a time, then rests."""
    rng, t = np.random.default_rng(seed), np.arange(int(seconds * 100)) / 100.0
    q, v, a = np.zeros((3, t.size, 3))
    home = np.array([0.0, -0.5, 0.9])
    at, start, j = home.copy(), 0.5, 0
    q += home
    while start < seconds - 2.5:
        took = rng.uniform(0.8, 1.8)
        goal = home[j] + rng.uniform(-0.7, 0.7)
        size, s = goal - at[j], np.clip((t - start) / took, 0.0, 1.0)
        q[:, j] += size * s**3 * (10 - 15 * s + 6 * s**2)
        v[:, j] += size * 30 * s**2 * (1 - s) ** 2 / took
        a[:, j] += size * 60 * s * (1 - s) * (1 - 2 * s) / took**2
        at[j], start, j = goal, start + took + 0.2, (j + 1) % 3
    tau = _rnea(pin.buildModelFromXML(spatial_urdf()), (q, v, a))
    tau += SPATIAL_FC * np.tanh(v / 0.01) + SPATIAL_FV * v + NOISE * rng.normal(size=q.shape)
    return Recording(f"run{seed}", "arm", JOINTS, t, q, tau, robot=SINGLE)


#: Axes and friction of `serial_arm`; mass, centre and inertia of the body that it may carry.
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "1 0 0", "0 1 0")
SERIAL_FC = np.array([1.5, 6.0, 3.0, 1.0, 0.6, 0.4, 0.3])
BODY, BODY_AT, _ABOUT = 0.5, np.array([0.03, 0.02, 0.1]), np.diag([0.003, 0.004, 0.002])


def serial_urdf(d: int, axes: tuple[str, ...] = AXES) -> str:
    """URDF of a serial arm."""
    out = '<robot name="arm"><link name="l0"/>'
    for k in range(1, d + 1):
        up = 0.1 if k == 1 else 0.22
        out += (
            f'<link name="l{k}"><inertial><origin xyz="0.01 0.005 0.1"/><mass value="{4 / k}"/>'
            f'<inertia ixx="{0.02 / k}" ixy="0" ixz="0" iyy="{0.018 / k}" iyz="0" '
            f'izz="{0.006 / k}"/></inertial></link><joint name="joint{k}" type="revolute">'
            f'<parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="0 0 {up}"/>'
            f'<axis xyz="{axes[k - 1]}"/><limit lower="-3" upper="3" effort="200" velocity="10"/>'
            "</joint>"
        )
    end = '<link name="tip"/><joint name="end" type="fixed"><parent link="l{}"/><child link="tip"/>'
    return out + end.format(d) + '<origin xyz="0 0 0.15"/></joint></robot>'


def _four_tones(rng: np.random.Generator, t: np.ndarray, d: int) -> Path3:
    """Motions (n, d) on four tones a joint, the slow ones larger."""
    w = 2 * np.pi * rng.uniform(0.08, 0.7, (d, 4))
    return sines(t, w, 0.35 / w**0.5, rng.uniform(0, 6.28, (d, 4)))


#: Mass [kg], damping [N s/m] and stiffness [N/m] of a hand at the tip, and where it rests [m].
HAND = (0.8, 6.0, 40.0, (0.2, 0.1, 0.5))


def _in_hand(model: pin.Model, motion: Path3) -> np.ndarray:
    """Efforts (n, d) that move what holds the tip, by Pinocchio."""
    m, b, k, rest = HAND
    data, tip, out = model.createData(), model.getFrameId("tip"), []
    seen = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for q, v, a in zip(*motion, strict=True):
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        speed = pin.getFrameVelocity(model, data, tip, seen).linear
        accelerated = pin.getFrameClassicalAcceleration(model, data, tip, seen).linear
        force = m * accelerated + b * speed + k * (data.oMf[tip].translation - np.array(rest))
        jac = pin.computeFrameJacobian(model, data, q, tip, seen)
        out.append(jac[:3].T @ force)
    return np.array(out)


def serial_arm(
    d: int,
    seed: int,
    link: int = 0,
    wrong: int = 0,
    axes: tuple[str, ...] = AXES,
    seconds: float = 20.0,
    hand: bool = False,
    reach: float = 1.0,
    posture: float = 0.0,
    noise: float = 0.03,
) -> Recording:
    """An arm whose effort is Pinocchio's, with friction and noise; a body on `link`, if asked.

    It moves about a `posture` of all joints, `reach` times as far as usual.

    wrong: seed of errors of 5 % in the masses, centres and inertias that it is described with.
    noise: of the efforts, in shares of the friction's levels.
    hand: a hand that carries its own weight holds the tip (`HAND`).
    """
    text, rng, t = serial_urdf(d, axes), np.random.default_rng(seed), np.arange(0.0, seconds, 0.004)
    q, v, a = (reach * x for x in _four_tones(rng, t, d))
    q = q + posture
    model = pin.buildModelFromXML(text)
    if wrong:
        factors = 1 + 0.05 * np.random.default_rng(wrong).standard_normal((d, 3))
        for body, f in zip(list(model.inertias)[1:], factors, strict=True):
            body.mass, body.lever, body.inertia = (
                body.mass * f[0],
                body.lever * f[1],
                body.inertia * f[2],
            )
    if link:
        model.appendBodyToJoint(link, pin.Inertia(BODY, BODY_AT, _ABOUT), pin.SE3.Identity())
    tau = _rnea(model, (q, v, a))
    if hand:
        tau += _in_hand(model, (q, v, a))
    held = SERIAL_FC[:d] / d**0.5
    tau += held * (0.1 * np.tanh(v / 0.01) + 0.1 * v + noise * rng.standard_normal(tau.shape))
    q = q + 1e-6 * rng.standard_normal(q.shape)
    names = tuple(f"joint{k}" for k in range(1, d + 1))
    return Recording(f"run{seed}", "arm", names, t, q, tau, robot=RobotSource("", text))


#: Where the joints of `cart_arm` lie on the link before, and their axes.
CART_AT = ("0 0 0.1", "0.03 0 0.09", "0 0 0.22", "0 0 0.2")
CART_AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1")
#: Masses and centres of mass of its links: as they are, and how they are described.
CART = (
    np.array([2.5, 1.8, 1.2, 0.8]),
    np.array([[0.01, 0.0, 0.03], [0.0, 0.01, 0.1], [0.0, -0.01, 0.09], [0.01, 0.005, 0.05]]),
)
CART_SAID = CART[0] * [0.92, 1.09, 0.9, 1.1], CART[1] * [[0.97], [1.03], [0.96], [1.04]]
#: Its rotors' inertias, which no description holds.
CART_ROTORS = np.array([0.2, 0.2, 0.12, 0.05])


def cart_urdf(masses: np.ndarray, centres: np.ndarray) -> str:
    """URDF of an arm whose second axis lies beside the first one."""
    out = '<robot name="arm"><link name="l0"/>'
    parts = zip(masses, centres, CART_AT, CART_AXES, strict=True)
    for k, (m, (x, y, z), at, axis) in enumerate(parts, start=1):
        out += (
            f'<link name="l{k}"><inertial><origin xyz="{x} {y} {z}"/><mass value="{m}"/>'
            f'<inertia ixx="{0.005 * m}" ixy="0" ixz="0" iyy="{0.005 * m}" iyz="0" '
            f'izz="{0.001 * m}"/></inertial></link><joint name="joint{k}" type="revolute">'
            f'<parent link="l{k - 1}"/><child link="l{k}"/><origin xyz="{at}"/>'
            f'<axis xyz="{axis}"/><limit lower="-3" upper="3" effort="200" velocity="10"/></joint>'
        )
    return out + "</robot>"


def cart_arm(seed: int, tilt: tuple[float, float] = (0.06, -0.035)) -> Recording:
    """A geared arm on a cart that leans; it is described upright, its masses 8 to 10 % wrong.

    What the level arm shows of a link near the first axis is one with the rotor.
    """
    rng, t = np.random.default_rng(seed), np.arange(0.0, 30.0, 0.005)
    q, v, a = _four_tones(rng, t, 4)
    q += np.array([0.0, 0.5, 0.9, 0.0])
    model = pin.buildModelFromXML(cart_urdf(*CART))
    model.gravity.linear = pin.exp3(np.array([*tilt, 0.0])).T @ model.gravity.linear
    held = np.array([1.2, 1.1, 0.7, 0.4])
    tau = _rnea(model, (q, v, a)) + CART_ROTORS * a + held * np.tanh(v / 0.003) + 0.6 * held * v
    tau += 0.04 * held * rng.standard_normal(tau.shape)
    q = q + 1e-5 * rng.standard_normal(q.shape)
    names, source = tuple(f"joint{k}" for k in range(1, 5)), RobotSource("", cart_urdf(*CART_SAID))
    return Recording(f"run{seed}", "arm", names, t, q, tau, robot=source)


#: Steps of a sample over which `repeated` averages its efforts.
FINE_STEPS = 8


def repeated(
    seed: int,
    fs: float = 200.0,
    seconds: float = 40.0,
    averaged: bool = False,
    stribeck: float = 0.0,
    noise: float = 1.0,
) -> Recording:
    """Two joints on nine tones that come again every 10 s, with dry friction that turns at once.

    The encoder rounds to 2 pi / 65536.  The efforts are those of each instant, or `averaged` over a
    sample, and have noise.  `stribeck` is what the second joint has of it [N m].
    """
    text, rng = serial_urdf(2, ("0 1 0", "0 1 0")), np.random.default_rng(seed)
    steps = FINE_STEPS if averaged else 1
    t = (np.arange(int(seconds * fs) * steps) - steps // 2) / (fs * steps)
    w = 2 * np.pi * 0.1 * np.arange(1, 10) * np.ones((2, 1))
    q, v, a = sines(t, w, rng.uniform(0.05, 0.2, w.shape), rng.uniform(0, 2 * np.pi, w.shape))
    tau = _rnea(pin.buildModelFromXML(text), (q, v, a))
    level = np.array([0.8, 0.4]) + stribeck * np.array([0.0, 1.0]) * np.exp(-((v / 0.12) ** 2))
    tau += level * np.tanh(v / 0.003) + np.array([0.5, 0.2]) * v
    tau = tau.reshape(-1, steps, 2).mean(axis=1)
    tau += noise * np.array([0.05, 0.02]) * rng.standard_normal(tau.shape)
    step, at = 2 * np.pi / 2**16, slice(steps // 2, None, steps)
    q = np.round(q[at] / step) * step
    names, source = ("joint1", "joint2"), RobotSource("", text)
    return Recording(f"run{seed}", "arm", names, t[at], q, tau, robot=source)


_PICKUP_LINK = """
  <link name="l{k}"><inertial><origin xyz="0 0 {c}"/><mass value="{m}"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.004"/></inertial></link>
  <joint name="joint{k}" type="revolute"><parent link="l{p}"/><child link="l{k}"/>
    <origin xyz="0 0 {z}"/><axis xyz="{axis}"/>
    <limit lower="-3" upper="3" effort="200" velocity="10"/></joint>
"""
_PICKUP_ROWS = (
    (1, 0, 0.1, 4.0, 0.05, "0 0 1"),
    (2, 1, 0.2, 3.0, 0.15, "0 1 0"),
    (3, 2, 0.3, 1.5, 0.1, "0 1 0"),
)
_PICKUP = (
    '<robot name="arm"><link name="l0"/>'
    + "".join(
        _PICKUP_LINK.format(k=k, p=p, z=z, m=m, c=c, axis=a) for k, p, z, m, c, a in _PICKUP_ROWS
    )
    + '<link name="tip"/><joint name="end" type="fixed"><parent link="l3"/><child link="tip"/>'
    '<origin xyz="0 0 0.25"/></joint></robot>'
)
#: Mass [kg] and centre [m] of what `pickup` takes up, and when [s].
LOAD, LOAD_AT, INSTANT = 0.6, np.array([0.0, 0.03, 0.06]), 8.0


def pickup(
    seed: int,
    change: str = "load",
    name: str = "run",
    at: float | None = None,
    seconds: float = 20.0,
) -> Recording:
    """An arm of three joints that takes up a load, or whose second joint changes, at INSTANT."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.004)
    motion = _four_tones(rng, t, 3)
    q, v, _ = motion
    bare, loaded = pin.buildModelFromXML(_PICKUP), pin.buildModelFromXML(_PICKUP)
    tip = loaded.frames[loaded.getFrameId("tip")]
    body = pin.Inertia(LOAD, LOAD_AT, 1e-4 * np.eye(3))
    loaded.appendBodyToJoint(tip.parentJoint, body, tip.placement)
    later = t > (INSTANT if at is None else at)
    tau = _rnea(bare, motion)
    if change == "load":
        tau = np.where(later[:, None], _rnea(loaded, motion), tau)
    tau += 0.4 * np.tanh(v / 0.01) + 0.3 * v
    if change == "gain":
        tau[:, 1] *= np.where(later, 1.1, 1.0)
    if change == "offset":
        tau[:, 1] += np.where(later, 1.0, 0.0)
    tau += 0.05 * rng.standard_normal(tau.shape)
    q = q + 1e-6 * rng.standard_normal(q.shape)
    names = tuple(f"joint{k}" for k in (1, 2, 3))
    return Recording(name, "arm", names, t, q, tau, robot=RobotSource("", _PICKUP))


def double_pendulum(stribeck: float = 0.0, seed: int = 0) -> Recording:
    """A double pendulum of two uniform rods, with friction; written down by hand.

    tau_1 = (a + 2 b cos q2) a1 + (c + b cos q2) a2 - b sin q2 (2 v1 v2 + v2^2) + g terms
    """
    rng, t = np.random.default_rng(seed), np.arange(0, 40, 1 / 200.0)
    f = np.array([[0.11, 0.31, 0.77], [0.17, 0.41, 0.97]])
    q, v, a = sines(t, 2 * np.pi * f, 0.9 / (1 + 3 * f), rng.uniform(0, 6.28, (2, 3)))
    s, c = np.sin(q[:, 1]), np.cos(q[:, 1])
    both = np.cos(q.sum(axis=1))
    one = (0.9 + 0.5 * c) * a[:, 0] + (0.2 + 0.25 * c) * a[:, 1]
    one += -0.25 * s * (2 * v[:, 0] * v[:, 1] + v[:, 1] ** 2) + 12 * np.cos(q[:, 0]) + 4 * both
    two = (0.2 + 0.25 * c) * a[:, 0] + 0.2 * a[:, 1] + 0.25 * s * v[:, 0] ** 2 + 4 * both
    tau = np.stack([one, two], axis=1) + 0.4 * np.tanh(v / 0.01) + 0.3 * v
    tau[:, 1] += stribeck * np.exp(-np.abs(v[:, 1] / 0.15)) * np.tanh(v[:, 1] / 0.01)
    tau += 0.02 * rng.standard_normal(tau.shape)
    return Recording("run", "arm", ("joint1", "joint2"), t, q, tau, robot=SINGLE)


def gantry(seed: int, slow: float = 1.0) -> Recording:
    """A beam on two drives with a cart along it: what bends is the difference of the drives.

    The drives share the beam's inertia and the cart's by where the cart is.
    """
    rng, t = np.random.default_rng(seed), np.arange(6000) / 250.0
    f = slow * np.array([[0.13, 0.33, 0.61], [0.9, 1.7, 2.3], [0.11, 0.29, 0.57]])
    size = np.array([[0.2, 0.06, 0.03], [2e-4, 1e-4, 5e-5], [0.2, 0.08, 0.03]])
    paths = sines(t, 2 * np.pi * f, size, rng.uniform(0, 6.28, (3, 3)))
    # both drives go along, apart by the skew
    turn = np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    q, v, a = (x @ turn for x in paths)
    tau = np.empty_like(q)
    for j, side in ((0, -1.0), (1, 1.0)):
        share = 0.5 + side * q[:, 2]
        cart = 10.0 * ((0.5 - q[:, 2]) * a[:, 0] + (0.5 + q[:, 2]) * a[:, 1])
        tau[:, j] = 8.0 * a[:, j] + 4.0 * a[:, 1 - j] + share * cart
        tau[:, j] += 3e4 * (q[:, j] - q[:, 1 - j])
    tau[:, 2] = 10.0 * a[:, 2]
    tau += 8.0 * np.tanh(v / 0.003) + 20.0 * v + 0.4 * rng.standard_normal(q.shape)
    q += 2e-7 * rng.standard_normal(q.shape)
    joints = ("left", "right", "cart")
    return Recording(
        f"run{seed}", "gantry", joints, t, q, tau, robot=SINGLE, metadata={"unit": "m"}
    )


def _two_turn(seed: int, moved: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]):
    """Two joints without a description: what moves them, and friction."""
    rng, t = np.random.default_rng(seed), np.arange(0, 30, 1 / 200.0)
    f = np.array([[0.11, 0.31, 0.77], [0.17, 0.41, 0.97]])
    q, v, a = sines(t, 2 * np.pi * f, 0.9 / (1 + 3 * f), rng.uniform(0, 6.28, (2, 3)))
    tau = moved(q, v, a) + 0.1 * np.tanh(v / 0.01) + 0.05 * v
    tau += 0.002 * rng.standard_normal(q.shape)
    return Recording("run", "arm", ("joint1", "joint2"), t, q, tau, robot=SINGLE)


def parallelogram(seed: int) -> Recording:
    """Two motors at the base move the two links of a parallelogram.

    tau_1 = A a1 + C cos(q1 - q2) a2 + C sin(q1 - q2) v2^2, and the other way round.
    """

    def moved(q, v, a):
        apart = q[:, 0] - q[:, 1]
        tau = np.array([0.5, 0.4]) * a + 0.35 * np.cos(apart)[:, None] * a[:, ::-1]
        return tau + 0.35 * np.stack([np.sin(apart), -np.sin(apart)], axis=1) * v[:, ::-1] ** 2

    return _two_turn(seed, moved)


def turret(seed: int) -> Recording:
    """A weight on an arm that a second joint raises: A + B cos^2 q2 about the first one."""

    def moved(q, v, a):
        (_, s2), (_, c2), (v1, v2) = np.sin(q).T, np.cos(q).T, v.T
        first = (0.2 + 0.4 * c2**2) * a[:, 0] - 0.8 * s2 * c2 * v1 * v2
        return np.stack([first, 0.5 * a[:, 1] + 0.4 * s2 * c2 * v1**2], axis=1)

    return _two_turn(seed, moved)


def linkage(seed: int) -> Recording:
    """Two joints of which the first one's inertia A + B cos q1 cos q2 varies with both angles."""

    def moved(q, v, a):
        (s1, s2), (c1, c2), (v1, v2) = np.sin(q).T, np.cos(q).T, v.T
        first = (0.5 + 0.3 * c1 * c2) * a[:, 0] - 0.15 * s1 * c2 * v1**2 - 0.3 * c1 * s2 * v1 * v2
        return np.stack([first, 0.4 * a[:, 1] + 0.15 * c1 * s2 * v1**2], axis=1)

    return _two_turn(seed, moved)


def mujoco_arm(robot: str, motion: int, *hidden: dict[str, object]) -> Recording:
    """A MuJoCo arm, recorded without its description."""
    pytest.importorskip("mujoco")
    from hil.sim_devices.mujoco_plants import session

    rows = session.simulate(robot, ("wander", motion), list(hidden))
    sound = np.isfinite(rows["q"]).all(axis=1)
    t, q, tau = (rows[key][sound] for key in ("t", "q", "tau"))
    names = tuple(str(name) for name in session.robots()[robot]["joints"])
    return Recording("run", "arm", names, t, q, tau, robot=SINGLE)


def premium_terms(pi: np.ndarray, q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M (n, 3, 3) and C^T q' - N (n, 3) of a Premium 1.5, for a momentum observer.

    C^T q' = M' q' - C q' (M' = C + C^T), from the regressor of the model.
    """
    from hil.models.phantom import Premium

    arm, zero = Premium(()), np.zeros_like(q)
    rest = arm.regressor(q, zero, zero) @ pi
    columns = [arm.regressor(q, zero, np.broadcast_to(e, q.shape)) @ pi - rest for e in np.eye(3)]
    m = np.stack(columns, axis=2)
    eps = 1e-6
    ahead, behind = (
        np.stack(
            [
                arm.regressor(q + h * qd, zero, np.broadcast_to(e, q.shape)) @ pi
                - arm.regressor(q + h * qd, zero, zero) @ pi
                for e in np.eye(3)
            ],
            axis=2,
        )
        for h in (eps, -eps)
    )
    rate = np.einsum("nij,nj->ni", (ahead - behind) / (2 * eps), qd)
    coriolis = arm.regressor(q, qd, zero) @ pi - rest
    return m, rate - coriolis - rest
