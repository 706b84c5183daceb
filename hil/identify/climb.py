"""Maximum of a smooth function between three points, by few evaluations."""

from __future__ import annotations

from collections.abc import Callable

#: Share of the larger side that a golden step takes, and the closest step to a known point.
GOLDEN, CLOSEST = 0.381966, 0.01
MOST = 12
Function = Callable[[float], float]


def climb(f: Function, points: tuple[float, float, float], tolerance: float) -> tuple[float, float]:
    """Place and value of a maximum of f on [a, c], found from a, b and c.

    Parabolas through the best three points, golden sections where they lead nowhere or close in
    from one side only; at most twelve evaluations besides the three.

    Parameters
    ----------
    f : callable
        The function; evaluated at the same points again, so it should remember.
    points : tuple of float
        a <= b <= c; b may be one of the ends.
    tolerance : float
        Rise that is none: the search ends where a parabola promises no more.
    """
    a, b, c = points
    if b in (a, c):
        found = _inside(f, b, c if b == a else a)
        if found is None:
            return b, f(b)
        a, b, c = found
    width = 2 * (c - a)
    for _ in range(MOST):
        x, promise = _vertex(f, a, b, c)
        if promise < tolerance:
            break
        x = _apart(a, b, c, x) if c - a < 0.7 * width else _golden(a, b, c)
        width = c - a
        if f(x) > f(b):
            a, b, c = (b, x, c) if x > b else (a, x, b)
        elif x > b:
            c = x
        else:
            a = x
    return b, f(b)


def _vertex(f: Function, a: float, b: float, c: float) -> tuple[float, float]:
    """Vertex of the parabola through three points and its height over f(b)."""
    # f(x) = f(b) + s (x - b) + k (x - b)^2
    left, right = (f(a) - f(b)) / (a - b), (f(c) - f(b)) / (c - b)
    k = (right - left) / (c - a)
    if k >= 0.0:
        return b, 0.0
    s = left - k * (a - b)
    return b - s / (2 * k), -s * s / (4 * k)


def _apart(a: float, b: float, c: float, x: float) -> float:
    """Next point: x, but within the bracket and not on top of b."""
    near = CLOSEST * (c - a)
    if abs(x - b) <= near:  # a point close by closes the bracket from the longer side
        return b + near if c - b > b - a else b - near
    if a + near < x < c - near:
        return x
    return _golden(a, b, c)


def _golden(a: float, b: float, c: float) -> float:
    return b + GOLDEN * (c - b) if c - b > b - a else b - GOLDEN * (b - a)


def _inside(f: Function, end: float, far: float) -> tuple[float, float, float] | None:
    """Bracket with its largest value inside, next to an end; None where f falls from the end."""
    x = end + GOLDEN * (far - end)
    for _ in range(3):
        low, high = sorted((end, far))
        if f(x) > f(end):
            return low, x, high
        top, _ = _vertex(f, low, x, high)
        if not min(end, x) < top < max(end, x):
            return None
        far, x = x, top
    return None
