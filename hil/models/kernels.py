"""Compiled states of dynamic effects, exact for inputs that are straight between samples."""

from __future__ import annotations

import numba
import numpy as np

from hil.models.motion import FloatArray


@numba.njit(cache=True)
def resonator(u: FloatArray, dt: float, frequency: float, zeta: float) -> FloatArray:
    """Second-order low-pass  y'' + 2 zeta w y' + w^2 y = w^2 u,  at rest at the start, (n,).

    With e = y - u and constant input over a step the exact solution is a rotation by
    w_d dt that shrinks by exp(-zeta w dt); the input is taken at the middle of the step.
    """
    w = 2 * np.pi * frequency
    damped = w * np.sqrt(max(1 - zeta**2, 1e-6))
    c, s = np.cos(damped * dt), np.sin(damped * dt)
    shrink = np.exp(-zeta * w * dt)
    y, v = u[0], 0.0
    out = np.empty(u.size)
    out[0] = y
    for k in range(1, u.size):
        goal = 0.5 * (u[k] + u[k - 1])
        e = y - goal
        a = (v + zeta * w * e) / damped
        e, v = (
            shrink * (e * c + a * s),
            shrink * (v * c - (zeta * w * v + w**2 * e) / damped * s),
        )
        y = goal + e
        out[k] = y
    return out


@numba.njit(cache=True)
def sprung(
    load: FloatArray, inertia: FloatArray, dt: float, stiffness: float, damping: float
) -> tuple[FloatArray, FloatArray]:
    """Effort that a spring passes to the link behind it, and how fast it is stretched, (n,) each.

    As the load is what the link would need to move with the motor, the stretch obeys

        I d'' + c d' + k d = load,    effort = k d + c d'

    from d = load / k.  Exact for an inertia that is constant over a step; the load is taken at
    the middle of the step.
    """
    effort, rate = np.empty(load.size), np.zeros(load.size)
    d, v = load[0] / stiffness, 0.0
    effort[0] = load[0]
    same, co, si, shrink, damped, decay, w = -1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0
    for n in range(1, load.size):
        if inertia[n] != same:
            same = inertia[n]
            w = np.sqrt(stiffness / same)
            decay = 0.5 * damping / same
            damped = np.sqrt(max(w * w - decay * decay, 1e-6 * w * w))
            co, si, shrink = np.cos(damped * dt), np.sin(damped * dt), np.exp(-decay * dt)
        goal = 0.5 * (load[n] + load[n - 1]) / stiffness
        e = d - goal
        a = (v + decay * e) / damped
        e, v = (
            shrink * (e * co + a * si),
            shrink * (v * co - (decay * v + w * w * e) / damped * si),
        )
        d = goal + e
        effort[n] = stiffness * d + damping * v
        rate[n] = v
    return effort, rate


@numba.njit(cache=True)
def lag(u: FloatArray, dt: float, time: float) -> FloatArray:
    """First-order low-pass  T y' + y = u,  exact for straight inputs, (n,)."""
    decay = np.exp(-dt / time)
    out = np.empty(u.size)
    out[0] = u[0]
    for k in range(1, u.size):
        slope = (u[k] - u[k - 1]) / dt
        # particular solution u - T slope, homogeneous part decays
        e = out[k - 1] - (u[k - 1] - time * slope)
        out[k] = u[k] - time * slope + e * decay
    return out


def delayed(u: FloatArray, samples: float) -> FloatArray:
    """u(t - samples dt) by the cubic through the four instants around it, (n,).

    The first value stands for what was before the recording.
    """
    whole = int(np.floor(samples))
    f = samples - whole
    # Lagrange's weights at -1, 0, 1, 2 instants back from the whole delay
    taps = (
        -f * (f - 1) * (f - 2) / 6,
        (f + 1) * (f - 1) * (f - 2) / 2,
        -(f + 1) * f * (f - 2) / 2,
        (f + 1) * f * (f - 1) / 6,
    )
    wide = np.concatenate([np.full(whole + 2, u[0]), u, u[-1:]])
    at = np.arange(u.size) + 2
    out = sum(c * wide[at - k] for c, k in zip(taps, (-1, 0, 1, 2), strict=True))
    return np.asarray(out, dtype=np.float64)


@numba.njit(cache=True)
def play(
    load: FloatArray, speed: FloatArray, inertia: FloatArray, dt: float, width: float,
    friction: float, slow: float,
) -> FloatArray:  # fmt: skip
    """Effort that passes a play of this width instead of `load`, (n,).

    The link lies r in [0, width] ahead of the motor's driving flank. With its own friction its
    load is L = load + F tanh(v / v0). At r = 0 it is pushed (L > 0), at r = width pulled back
    (L < 0). Between, nothing passes and, as the load is what the link would need to move with the
    motor,

        r'' = -(load + F tanh((v + r') / v0)) / I.

    It meets a flank without bouncing; its momentum I r' passes within that instant.
    """
    out = np.zeros(load.size)
    r, w = (0.0 if load[0] > 0 else width), 0.0
    for k in range(load.size):
        own = load[k]
        if friction > 0.0:
            own += friction * np.tanh(speed[k] / slow)
        if (r <= 0.0 and own >= 0.0) or (r >= width and own <= 0.0):
            out[k] = own
            continue
        if friction > 0.0:
            own = load[k] + friction * np.tanh((speed[k] + w) / slow)
        w -= own / inertia[k] * dt
        r += w * dt
        if r <= 0.0 or r >= width:
            out[k] = -inertia[k] * w / dt
            r, w = (0.0 if r <= 0.0 else width), 0.0
    return out


@numba.njit(cache=True)
def eccentric(
    sin: FloatArray, cos: FloatArray, k: float, speed: FloatArray, acceleration: FloatArray,
    inertia: FloatArray, stiffness: FloatArray, damping: float, j: int, out: FloatArray,
) -> None:  # fmt: skip
    """Effort -(M e'' + D e' + G e) of errors e = sin kq and e = cos kq of joint j, to (n, d, 2).

    (sin kq)'' = k cos kq q'' - k^2 sin kq q'^2;  M and G (n, d) are the columns of joint j.
    """
    for i in range(sin.size):
        s, c, v, a = sin[i], cos[i], speed[i], acceleration[i]
        along = k * c * a - k**2 * s * (v * v)
        across = -k * s * a - k**2 * c * (v * v)
        for r in range(inertia.shape[1]):
            one = inertia[i, r] * along + stiffness[i, r] * s
            two = inertia[i, r] * across + stiffness[i, r] * c
            if r == j:
                one += damping * (k * c * v)
                two += damping * (-k * s * v)
            out[i, r, 0], out[i, r, 1] = -one, -two
