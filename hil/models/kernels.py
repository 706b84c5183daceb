"""Compiled states of dynamic effects, exact for inputs that are straight between samples."""

from __future__ import annotations

import numba
import numpy as np

from hil.models.motion import FloatArray

#: Least part of its stiffness that a weight which tips over leaves of a spring.
LEAST_PART = 0.1
#: Displacements at which elements of a hysteresis slip, as shares of the range.
SLIPS = (0.001, 0.003, 0.01, 0.03)
#: Weights of the differences over 1 to 4 samples on either side, by how many there are (Fornberg,
#: Mathematics of Computation 51, 1988, table 1).  Of a wave of w rad a sample four of them miss
#: w^8 / 630 of its slope, a single one w^2 / 6: at the fifth of the rate up to which efforts are
#: used 1 % and 26 %.
DIFFERENCES = np.array(
    [
        [1 / 2, 0.0, 0.0, 0.0],
        [2 / 3, -1 / 12, 0.0, 0.0],
        [3 / 4, -3 / 20, 1 / 60, 0.0],
        [4 / 5, -1 / 5, 4 / 105, -1 / 280],
    ]
)


@numba.njit(cache=True, nogil=True)
def slope(x: FloatArray, rate: float) -> FloatArray:
    """Time derivative (n,) of an evenly sampled signal (n,), by differences of eighth order.

    Fewer samples are taken at its ends, at the very ends one on the one side.
    """
    out, last = np.empty(x.size), x.size - 1
    for i in range(x.size):
        reach = min(i, last - i, len(DIFFERENCES))
        total = 0.0
        for k in range(reach):
            total += DIFFERENCES[reach - 1, k] * (x[i + k + 1] - x[i - k - 1])
        out[i] = total * rate
    out[0], out[last] = (x[1] - x[0]) * rate, (x[last] - x[last - 1]) * rate
    return out


@numba.njit(cache=True, nogil=True)
def sprung(
    load: FloatArray,
    inertia: FloatArray,
    weight: FloatArray,
    dt: float,
    stiffness: float,
    zeta: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Effort that a spring passes to the link behind it, its stretch and its rate, (n,) each.

    As the load is what the link would need to move with the motor, the stretch obeys

        (I d')' + c d' + (k + G) d = load,    effort = k d + c d',    c = 2 zeta sqrt(k I)

    with G = `weight`, by which the load grows with the link's position: a pendulum behind a spring
    swings faster than the spring alone lets it.  Other joints change I, and a joint's own position
    does not.  Exact for an inertia and a weight that are constant over a step, between which I d'
    stays; the load is taken at the middle of the step.
    A recording begins somewhere within a motion: the state at its start is the one from which the
    effort swings least about the load, which is what is left once the start is forgotten.
    """
    out = np.empty((3, load.size))
    free, other = np.empty((3, load.size)), np.empty((3, load.size))
    none = np.zeros(load.size)
    _swung(load, inertia, weight, dt, stiffness, zeta, load[0] / stiffness, 0.0, out)
    _swung(none, inertia, weight, dt, stiffness, zeta, 1.0, 0.0, free)
    fast = np.sqrt(stiffness / inertia[0])
    _swung(none, inertia, weight, dt, stiffness, zeta, 0.0, fast, other)
    aa = ab = bb = ay = by = 0.0
    for n in range(load.size):
        y = load[n] - out[0, n]
        aa += free[0, n] * free[0, n]
        ab += free[0, n] * other[0, n]
        bb += other[0, n] * other[0, n]
        ay += free[0, n] * y
        by += other[0, n] * y
    size = aa * bb - ab * ab
    if size > 1e-6 * aa * bb:
        x, y = (ay * bb - by * ab) / size, (by * aa - ay * ab) / size
        out += x * free + y * other
    return out[0], out[1], out[2]


@numba.njit(cache=True, nogil=True)
def _swung(
    load: FloatArray,
    inertia: FloatArray,
    weight: FloatArray,
    dt: float,
    stiffness: float,
    zeta: float,
    d: float,
    v: float,
    out: FloatArray,
) -> None:
    """Effort, stretch and rate of `sprung` from a stretch d and a rate v, to out (3, n)."""
    same, hung, co, si, shrink, damped = 0.0, 0.0, 1.0, 0.0, 1.0, 1.0
    decay, w, damping, whole = 0.0, 1.0, 0.0, stiffness
    for n in range(load.size):
        if inertia[n] != same or weight[n] != hung:
            if n:
                v *= same / inertia[n]
            same, hung = inertia[n], weight[n]
            whole = max(stiffness + hung, LEAST_PART * stiffness)
            w, decay = np.sqrt(whole / same), zeta * np.sqrt(stiffness / same)
            damping = 2.0 * same * decay
            damped = np.sqrt(max(w * w - decay * decay, 1e-6 * w * w))
            co, si, shrink = np.cos(damped * dt), np.sin(damped * dt), np.exp(-decay * dt)
        if n:
            goal = 0.5 * (load[n] + load[n - 1]) / whole
            e = d - goal
            a = (v + decay * e) / damped
            e, v = (
                shrink * (e * co + a * si),
                shrink * (v * co - (decay * v + w * w * e) / damped * si),
            )
            d = goal + e
        out[0, n], out[1, n], out[2, n] = stiffness * d + damping * v, d, v


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def softened(
    load: FloatArray,
    speed: FloatArray,
    inertia: FloatArray,
    weight: FloatArray,
    dt: float,
    stretch: float,
    tension: float,
    lag: FloatArray,
    friction: float,
    slow: float,
    parts: int,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Effort that a cable passes which is soft about zero tension, instead of `load`, (n,).

    Besides it, the stretch d and its derivatives d' and d'', (n,) each.

    As in `sprung`, but with a stretch d that does not grow with the tension T for ever, and a
    damping that grows as the stiffness does (a loss within the cable):

        (I d')' + G d + P = L,    P = T + c T',    d = s T / (T0 + |T|),
        L = load + F sat((v - d') / v0)

    with G = `weight`, s = `stretch`, T0 = `tension`, c = `lag` and sat x = min(max(x, -1), 1).
    Each sample is gone in `parts` steps h of the backward formula x' = (x - e) / g,
    e = (4 x_1 - x_2) / 3, g = 2 h / 3, which is of second order and lets no step bounce off a
    stiffness that it does not resolve:

        d + w T = r,    w = g (g + c) / I',    r = (e_d + g e_v) I / I' + g (g L + c e_T) / I'

    with I' = I + g^2 G, a quadratic equation in T; between two samples I d' stays.  What is passed
    at a sample is L - (I d')' - G d with d' from the sample before to the one after it, so that no
    blow between two of them is lost.
    """
    out, rates, second = np.empty(load.size), np.zeros(load.size), np.zeros(load.size)
    stretched = np.empty(load.size)
    own = out[0] = load[0]
    t, v = load[0], 0.0
    d = stretch * t / (tension + abs(t))
    t_past, v_past, d_past, stretched[0] = t, v, d, d
    g, step, third = 2.0 * dt / (3.0 * parts), 1.0 / parts, 1.0 / 3.0
    rate, sharp = 1.0 / g, 1.0 / slow
    for n in range(1, load.size):
        turn, whole = inertia[n - 1] / inertia[n], inertia[n] + g * g * weight[n]
        whole = max(whole, LEAST_PART * inertia[n])
        per, share = g / whole, inertia[n] / whole
        v, v_past = v * turn, v_past * turn
        w, rise, pull = per * (g + lag[n]), (load[n] - load[n - 1]) * step, load[n - 1]
        for _ in range(parts):
            pull += rise
            own = pull
            if friction > 0.0:
                own += friction * min(max((speed[n] - v) * sharp, -1.0), 1.0)
            before, start = (4.0 * t - t_past) * third, (4.0 * d - d_past) * third
            r = share * (start + g * third * (4.0 * v - v_past))
            r += per * (g * own + lag[n] * before)
            # w T^2 + (w T0 + s - |r|) |T| = |r| T0, by the form that does not cancel
            size = abs(r)
            b = w * tension + stretch - size
            root = np.sqrt(b * b + 4.0 * w * size * tension)
            size = 2.0 * size * tension / (b + root) if b > 0.0 else 0.5 * (root - b) / w
            t_past, v_past, d_past = t, v, d
            t = size if r >= 0.0 else -size
            d = r - w * t
            v = (d - start) * rate
        out[n], rates[n], stretched[n] = own, v, d
    for n in range(1, load.size - 1):
        second[n] = (rates[n + 1] - rates[n - 1]) / (2.0 * dt)
        out[n] -= (inertia[n + 1] * rates[n + 1] - inertia[n - 1] * rates[n - 1]) / (2.0 * dt)
        out[n] -= weight[n] * stretched[n]
    return out, stretched, rates, second


@numba.njit(cache=True, nogil=True)
def eccentric(
    sin: FloatArray,
    cos: FloatArray,
    k: float,
    speed: FloatArray,
    acceleration: FloatArray,
    inertia: FloatArray,
    stiffness: FloatArray,
    damping: float,
    j: int,
    out: FloatArray,
) -> None:
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


@numba.njit(cache=True, nogil=True)
def dahl_state(q: FloatArray, scale: float) -> FloatArray:
    """Dahl's state for a measured position, exact between samples.

    dz/dq = (1 - z sgn v) / s   =>   z <- sgn + (z - sgn) exp(-|dq| / s)

    Parameters
    ----------
    q : ndarray (n,)
        Position [rad or m].
    scale : float
        Presliding displacement s [rad or m].

    Returns
    -------
    ndarray (n,)
        State in [-1, 1]; friction is fc z.
    """
    z = np.zeros(q.size)
    for k in range(1, q.size):
        step = q[k] - q[k - 1]
        goal = 1.0 if step > 0 else -1.0
        z[k] = goal + (z[k - 1] - goal) * np.exp(-abs(step) / scale)
    return z


@numba.njit(cache=True, nogil=True)
def slip_state(q: FloatArray, scale: float) -> FloatArray:
    """State of a Maxwell-slip element: a spring that slips at the displacement `scale`.

    z <- clip(z + dq / s, -1, 1)

    Parameters
    ----------
    q : ndarray (n,)
        Position [rad or m].
    scale : float
        Displacement s at which it slips [rad or m].

    Returns
    -------
    ndarray (n,)
        State in [-1, 1]; friction is fc z.
    """
    z = np.zeros(q.size)
    for k in range(1, q.size):
        z[k] = min(max(z[k - 1] + (q[k] - q[k - 1]) / scale, -1.0), 1.0)
    return z


@numba.njit(cache=True, nogil=True)
def lugre_state(q: FloatArray, level: FloatArray, scale: float) -> FloatArray:
    """LuGre's bristles for a measured position, exact for a level that is constant over a step.

    dz/dt = v / s - |v| / s z / g(v)   =>   z <- g sgn + (z - g sgn) exp(-|dq| / (s g))

    Parameters
    ----------
    q : ndarray (n,)
        Position [rad or m].
    level : ndarray (n,)
        g(v) > 0, in units of the Coulomb friction.
    scale : float
        Displacement s = Fc / sigma_0 [rad or m].

    Returns
    -------
    ndarray (n,)
        Deflection in units of s, within -g..g; friction is Fc z.
    """
    z = np.zeros(q.size)
    for k in range(1, q.size):
        step = q[k] - q[k - 1]
        g = 0.5 * (level[k] + level[k - 1])
        goal = g if step > 0 else -g
        z[k] = goal + (z[k - 1] - goal) * np.exp(-abs(step) / (scale * g))
    return z
