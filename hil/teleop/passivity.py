"""Passivity, absolute stability, and stability for a bounded set of environments.

For a two-port with hybrid matrix H and inputs (v_m, f_s), outputs (f_m, -v_s), the power into
it is the product of both.  All functions take H on the imaginary axis, (n, 2, 2), and return
one margin per frequency: positive is safe.  They presuppose poles in the left half plane.

The bounded-environment test is exact for linear operators and environments: stable for every
passive operator and every z_e of the set if and only if one pair is stable and Re z_t >= 0 for
all of them (idea: Haddadi & Hashtrudi-Zaad, IEEE Trans. Haptics 3(1), 2010, abstract; the
formulas are derived, theory section 8.3).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.teleop.hybrid import ComplexArray, FloatArray, transmitted


def is_passive(h: ComplexArray) -> FloatArray:
    """Smallest eigenvalue of H + H*, after scaling both ports alike, (n,).

    Passive where it is not negative (Raisbeck's criterion in hybrid form).  Ports have unlike
    units; scaling v_m by g and f_s by 1 / g, g = (|h22| / |h11|)^(1/4), does not change the sign.
    """
    g = ((np.abs(h[:, 1, 1]) + 1e-300) / (np.abs(h[:, 0, 0]) + 1e-300)) ** 0.25
    scale = np.stack([g, 1.0 / g], -1)
    scaled = h * scale[:, :, None] * scale[:, None, :]
    values = np.linalg.eigvalsh(scaled + np.conj(np.swapaxes(scaled, 1, 2)))
    return np.asarray(values[:, 0], np.float64)


def llewellyn(h: ComplexArray) -> FloatArray:
    """Margin of absolute stability, relative to its own terms, (n,).

    2 Re h11 Re h22 - Re(h12 h21) - |h12 h21| >= 0 with Re h11 >= 0, Re h22 >= 0: stable for every
    passive operator and environment.  Where a real part is negative the margin is too.
    """
    r11, r22 = h[:, 0, 0].real, h[:, 1, 1].real
    p = h[:, 0, 1] * h[:, 1, 0]
    value = 2 * r11 * r22 - p.real - np.abs(p)
    size = 2 * np.abs(r11 * r22) + 2 * np.abs(p) + 1e-300
    worst = np.minimum(r11 / (np.abs(h[:, 0, 0]) + 1e-300), r22 / (np.abs(h[:, 1, 1]) + 1e-300))
    out: FloatArray = np.where(worst < 0.0, np.minimum(worst, value / size), value / size)
    return out


def disc(h: ComplexArray, centre: Any, radius: Any) -> FloatArray:
    """Smallest Re z_t [N s/m] over the environments |z_e - centre| <= radius, exact, (n,).

    u = 1 + h22 z0, den = |u|^2 - |h22|^2 r^2 > 0: the disc maps to a disc with centre
    h11 - h12 h21/h22 + (h12 h21/h22) conj(u)/den and radius |h12 h21| r/den; for den <= 0 it
    holds a pole of z_t, and the margin is minus infinity.

    Parameters
    ----------
    centre, radius : complex and float, or arrays (n,)
        Disc of environments [N s/m].
    """
    h22, p = h[:, 1, 1], h[:, 0, 1] * h[:, 1, 0]
    u = 1 + h22 * centre
    den = np.abs(u) ** 2 - np.abs(h22) ** 2 * radius**2
    safe = np.where(den > 0, den, 1.0)
    # z_t = h11 - p z/(1 + h22 z);  with w = 1 + h22 z, z/w = (z0 conj(u) - conj(h22) r^2)/den
    # at the centre: no division by h22, which may vanish
    middle = h[:, 0, 0] - p * (centre * np.conj(u) - np.conj(h22) * radius**2) / safe
    worst = middle.real - np.abs(p) * radius / safe
    return np.where(den > 0, worst, -np.inf)


def half_disc(h: ComplexArray, largest: Any) -> FloatArray:
    """Smallest Re z_t [N s/m] over passive environments with |z_e| <= largest, exact, (n,).

    By the maximum principle only the boundary counts: the segment j y and the arc.  With
    z_t = h11 - p w, p = h12 h21, u = 1/w = h22 + 1/z_e both are circles in w; on each the point
    with the largest Re(p w) counts if it lies on the boundary, and so do the corners.  The
    result is minus infinity where a pole of z_t lies inside.

    Parameters
    ----------
    largest : float or ndarray (n,)
        Size of the half disc [N s/m].
    """
    size = np.broadcast_to(np.asarray(largest, float), (len(h),))
    h22, p = h[:, 1, 1], h[:, 0, 1] * h[:, 1, 0]
    turn = np.where(np.abs(p) > 0, np.conj(p) / np.maximum(np.abs(p), 1e-300), 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):  # points at infinity are left out below
        # segment: Re u = Re h22, so w = (1 + sgn(a) turn) / (2 a) at the extreme
        a = h22.real
        u = 2 * a / (1 + np.where(a < 0, -1.0, 1.0) * turn)
        y = 1.0 / (h22.imag - u.imag)
        # arc: |u - h22| = 1/size, so w = (conj(h22) + sgn(e) turn / size) / e at the extreme
        e = np.abs(h22) ** 2 - size**-2.0
        u = e / (np.conj(h22) + np.where(e < 0, -1.0, 1.0) * turn / size)
        z = 1.0 / (u - h22)
        pole = -1.0 / h22
    on_segment = np.isfinite(y) & (np.abs(y) <= size)
    on_arc = np.isfinite(z) & (z.real >= 0)
    corner = 1j * size
    points = [np.where(on_segment, 1j * y, 0.0), np.where(on_arc, z, size), corner, -corner]
    values = np.stack([transmitted(h, x).real for x in points])
    inside = (pole.real >= 0) & (np.abs(pole) <= size)
    return np.where(inside, -np.inf, values.min(axis=0))


def scattering(h: ComplexArray, b: float) -> ComplexArray:
    """Scattering matrix S (n, 2, 2) with reference impedance b [N s/m]."""
    h11, h12, h21, h22 = h[:, 0, 0], h[:, 0, 1], h[:, 1, 0], h[:, 1, 1]
    den = (h11 + b) * (1 + b * h22) - b * h12 * h21
    s11 = ((h11 - b) * (1 + b * h22) - b * h12 * h21) / den
    s22 = ((h11 + b) * (1 - b * h22) + b * h12 * h21) / den
    return np.stack(
        [np.stack([s11, 2 * b * h12 / den], -1), np.stack([-2 * b * h21 / den, s22], -1)], -2
    )


def mu(h: ComplexArray, b: float) -> FloatArray:
    """Radius in the reflection plane of the environments that are stable for sure, (n,).

    mu = (1 - |S11|^2) / (|S22 - det S conj(S11)| + |S12 S21|): every |G_e| <= rho is admissible
    if and only if mu >= rho; mu >= 1 is absolute stability.
    """
    s = scattering(h, b)
    s11, s22, p = s[:, 0, 0], s[:, 1, 1], s[:, 0, 1] * s[:, 1, 0]
    det = s11 * s22 - p
    below = np.abs(s22 - det * np.conj(s11)) + np.abs(p)
    out: FloatArray = (1 - np.abs(s11) ** 2) / np.maximum(below, 1e-300)
    return out


def stability_circle(h: ComplexArray, b: float) -> tuple[ComplexArray, FloatArray, FloatArray]:
    """Circle |G_t| = 1 in the plane of the environment's reflection G_e.

    Returns
    -------
    centre : ndarray (n,) complex
        conj(S22 - det S conj(S11)) / (|S22|^2 - |det S|^2).
    radius : ndarray (n,)
        |S12 S21| / abs(|S22|^2 - |det S|^2).
    outside : ndarray (n,) of 0 or 1
        1 where the stable environments lie outside the circle.
    """
    s = scattering(h, b)
    s11, s22, p = s[:, 0, 0], s[:, 1, 1], s[:, 0, 1] * s[:, 1, 0]
    det = s11 * s22 - p
    below = np.abs(s22) ** 2 - np.abs(det) ** 2
    centre = np.conj(s22 - det * np.conj(s11)) / below
    radius = np.abs(p) / np.abs(below)
    # G_e = 0 is stable if |S11| < 1, and lies inside the circle if |centre| < radius
    outside = (np.abs(s11) < 1) != (np.abs(centre) < radius)
    return centre, radius, outside.astype(float)


def admissible(h: ComplexArray, b: float, centre: complex, rho: float) -> FloatArray:
    """Distance of the disc |G_e - centre| <= rho from the stability circle, (n,).

    Not negative if and only if every environment in the disc is stable.
    """
    c, radius, outside = stability_circle(h, b)
    gap = np.abs(centre - c)
    return np.where(outside > 0, gap - rho - radius, radius - gap - rho)
