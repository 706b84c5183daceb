"""Figures of a run as data and as Markdown, which is also what the terminal shows.

Shares with their intervals, power, calibration, classes of failure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import sqrt
from statistics import median
from typing import Any

import numpy as np

CaseRow = dict[str, Any]
#: An effect that leaves less than this [floors] need not be named.
_ENOUGH = 0.5
#: Edges of the bins of confidence.
_BINS = (0.0, 0.6, 0.75, 0.85, 0.95, 0.99, 1.0)
#: Pairs whose columns are the same in such sessions: friction that differs by direction is a
#: constant while it slips, and from the motor's side alone a link on a cable is a mass on a spring.
_ALIKE = (
    {"torque-offset", "asymmetric-coulomb"},
    {"vibration-mode", "elastic-transmission"},
)
#: What a plant can hide that has no name of its own -> names that are right for it.  Seen from the
#: motor, a harmonic drive is a soft shaft and a wave over position, a belt that jumps a tooth is an
#: encoder that lost counts.
_ACCEPTED = {
    "harmonic-drive": {
        "elastic-transmission",
        "hardening-cable",
        "encoder-eccentricity",
        "cogging",
        "vibration-mode",
    },
    "belt-skip": {"missed-counts"},
    # by the angle that the cable is never without
    "capstan-friction": {"capstan-friction", "load-friction"},
}


@dataclass(frozen=True)
class Proportion:
    """k of n, with its 95 % interval."""

    k: int
    n: int

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson score interval at 95 % (Wilson 1927)."""
        if not self.n:
            return 0.0, 1.0
        z, p, n = 1.96, self.k / self.n, self.n
        # (p + z^2/2n +- z sqrt(p (1-p)/n + z^2/4n^2)) / (1 + z^2/n)
        middle, half = p + z * z / (2 * n), z * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        # of none or all, rounding would leave the range by its last digit
        low, high = ((middle + side * half) / (1 + z * z / n) for side in (-1, 1))
        return max(low, 0.0), min(high, 1.0)

    def __str__(self) -> str:
        """E.g. ``97.1 % (66/68, 90..99)``."""
        if not self.n:
            return "-"
        low, high = self.interval
        return (
            f"{100 * self.k / self.n:.1f} % ({self.k}/{self.n}, {100 * low:.0f}..{100 * high:.0f})"
        )


def difference(both: int, lost: int, gained: int, neither: int) -> tuple[float, float]:
    """Interval at 95 % of a share after less the share before, in the same sessions.

    Newcombe, Statist. Med. 17:2635, 1998, method 10: Wilson intervals of the two shares, and how
    they go together.

    Parameters
    ----------
    both, lost, gained, neither : int
        Sessions that are right before and after, before alone, after alone, never.
    """
    n = both + lost + gained + neither
    before, after = Proportion(both + lost, n), Proportion(both + gained, n)
    if not n:
        return -1.0, 1.0
    (low_b, high_b), (low_a, high_a) = before.interval, after.interval
    p, q = before.k / n, after.k / n
    whole = before.k * (n - before.k) * after.k * (n - after.k)
    cross = float(both * neither - lost * gained)
    cross = max(cross - n / 2, 0.0) if cross > 0 else cross
    phi = cross / sqrt(whole) if whole else 0.0

    def apart(x: float, y: float) -> float:
        return sqrt(max(x * x - 2 * phi * x * y + y * y, 0.0))

    return q - p - apart(q - low_a, high_b - p), q - p + apart(p - low_b, high_a - q)


def _share_of(rows: Iterable[CaseRow], hit: Callable[[CaseRow], bool]) -> Proportion:
    """Share of `rows` for which `hit` holds."""
    found = [hit(r) for r in rows]
    return Proportion(sum(found), len(found))


def of(rows: list[CaseRow], kind: str) -> list[CaseRow]:
    """Rows of a kind whose session was stable and whose diagnosis came to an end."""
    return [r for r in rows if r["kind"] == kind and r["outcome"] not in ("unstable", "crashed")]


def _enough(row: CaseRow) -> bool:
    """Whether the effect leaves at least half a floor in this very session."""
    return bool(row["excess"] >= _ENOUGH)


def _ended(*outcomes: str) -> Callable[[CaseRow], bool]:
    """Test of the outcome."""
    return lambda row: row["outcome"] in outcomes


def headline(rows: list[CaseRow]) -> dict[str, Proportion]:
    """The shares that the project states."""
    one, none, outside, two = (of(rows, k) for k in ("one", "none", "outside", "two"))
    visible = [r for r in one if _enough(r)]
    below = [r for r in one if not _enough(r)]
    true_outside = [r for r in outside if r["hidden"][0][0].startswith("outside-")]
    return {
        "right, excess of half a floor or more": _share_of(visible, _ended("right")),
        "... or undecided between two that are alike in such data": _share_of(visible, _rightly),
        "... or ambiguous with the truth in the set": _share_of(
            visible, _ended("right", "ambiguous")
        ),
        "... the truth and something else": _share_of(visible, _ended("extra")),
        "... another name": _share_of(visible, _ended("wrong")),
        "... no name": _share_of(visible, _ended("missed", "unexplained", "not-identifiable")),
        "below half a floor: another name": _share_of(below, _ended("wrong", "extra")),
        "false alarm with nothing hidden (a name)": _share_of(none, lambda r: bool(r["named"])),
        "... 'unexplained' with nothing hidden": _share_of(none, _ended("unexplained")),
        "outside kinds not misnamed": _share_of(true_outside, lambda r: not r["named"]),
        "... misnamed without doubt": _share_of(true_outside, _is_sure),
        "... 'unexplained', excess of half a floor or more": _share_of(
            [r for r in true_outside if _enough(r)], lambda r: r["verdict"] == "unexplained"
        ),
        "not in the catalogue yet, not misnamed": _share_of(
            [r for r in outside if r not in true_outside], lambda r: not r["named"]
        ),
        "both of two found": _share_of(two, _ended("right", "ambiguous", "extra")),
        "... exactly both": _share_of(two, _ended("right")),
    }


def accepted(effect: str) -> set[str]:
    """Names that are right for a hidden effect."""
    return _ACCEPTED.get(effect, {effect})


def _rightly(row: CaseRow) -> bool:
    """Whether it is right, or leaves open what nobody could say (see `_ALIKE`)."""
    if row["outcome"] != "ambiguous":
        return bool(row["outcome"] == "right")
    sets = [{f["effect"], *f["rivals"]} for f in row["named"] if f["rivals"]]
    return any(pair <= said for said in sets for pair in _ALIKE)


def _is_sure(row: CaseRow) -> bool:
    """Whether a name was given as if there were no doubt."""
    return bool(row["verdict"] == "missing-effect" and row["named"])


def _answer(row: CaseRow) -> str:
    """What was said, in short: the first name, or the verdict."""
    if not row["named"]:
        return str(row["verdict"] or row["outcome"])
    first = str(row["named"][0]["effect"])
    return f"ambiguous:{first}" if row["verdict"] == "ambiguous" else first


def confusion(rows: list[CaseRow]) -> dict[str, Counter[str]]:
    """Hidden effect -> what was named first, over all levels."""
    out: dict[str, Counter[str]] = {}
    for r in rows:
        if r["kind"] != "two":
            key = r["hidden"][0][0] if r["hidden"] else "(nothing)"
            out.setdefault(key, Counter())[_answer(r)] += 1
    return dict(sorted(out.items()))


def _power_table(rows: list[CaseRow]) -> dict[str, dict[float, tuple[Proportion, Proportion]]]:
    """Effect -> level -> shares right, and right or ambiguous."""
    out: dict[str, dict[float, tuple[Proportion, Proportion]]] = {}
    for r in of(rows, "one"):
        out.setdefault(r["hidden"][0][0], {})
    for effect in out:
        mine = [r for r in of(rows, "one") if r["hidden"][0][0] == effect]
        for level in sorted({r["hidden"][0][2] for r in mine}):
            at = [r for r in mine if r["hidden"][0][2] == level]
            out[effect][level] = (
                _share_of(at, _ended("right")),
                _share_of(at, _ended("right", "ambiguous")),
            )
    return dict(sorted(out.items()))


def confidence_bins(rows: list[CaseRow]) -> list[tuple[float, float, float, Proportion]]:
    """Bins of confidence: edges, mean confidence, share of findings that are hidden there.

    Every finding counts, of every session; where nothing or nothing of the catalogue is
    hidden, none is right.
    """
    pairs = [
        (f["confidence"], any(_same(f, h) for h in _truth(r))) for r in rows for f in r["named"]
    ]
    out = []
    for low, high in pairwise(_BINS):
        inside = [p for p in pairs if low <= p[0] < high or p[0] == high == 1.0]
        mean = float(np.mean([p[0] for p in inside])) if inside else float("nan")
        out.append((low, high, mean, Proportion(sum(p[1] for p in inside), len(inside))))
    return out


def _same(finding: CaseRow, hidden: list[Any]) -> bool:
    """Whether a finding is what is hidden, on its joint where it has one."""
    return finding["effect"] in accepted(hidden[0]) and finding["joint"] in (None, hidden[1])


def plant_of(row: CaseRow) -> str:
    """Plant of a row; those of earlier revisions are all of the tuning plants."""
    return str(row.get("plant", "tuning"))


def _truth(row: CaseRow) -> list[list[Any]]:
    """What could rightly be named."""
    return row["hidden"] if row["kind"] in ("one", "two") else []


def failures(rows: list[CaseRow]) -> list[tuple[str, str, list[CaseRow]]]:
    """Classes of failure (hidden, said), most frequent first; what lies below half a floor last."""
    classes: dict[tuple[str, str], list[CaseRow]] = {}
    for r in rows:
        if r["outcome"] == "unstable":  # nothing was diagnosed
            continue
        silent = r["kind"] == "outside" and _enough(r) and r["verdict"] == "adequate"
        bad = silent or r["outcome"] != "right"
        quiet = r["kind"] == "one" and not _enough(r) and r["outcome"] in ("missed", "ambiguous")
        if bad and not quiet:
            hidden = " + ".join(f"{h[0]}" for h in r["hidden"]) or "(nothing)"
            said = " + ".join(f["effect"] for f in r["named"]) or r["verdict"]
            if r["verdict"] == "ambiguous":
                said = f"ambiguous: {said}"
            classes.setdefault((hidden, said), []).append(r)
    found = [(h, s, members) for (h, s), members in classes.items()]
    return sorted(found, key=lambda x: -len(x[2]))


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Markdown table, columns padded to be read as plain text."""
    cells = [list(head), *[[str(x) for x in row] for row in rows]]
    width = [max(len(row[k]) for row in cells) for k in range(len(head))]
    lines = [
        "| " + " | ".join(x.ljust(w) for x, w in zip(r, width, strict=True)) + " |" for r in cells
    ]
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in width) + "|")
    return "\n".join(lines)


def report(rows: list[CaseRow], command: str) -> str:
    """Everything, as Markdown, for every plant that has rows."""
    head = [
        "# Benchmark: naming hidden effects",
        "",
        f"Made by `{command}` at revision {revisions(rows)}; {len(rows)} sessions. {_cost(rows)}",
        "Excess: what an effect leaves above the residual of the same session without it, in units",
        "of that residual (worst joint). Intervals: Wilson, 95 %.",
    ]
    plants = [p for p in PLANTS if any(plant_of(r) == p for r in rows)]
    for name in plants:
        mine = [r for r in rows if plant_of(r) == name]
        before = f"{PLANTS[name]}: " if len(plants) > 1 else ""
        for title, make in SECTIONS.items():
            head += ["", f"## {before}{title}", "", make(mine)]
    return "\n".join(head) + "\n"


def revisions(rows: list[CaseRow]) -> str:
    """Revisions of the program that made the rows; several where a run was resumed."""
    return ", ".join(sorted({r["revision"] for r in rows}))


def _cost(rows: list[CaseRow]) -> str:
    cpu = [r["cpu"] for r in rows if "cpu" in r]
    if not cpu:
        return ""
    return (
        f"CPU time a case, median: {median(c[0] for c in cpu):.2f} s for its sessions, "
        f"{median(c[1] for c in cpu):.2f} s for the diagnosis."
    )


def _headline(rows: list[CaseRow]) -> str:
    lines = [[what, s] for what, s in headline(rows).items()]
    text = table(["", "share (of, interval %)"], lines)
    for what in ("unstable", "crashed"):
        lost = sum(r["outcome"] == what for r in rows)
        text += f"\n\n{lost} sessions {what}: not counted." if lost else ""
    return text


def _failures(rows: list[CaseRow]) -> str:
    lines = []
    for hidden, said, members in failures(rows):
        sure = [f["confidence"] for r in members for f in r["named"]]
        lines.append(
            [
                len(members),
                hidden,
                said,
                _range([r["excess"] for r in members]),
                _range([r["before"] for r in members if "before" in r]),
                _range([r["after"] for r in members if "after" in r]),
                _range(sure),
                _where(members),
            ]
        )
    head = ["n", "hidden", "said", "excess", "before/floor", "after/floor", "confidence", "where"]
    return table(head, lines) if lines else "None."


def _range(values: Sequence[float]) -> str:
    if not values:
        return "-"
    low, high = min(values), max(values)
    return f"{low:.2f}" if high - low < 0.005 else f"{low:.2f}..{high:.2f}"


def _where(rows: list[CaseRow]) -> str:
    """Noise, motion and joint that all members have in common."""
    parts = []
    for key in ("robot", "noise", "excitation"):
        seen = {r[key] for r in rows}
        if len(seen) == 1 and (key != "robot" or seen == {"axis"}):
            parts.append(seen.pop())
    joints = {h[1] for r in rows for h in r["hidden"]}
    return " ".join([*parts, *sorted(joints)] if len(joints) < 3 else parts)


def _power(rows: list[CaseRow]) -> str:
    found = _power_table(rows)
    levels = sorted({x for by in found.values() for x in by})
    lines = []
    for effect, by in found.items():
        cells = []
        for level in levels:
            right, either = by.get(level, (Proportion(0, 0), Proportion(0, 0)))
            cells.append(f"{right.k} ({either.k}) of {right.n}" if right.n else "-")
        lines.append([effect, *cells])
    return table(["effect", *[f"{x:g} floors" for x in levels]], lines)


def _calibration(rows: list[CaseRow]) -> str:
    lines = [
        [f"{low:g} to {high:g}", f"{mean:.3f}" if s.n else "-", s]
        for low, high, mean, s in confidence_bins(rows)
    ]
    return table(["confidence", "mean", "right"], lines)


def _conditions(rows: list[CaseRow]) -> str:
    visible = [r for r in of(rows, "one") if _enough(r)]
    lines = []
    for key in ("noise", "excitation", "robot"):
        for value in sorted({r[key] for r in visible}):
            mine = [r for r in visible if r[key] == value]
            shares = [_share_of(mine, _ended(x)) for x in ("right", "ambiguous", "wrong")]
            lines.append([value, *shares])
    return table(["", "right", "ambiguous", "wrong"], lines)


def _confusion(rows: list[CaseRow]) -> str:
    lines = [
        [hidden, sum(said.values()), ", ".join(f"{k} {n}" for k, n in said.most_common())]
        for hidden, said in confusion(rows).items()
    ]
    return table(["hidden", "sessions", "named first"], lines)


#: Plant -> what its sections are called.
PLANTS = {"test": "Test plants (MuJoCo)", "tuning": "Tuning plants"}
SECTIONS: dict[str, Callable[[list[CaseRow]], str]] = {
    "In short": _headline,
    "Failures, most frequent first": _failures,
    "Power: share right (right or ambiguous) by excess": _power,
    "Calibration of the confidence": _calibration,
    "By noise, motion and robot (excess of half a floor or more)": _conditions,
    "Confusion: hidden, and what was named first": _confusion,
}
