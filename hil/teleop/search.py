"""One problem on grids of frequencies: sensitivity and constraints of scaled parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.teleop import hybrid, passivity
from hil.teleop.design import Design, Term
from hil.teleop.hybrid import FloatArray
from hil.teleop.problem import ORDER, Problem
from hil.teleop.summary import band, tracking, weighted

#: Re z_t kept [N s/m], for what lies between the frequencies of the search.
MARGIN = 0.03
#: Frequencies of the last look [rad/s].
FINE: FloatArray = np.geomspace(0.1, 1000.0, 600)


class Search:
    """Grids and bounds of one problem; x = theta / bounds in [0, 1]."""

    def __init__(self, p: Problem) -> None:
        self.p, self.top = p, p.bounds()
        self.w, self.slow = band()[::3], 2 * np.pi * np.geomspace(0.05, 1.0, 8)
        self.watch(np.geomspace(0.1, 1000.0, 60))

    def watch(self, wide: FloatArray) -> None:
        """Frequencies at which stability is demanded [rad/s]."""
        self.wide, p = wide, self.p
        self.s = hybrid.jw(np.concatenate([self.w, self.slow, self.wide]))
        self.ends = np.cumsum([self.w.size, self.slow.size])
        self.largest = np.abs(p.largest(hybrid.jw(self.wide)))

    def design(self, x: FloatArray) -> Design:
        """Controller of scaled parameters."""
        t, c = x * self.top, self.p.corner
        v = dict(zip(ORDER, t.tolist(), strict=True))
        one = Term(c, 1.0)
        return Design(
            c1=one * v["c1"], c4=one * -v["c4"], c7=one * v["c7"], c8=one * v["c8"],
            c2=v["c2"], c3=v["c3"], c5=v["c5"], c6=v["c6"],
            master=self.p.master, slave=self.p.slave, name="optimised",
        )  # fmt: skip

    def refine(self, x: FloatArray) -> bool:
        """Whether stability fails between the frequencies; those where it does are added."""
        with np.errstate(all="ignore"):  # a design without a matrix is refused later
            h = hybrid.hybrid(self.design(x), hybrid.jw(FINE), self.p.real)
            least = passivity.half_disc(h, np.abs(self.p.largest(hybrid.jw(FINE))))
        bad = FINE[(least < 0.0) & np.isfinite(least)]
        new = bad[:: max(1, bad.size // 6)]
        if new.size:
            self.watch(np.unique(np.concatenate([self.wide, new])))
        return bool(new.size)

    def sensitivity(self, x: FloatArray) -> float:
        """sigma_c."""
        h = hybrid.hybrid(self.design(x), hybrid.jw(self.w), self.p.real)
        ze = self.p.environment(hybrid.jw(self.w))
        return weighted(hybrid.sensitivity(h, ze), self.w)

    def constraints(self, x: FloatArray) -> dict[str, FloatArray]:
        """Slacks, positive = met, each scaled to about 1."""
        p, d = self.p, self.design(x)
        h = hybrid.hybrid(d, self.s, p.real)
        slow, wide = h[self.ends[0] : self.ends[1]], h[self.ends[1] :]
        touch = tracking(slow, p.environment(hybrid.jw(self.slow)), 1.0)
        least = passivity.half_disc(wide, self.largest)
        chi = hybrid.characteristic(d, p.operator, p.environment, replace(p.real, forward_s=0.0,
                                    backward_s=0.0))  # fmt: skip
        pole = float(np.roots(chi.num).real.max())
        q = {} if np.isinf(p.kappa) else {"fsf": np.array([1 - _size(d, p.kappa)])}
        return {
            "free tracking": 1 - tracking(slow, 0.0, 1.0) / p.free,
            "contact tracking": 1 - touch / p.contact,
            "stability": (np.maximum(least, -20.0) - MARGIN) / 10.0,
            "poles": np.array([-(pole + 0.5) / 10.0]),
            **q,
        }  # fmt: skip

    def flat(self, x: FloatArray) -> FloatArray:
        """All slacks in one row."""
        return np.concatenate(list(self.constraints(x).values()))

    def worst(self, x: FloatArray) -> tuple[str, float]:
        """Constraint that is nearest to failing, or fails most, and its slack."""
        with np.errstate(all="ignore"):  # as in `refine`
            slack = {n: float(v.min()) for n, v in self.constraints(x).items()}
        name = min(slack, key=lambda n: slack[n])
        return name, slack[name]


def _size(d: Design, limit: float) -> float:
    """(kappa + 1/kappa) / (limit + 1/limit): smooth, above 1 too close to the singularity."""
    a = np.array([[1 + d.c6, d.c2], [d.c3, 1 + d.c5]])
    size = float((a**2).sum()) / max(float(np.linalg.det(a)), 1e-6)
    return size / (limit + 1 / limit)
