"""The figures as Markdown, which is also what the terminal shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

from hil.bench.diagnosis import figures

Row = dict[str, Any]


def table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """Markdown table, columns padded to be read as plain text."""
    cells = [list(head), *[[str(x) for x in row] for row in rows]]
    width = [max(len(row[k]) for row in cells) for k in range(len(head))]
    lines = ["| " + " | ".join(x.ljust(w) for x, w in zip(r, width, strict=True)) + " |"
             for r in cells]  # fmt: skip
    lines.insert(1, "|" + "|".join("-" * (w + 2) for w in width) + "|")
    return "\n".join(lines)


def report(rows: list[Row], command: str) -> str:
    """Everything, as Markdown, for every plant that has rows."""
    head = [
        "# Benchmark: naming hidden effects", "",
        f"Made by `{command}` at revision {revisions(rows)}; {len(rows)} sessions. {_cost(rows)}",
        "Excess: what an effect leaves above the residual of the same session without it, in units",
        "of that residual (worst joint). Intervals: Wilson, 95 %.",
    ]  # fmt: skip
    plants = [p for p in PLANTS if any(figures.plant(r) == p for r in rows)]
    for plant in plants:
        mine = [r for r in rows if figures.plant(r) == plant]
        before = f"{PLANTS[plant]}: " if len(plants) > 1 else ""
        for title, make in SECTIONS.items():
            head += ["", f"## {before}{title}", "", make(mine)]
    return "\n".join(head) + "\n"


def revisions(rows: list[Row]) -> str:
    """Revisions of the program that made the rows; several where a run was resumed."""
    return ", ".join(sorted({r["revision"] for r in rows}))


def _cost(rows: list[Row]) -> str:
    cpu = [r["cpu"] for r in rows if "cpu" in r]
    if not cpu:
        return ""
    return (
        f"CPU time a case, median: {median(c[0] for c in cpu):.2f} s for its sessions, "
        f"{median(c[1] for c in cpu):.2f} s for the diagnosis."
    )


def _headline(rows: list[Row]) -> str:
    lines = [[what, s] for what, s in figures.headline(rows).items()]
    text = table(["", "share (of, interval %)"], lines)
    for what in ("unstable", "crashed"):
        lost = sum(r["outcome"] == what for r in rows)
        text += f"\n\n{lost} sessions {what}: not counted." if lost else ""
    return text


def _failures(rows: list[Row]) -> str:
    lines = []
    for hidden, said, members in figures.failures(rows):
        sure = [f["confidence"] for r in members for f in r["named"]]
        lines.append(
            [
                len(members), hidden, said, _range([r["excess"] for r in members]),
                _range([r["before"] for r in members if "before" in r]),
                _range([r["after"] for r in members if "after" in r]),
                _range(sure), _where(members),
            ]
        )  # fmt: skip
    head = ["n", "hidden", "said", "excess", "before/floor", "after/floor", "confidence", "where"]
    return table(head, lines) if lines else "None."


def _range(values: Sequence[float]) -> str:
    if not values:
        return "-"
    low, high = min(values), max(values)
    return f"{low:.2f}" if high - low < 0.005 else f"{low:.2f}..{high:.2f}"


def _where(rows: list[Row]) -> str:
    """Noise, motion and joint that all members have in common."""
    parts = []
    for key in ("robot", "noise", "excitation"):
        seen = {r[key] for r in rows}
        if len(seen) == 1 and (key != "robot" or seen == {"axis"}):
            parts.append(seen.pop())
    joints = {h[1] for r in rows for h in r["hidden"]}
    return " ".join([*parts, *sorted(joints)] if len(joints) < 3 else parts)


def _power(rows: list[Row]) -> str:
    found = figures.power(rows)
    levels = sorted({x for by in found.values() for x in by})
    lines = []
    for effect, by in found.items():
        cells = []
        for level in levels:
            right, either = by.get(level, (figures.Share(0, 0), figures.Share(0, 0)))
            cells.append(f"{right.k} ({either.k}) of {right.n}" if right.n else "-")
        lines.append([effect, *cells])
    return table(["effect", *[f"{x:g} floors" for x in levels]], lines)


def _calibration(rows: list[Row]) -> str:
    lines = [
        [f"{low:g} to {high:g}", f"{mean:.3f}" if s.n else "-", s]
        for low, high, mean, s in figures.calibration(rows)
    ]
    return table(["confidence", "mean", "right"], lines)


def _conditions(rows: list[Row]) -> str:
    visible = [r for r in figures.of(rows, "one") if figures.enough(r)]
    lines = []
    for key in ("noise", "excitation", "robot"):
        for value in sorted({r[key] for r in visible}):
            mine = [r for r in visible if r[key] == value]
            shares = [figures.share(mine, figures.is_(x)) for x in ("right", "ambiguous", "wrong")]
            lines.append([value, *shares])
    return table(["", "right", "ambiguous", "wrong"], lines)


def _confusion(rows: list[Row]) -> str:
    lines = [
        [hidden, sum(said.values()), ", ".join(f"{k} {n}" for k, n in said.most_common())]
        for hidden, said in figures.confusion(rows).items()
    ]
    return table(["hidden", "sessions", "named first"], lines)


#: Plant -> what its sections are called.
PLANTS = {"test": "Test plants (MuJoCo)", "tuning": "Tuning plants"}
SECTIONS: dict[str, Callable[[list[Row]], str]] = {
    "In short": _headline,
    "Failures, most frequent first": _failures,
    "Power: share right (right or ambiguous) by excess": _power,
    "Calibration of the confidence": _calibration,
    "By noise, motion and robot (excess of half a floor or more)": _conditions,
    "Confusion: hidden, and what was named first": _confusion,
}
