"""Pages of the studies: the thesis' figure or number, ours over seeds, the difference and why.

Every number of a page comes from the runs; a sentence about them is made from them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hil.experiments.charts import SeedMean, bars

Data = Mapping[str, Any]
#: A row's numbers by its name.
Rows = dict[str, tuple[float, ...]]
Means = Mapping[str, Sequence[SeedMean]]


@dataclass(frozen=True)
class StudyPage:
    """What a study's page says beside its numbers.

    Parameters
    ----------
    title, about : str
        Heading; what is done, in sentences.
    thesis : str
        What the thesis shows.
    head : tuple of str
        Heads of the columns, the rows' first.
    rows : callable
        Numbers of one run, a tuple a row.
    read : callable
        Sentences from the means: ours against the thesis', and why they differ.
    figure : str
        Title of the figure; empty for none.
    bars : tuple of int
        Columns of numbers that the figure shows.
    only : callable
        Which rows the figure shows, by name.
    """

    title: str
    about: str
    thesis: str
    head: tuple[str, ...]
    rows: Callable[[Data], Rows]
    read: Callable[[Means], list[str]]
    figure: str = ""
    bars: tuple[int, ...] = (0,)
    only: Callable[[str], bool] = lambda name: True


def means(page: StudyPage, runs: Sequence[Data]) -> dict[str, list[SeedMean]]:
    """Means of each row over the runs; a number that a run lacks counts for none of it."""
    tables = [page.rows(run) for run in runs]
    out = {}
    for name in tables[0]:
        columns = zip(*(t[name] for t in tables if name in t), strict=True)
        out[name] = [_mean(values) for values in columns]
    return out


def _mean(values: Sequence[float]) -> SeedMean:
    known = [float(v) for v in values if v is not None and np.isfinite(v)]
    return SeedMean.of(known) if known else SeedMean(float("nan"), float("nan"))


def cells(found: Means) -> list[list[str]]:
    """Rows of the table."""
    return [[name, *map(str, values)] for name, values in found.items()]


def picture(page: StudyPage, found: Means) -> str:
    """Figure of a page as SVG; empty where it has none."""
    if not page.figure:
        return ""
    groups = {
        name: [values[k] for k in page.bars] for name, values in found.items() if page.only(name)
    }
    return bars(page.figure, [page.head[k + 1] for k in page.bars], groups)


def text(page: StudyPage, found: Means, command: str, seeds: str, picture_name: str) -> str:
    """The page; `seeds` says how many there were, and which gave no number and why."""
    figure = ["", f"![{page.figure}]({picture_name})"] if page.figure else []
    lines = [
        f"# {page.title}",
        "",
        f"Printed by `{command}`: {seeds}; mean and 95 % interval of the mean.",
        "",
        page.about,
        *figure,
        "",
        "| " + " | ".join(page.head) + " |",
        "|" + "---|" * len(page.head),
        *("| " + " | ".join(row) + " |" for row in cells(found)),
        "",
        "## The thesis, and here",
        "",
        f"**Thesis.** {page.thesis}",
        "",
        *(f"- {line}" for line in page.read(found)),
        "",
    ]
    return "\n".join(lines)


def _points(x: float) -> str:
    return f"{abs(100 * x):.0f} points {'lower' if x < 0 else 'higher'}"


# ---------------------------------------------------------------- I: friction networks


def _friction_rows(data: Data) -> Rows:
    return {
        r["model"]: (
            100 * float(np.mean(r["train"])),
            100 * float(np.mean(r["validation"])),
            float(r["nodes"]),
        )
        for r in data["rows"]
    }


def _friction_read(found: Means) -> list[str]:
    base = found["Coulomb + viscous"]
    out = []
    for name, values in found.items():
        if values is base:
            continue
        train, valid = ((values[k].mean - base[k].mean) / 100 for k in (0, 1))
        out.append(
            f"{name[:1].upper()}{name[1:]}: {_points(train)} in training, {_points(valid)} in "
            "validation than Coulomb and viscous friction."
        )
    short = found["network alone, 10 s of data"]
    gap = short[1].mean / max(short[0].mean, 1e-9)
    out.append(
        f"The thesis' result, better in training and worse in validation, needs a short record: "
        f"with 10 s the network's error in validation is {gap:.1f} times that in training. It "
        "has learnt the path, not the friction."
    )
    out.append(
        "The cure is the backbone: a network beside Coulomb and viscous friction has only their "
        "rest to learn, and extrapolates as they do."
    )
    return out


# ---------------------------------------------------------------- II: manual excitation


def _excitation_rows(data: Data) -> Rows:
    return {
        r["name"]: (
            float(r["found"]["rank"]),
            float(r["found"]["condition"]),
            float("nan") if r["worst"] is None else 100 * r["worst"],
        )
        for r in data["rows"]
    }


def _excitation_read(found: Means) -> list[str]:
    ranks = {name: round(values[0].mean) for name, values in found.items()}
    most = max(ranks.values())
    whole = [n for n, k in ranks.items() if k == most]
    return [
        "Values that are determined, of 17: "
        + ", ".join(f"{k} by *{n}*" for n, k in ranks.items())
        + ". What a hand adds is a force of known size: without it all torques may be scaled "
        "together.",
        f"Most are determined by *{'* and *'.join(whole)}*, the motor constants among them. The "
        "thesis saw these move to values that it could only presume to be right; here the right "
        "ones are known.",
        "The thesis' 21 to 35 % are of the interaction force on an Omni whose constants nobody "
        "knew; how much there is to gain depends on how wrong they were, which is why no number "
        "of ours stands beside them.",
    ]


# ---------------------------------------------------------------- III: elastic transmission


def _elastic_rows(data: Data) -> Rows:
    return {
        f"{r['study']} {r['value']:g}": (
            1e3 * r["angle"],
            1e3 * r["motor_angle"],
            100 * r["speed"],
            1e3 * r["innovation"],
        )
        for r in data["rows"]
    }


def _elastic_read(found: Means) -> list[str]:
    def of(study: str) -> dict[float, Sequence[SeedMean]]:
        own = {k: v for k, v in found.items() if k.startswith(study)}
        return {float(k.rpartition(" ")[2]): v for k, v in own.items()}

    inertia, tension, force = of("link inertia"), of("cable tension"), of("interaction")
    grows = inertia[2.5][0].mean / inertia[1.0][0].mean
    first = (inertia[1.5][0].mean - inertia[1.0][0].mean) / (
        inertia[2.5][0].mean - inertia[1.0][0].mean
    )
    slack = tension[0.4][0].mean / tension[1.0][0].mean
    x = np.array(sorted(force))
    y = np.array([force[k][3].mean for k in sorted(force)])
    line = np.polyfit(x, y, 1)
    off = float(np.abs(np.polyval(line, x) - y).max() / np.ptp(y))
    better = sum(v[0].mean < v[1].mean for v in found.values())
    return [
        "The thesis: almost constant up to 2.5 times the inertia. Here the error of the angle at "
        f"2.5 times is {grows:.1f} times that at the nominal inertia, with {100 * first:.0f} % "
        "of the rise at 1.5 times already: the filter's parameters are frozen, and it does not "
        "know of the inertia.",
        "The thesis: constant or better with less tension. Here the error at 0.4 of the tension "
        f"is {slack:.1f} times the nominal one: the cable loses stiffness with its tension, and "
        "the filter takes it for stiff.",
        "The thesis: errors nearly linear in the interaction force. Here the mean innovation is, "
        f"within {100 * off:.1f} % of its span: a force can be read from it at steady state.",
        f"The thesis: the estimate of the link's angle beats the motor's angle. Here it does in "
        f"{better} of {len(found)} conditions.",
    ]


# ---------------------------------------------------------------- IV: transparency


def _transparency_rows(data: Data) -> Rows:
    return {
        f"{r['design']}, {r['entry']}, {r['hz']:g} Hz": (
            r["predicted"],
            r["measured"],
            100 * r["difference"] / r["predicted"],
        )
        for r in data["rows"]
    }


def _transparency_read(found: Means) -> list[str]:
    def worst(entry: str) -> float:
        return max(v[2].mean for k, v in found.items() if f", {entry}," in k)

    return [
        "The thesis proves what a transparent design must satisfy and measures none. Here the "
        "hybrid matrix of sessions on the simulated rig stands beside the prediction: the largest "
        f"difference is {worst('h12'):.1f} % of h12, {worst('h21'):.1f} % of h21, "
        f"{worst('h22'):.1f} % of h22 and {worst('h11'):.0f} % of h11.",
        "h11 is what the operator feels in free space. Its prediction is small where the law "
        "compensates the arm, so that friction that no model holds is large beside it.",
    ]


# ---------------------------------------------------------------- V: without force sensors


def _fsf_rows(data: Data) -> Rows:
    out = {}
    for r in data["rows"]:
        differ = [100 * x for x in r["measured"]]
        shares = [100 * r[f"{a}_error"] / r[f"{a}_size"] for a in ("master", "slave")]
        out[f"{r['hz']:g} Hz"] = (*differ, *shares)
    return out


def _fsf_read(found: Means) -> list[str]:
    names = list(found)
    low, high = found[names[0]], found[names[-1]]
    return [
        "Thesis: frequency responses almost identical at low frequencies, not at higher ones. "
        f"Here h12, h21 and h22 of the two laws differ by {max(v.mean for v in low[1:4]):.1f} % "
        f"at most at {names[0]} and by {max(v.mean for v in high[1:4]):.1f} % at {names[-1]}.",
        "Thesis: similar profiles in the gel, a fluctuating master force in free space. Here the "
        f"estimated master force is wrong by {low[4].mean:.0f} % of its rms at {names[0]} and by "
        f"{high[4].mean:.0f} % at {names[-1]}; h11, what is felt in free space, differs most.",
        "Why: the law without sensors takes the force from the arm's model. What the model lacks, "
        "and what the filters delay, is in the force; both grow with frequency.",
    ]


# ---------------------------------------------------------------- V, 5.2: the safe distance


def _singularity_rows(data: Data) -> Rows:
    return {
        f"{r['factor']}: {r['level']}" if r["factor"] else r["level"]: (
            r["stable"],
            r["handed_back"],
            r["accurate"],
            float("nan") if r["linear"] is None else r["linear"],
        )
        for r in data["rows"]
    }


def _singularity_read(found: Means) -> list[str]:
    built = next(v for k, v in found.items() if ": " not in k)
    levels: dict[str, dict[str, Sequence[SeedMean]]] = {}
    for name, values in found.items():
        factor, colon, level = name.partition(": ")
        if colon:
            levels.setdefault(factor, {})[level] = values
    order = {k: _best(levels, built, k) for k in (0, 2)}
    firm, exact = (
        ", ".join(f"{n} ({lv}: {gain:+.2f})" for n, (lv, gain) in order[k].items()) for k in (0, 2)
    )
    worst = {n: min(v.items(), key=lambda x: x[1][0].mean) for n, v in levels.items()}
    friction, acceleration = (order[0][n][1] for n in ("friction model", "acceleration"))
    first = "acceleration" if acceleration > friction else "friction"
    past = [v for v in found.values() if np.isfinite(v[3].mean)]
    sooner = sum(v[0].mean < v[3].mean for v in past)
    return [
        f"The safe distance as built: stable up to kappa {built[0]}, so that {built[1]} of the "
        f"force can be handed over; estimates right to a quarter up to kappa {built[2]}.",
        f"What helps stability, ranked by the kappa that the best level gains: {firm}.",
        f"What helps the estimates, ranked in the same way: {exact}.",
        "What costs most, by the stable kappa of the worst level: "
        + ", ".join(
            f"{n} ({lv}: {v[0].mean:.2f})"
            for n, (lv, v) in sorted(worst.items(), key=lambda x: x[1][1][0].mean)
        )
        + ".",
        f"The thesis' question, friction or acceleration: the measurement of {first} counts more "
        f"for stability ({acceleration:+.2f} against {friction:+.2f} in kappa).",
        f"Eigenvalues of the linear loop promise more than runs keep in {sooner} of {len(past)} "
        "conditions: they know neither the steps of the encoder nor dry friction nor the loss of "
        "contact.",
    ]


def _best(
    levels: Mapping[str, Means], built: Sequence[SeedMean], k: int
) -> dict[str, tuple[str, float]]:
    """Best level of each factor and what it gains in column k, the largest gain first."""
    best = {n: max(v.items(), key=lambda x: x[1][k].mean) for n, v in levels.items()}
    gains = {n: (lv, v[k].mean - built[k].mean) for n, (lv, v) in best.items()}
    return dict(sorted(gains.items(), key=lambda x: -x[1][1]))


# ---------------------------------------------------------------- VI: palpation


def _palpation_rows(data: Data) -> Rows:
    return {
        r["controller"]: (
            float(np.mean(r["measured"])),
            r["predicted"],
            r["designed"],
            float(np.mean(r["stroked"])),
            r["stroke_predicted"],
        )
        for r in data["rows"]
    }


def _palpation_read(found: Means) -> list[str]:
    best = found["sensitivity-optimised (SO)"]
    with_sensors, without = (
        found["four channels"], found["four channels, force-sensor-free"],
    )  # fmt: skip
    low = found["benchmark (position error)"]
    return [
        f"Thesis: 0.285 with force sensors (SO), 0.202 without (SOFSF), 0.211 predicted. Here "
        f"{best[0].mean:.3f} for SO, {best[1].mean:.3f} predicted for its environment. The rigs "
        "differ in their arms, gel and bolt; the agreement of prediction and measurement is what "
        "can be compared: 35 % apart there, "
        f"{100 * abs(best[0].mean / best[1].mean - 1):.0f} % here.",
        f"Thesis: significantly lower without force sensors. Here {with_sensors[0].mean:.3f} with "
        f"and {without[0].mean:.3f} without them, "
        f"{100 * abs(without[0].mean / with_sensors[0].mean - 1):.1f} % apart, for a law that the "
        "transformation leaves as sensitive in theory.",
        f"The benchmark reaches {low[0].mean:.3f}: {100 * low[0].mean / best[0].mean:.0f} % of SO.",
        f"Strokes across a bolt in the gel, with a constant force down: {best[3].mean:.3f} for SO "
        f"({best[4].mean:.3f} predicted), {with_sensors[3].mean:.3f} and {without[3].mean:.3f} "
        f"with four channels, {low[3].mean:.3f} for the benchmark. The largest difference to the "
        f"prediction is {100 * max(abs(r[3].mean / r[4].mean - 1) for r in found.values()):.0f} %: "
        "the theory is linear, and the gel is stiffer where one sinks in deeper.",
    ]


# ---------------------------------------------------------------- VII: perception


def _perception_rows(data: Data) -> Rows:
    def of(x: float | None, scale: float = 1.0) -> float:
        return float("nan") if x is None else scale * x

    return {
        f"{r['bolt']}: {r['controller']}": (
            of(r["change"], 100),
            of(r["index"]),
            of(r["right"], 100),
            of(r["power"], 100),
            of(r["subjects"]),
        )
        for r in data["rows"]
    }


def _perception_read(found: Means) -> list[str]:
    by: dict[str, dict[str, Sequence[SeedMean]]] = {}
    for name, values in found.items():
        bolt, _, controller = name.partition(": ")
        by.setdefault(bolt, {})[controller] = values
    bolts = list(by)
    weak, strong = by[bolts[0]], by[bolts[-1]]

    def parts(rows: Mapping[str, Sequence[SeedMean]]) -> list[Sequence[SeedMean]]:
        pair = next(k for k in rows if "=" in k)
        so, free = pair.split(" = ")
        return [rows[so], rows[free], rows["benchmark"], rows["pen"], rows[pair]]

    so, free, measure, pen, equal = parts(weak)
    firm, _, low, _, same = parts(strong)
    return [
        f"Why the test was inconclusive: with the {bolts[0]}, subjects find {so[2].mean:.0f} % of "
        f"the bolts with force sensors, {free[2].mean:.0f} % without them and "
        f"{measure[2].mean:.0f} % with the benchmark. A small test tells the first from the last "
        f"in {so[3].mean:.0f} % of its repetitions, and shows that the first two are equal in "
        f"{equal[3].mean:.1f} %.",
        f"The thesis saw the pen ahead. Here its bolts are found in {pen[2].mean:.0f} %, and the "
        f"small test tells it from the benchmark in {pen[3].mean:.0f} % of its repetitions, more "
        "often than it does any controller.",
        f"A design that decides (power 80 %): forty trials a controller, and {so[4].mean:.0f} "
        f"subjects for the difference, {equal[4].mean:.0f} for the equality. With the "
        f"{bolts[-1]}, {firm[2].mean:.0f} % against {low[2].mean:.0f} % are found, and "
        f"{firm[4].mean:.0f} and {same[4].mean:.0f} subjects do.",
        "What these numbers do not hold: hands that press differently from trial to trial, and "
        "learning. Both ask for more subjects; the thesis' test kept forces alike by lamps.",
    ]


# ---------------------------------------------------------------- filters and networks


def _cable_rows(data: Data) -> Rows:
    return {
        f"{r['estimator']} ({r['condition']})": (
            1e3 * r["free"],
            1e3 * r["touched"],
            float(r["nodes"]),
        )
        for r in data["rows"]
    }


def _cable_read(found: Means) -> list[str]:
    by: dict[str, dict[str, Sequence[SeedMean]]] = {}
    for name, values in found.items():
        estimator, _, condition = name.rstrip(")").partition(" (")
        by.setdefault(condition, {})[estimator] = values
    out = []
    for condition, rows in by.items():
        free, touching = (_least(rows, k) for k in (0, 1))
        both = rows["filters and networks, learnt in the loop"]
        out.append(
            f"With {condition}: least error in free motion has *{free}*, {rows[free][0].mean:.0f} "
            f"mN (filters and networks together {both[0].mean:.0f}); least where it touches has "
            f"*{touching}*, {rows[touching][1].mean:.0f} mN (together {both[1].mean:.0f})."
        )
    return out


def _least(rows: Means, k: int) -> str:
    """Row with the smallest mean in a column."""
    return min(rows, key=lambda name: rows[name][k].mean)


PAGES: dict[str, StudyPage] = {
    "friction-network": StudyPage(
        "Wavelet networks for friction",
        "Three joints with Stribeck friction that is coupled over the cables. Each model learns "
        "on one motion and is judged on another. Errors are relative to the torque's rms, the "
        "mean of the joints.",
        "Paper I: up to 30.5 percentage points lower than Coulomb and viscous friction in "
        "training, and worse than it in validation.",
        ("model", "training %", "validation %", "nodes"),
        _friction_rows,
        _friction_read,
        "Error of the torque [% of its rms]",
        (0, 1),
    ),
    "manual-excitation": StudyPage(
        "What a hand, the motors, or both determine",
        "An arm with friction and motor constants that are a few percent wrong is moved by its "
        "motors, by a hand at a force sensor, or by both. The identification says which of its 17 "
        "values the motion determines.",
        "Paper II: excitation by hand lowers the relative error of the interaction force by 21 to "
        "35 % against excitation by the motors.",
        ("excitation", "rank of 17", "condition", "worst error of what is determined %"),
        _excitation_rows,
        _excitation_read,
    ),
    "elastic-ukf": StudyPage(
        "An elastic transmission seen from its motor",
        "An unscented Kalman filter sees the motor alone. It first identifies the transmission; "
        "then its parameters are frozen, and the plant changes.",
        "Paper III: link states and parameters are found; robust up to 2.5 times the inertia, and "
        "for less cable tension; errors nearly linear in the interaction force.",
        ("condition", "link angle, mrad", "motor's for the link's, mrad", "link speed %",
         "mean innovation, mrad"),
        _elastic_rows,
        _elastic_read,
        "Error of the link's angle [mrad]",
        (0, 1),
        lambda name: not name.startswith("interaction"),
    ),
    "transparency": StudyPage(
        "The hybrid matrix of sessions",
        "Designs of the extended Lawrence architecture run on the simulated rig. A machine moves "
        "both sides at one frequency; the hybrid matrix of the session stands beside the "
        "prediction.",
        "Paper IV: conditions for transparency, their solutions, and the redundancy of the "
        "communication gains, as theory.",
        ("entry", "predicted", "measured", "difference %"),
        _transparency_rows,
        _transparency_read,
        "Difference from the prediction at 1 Hz [% of the entry]",
        (2,),
        lambda name: name.endswith(", 1 Hz"),
    ),
    "fsf": StudyPage(
        "A law with force sensors, and its transform without",
        "The same teleoperation law with force sensors and after the force-sensor-free "
        "transformation, on the simulated rig. Columns h11 to h22: difference of the two laws as "
        "measured, of the entry's own size. Forces: error of what the arm's model says, of the "
        "force's rms.",
        "Paper V: in theory equivalent; alike in the gel, fluctuating in free space, alike at low "
        "frequencies.",
        ("frequency", "h11 %", "h12 %", "h21 %", "h22 %", "master force %", "slave force %"),
        _fsf_rows,
        _fsf_read,
        "Difference of the two laws [% of the entry]",
        (0, 1, 2, 3),
    ),
    "singularity": StudyPage(
        "The safe distance to the force estimation singularity",
        "One axis of two arms with elastic cables, dry friction, encoders and filters runs a law "
        "that estimates both forces. One thing of the hardware is changed at a time. The condition "
        "kappa of Q is raised until the arms shake or leave the workspace (stable), or the "
        "estimated forces are wrong by more than 25 % of their rms (accurate); 1 is the farthest "
        "from the singularity, and stands where no kappa that was tried is safe. Arms, friction, "
        "hand and gel differ with the seed.",
        "Section 5.2, open: which distance to the singularity is safe for given hardware, and what "
        "makes it shorter most cheaply; for example, accurate friction estimation or accurate "
        "acceleration measurement?",
        ("hardware", "stable kappa", "force handed over", "accurate kappa", "by eigenvalues"),
        _singularity_rows,
        _singularity_read,
        "Largest condition of Q that is safe",
        (0, 2),
    ),
    "palpation": StudyPage(
        "A bolt in a gel",
        "A machine presses on a gel, and on a stiffer spot of it. The sensitivity is the share of "
        "the change of impedance that reaches the operator; a pen in the hand has 1. *Stroke*: a "
        "machine strokes across a bolt of 6 mm, 8 mm below the surface of a gel of 20 mm, and "
        "presses down with 0.8 N; the tip climbs over it.",
        "Paper VI: 0.285 with force sensors, 0.202 without, 0.211 predicted; the difference is "
        "significant (p = 0.00002).",
        (
            "controller", "measured", "predicted", "design, 0.2-5 Hz", "stroke", "stroke predicted",
        ),
        _palpation_rows,
        _palpation_read,
        "Sensitivity, measured and predicted",
        (0, 1),
    ),
    "perception": StudyPage(
        "Who finds the bolt: the perception test and its power",
        "What a controller lets feel of a bolt is taken from sessions on the simulated rig. "
        "Simulated subjects name the stiffest of four cells, with the noise of a Weber fraction of "
        "stiffness between 0.15 (Bergmann Tiest and Kappers, 2009) and 0.23 (Jones and Hunter, "
        "1990). The small test has 10 subjects with 3 trials a controller; the thesis' numbers are "
        "not known. Each controller is compared with the benchmark by paired t tests; equality "
        "within 10 points is shown by two one-sided tests (TOST).",
        "Paper VII: the controllers with and without force sensors were to be equal, and set apart "
        "from the benchmark; the results came out inconclusive. The pen was superior.",
        ("bolt: controller", "change felt, % (ln)", "d'", "found of 4 cells %",
         "power of the small test %", "subjects needed, 40 trials"),
        _perception_rows,
        _perception_read,
        "Bolts that are found, and power of the small test [%]",
        (2, 3),
        lambda name: "=" not in name,
    ),
    "ukf-network": StudyPage(
        "Filters and networks together on the cable arm",
        "Force at the tip without a sensor, on the simulated arm with elastic cables, after the "
        "estimators have learnt in the loop.",
        "Section 3.1: filters for the cables (paper III) and networks for the friction (paper I) "
        "are proposed to be used together; no result is given.",
        ("estimator", "free, rms mN", "touching, error mN", "nodes"),
        _cable_rows,
        _cable_read,
        "Error of the force where it touches [mN]",
        (1,),
    ),
}  # fmt: skip
