"""The force-sensor-free transformation in the loop, with real filters, on the simulated rig.

A controller that uses both forces, and its transform that uses neither (thesis 3.2.3 and 4.2.2):
the hybrid matrices of both from sessions, and the forces that the second one estimates.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hil import registry, terminal
from hil.errors import ConfigError
from hil.experiments import transparency as rig
from hil.experiments.pages import Means, PageData, StudyPage, TableRows
from hil.record.container import read
from hil.record.schema import decode_numbers
from hil.teleop import force_sensor_free, hybrid, law_parameters
from hil.teleop.architecture import Design, MotionTerm, RobotImpedance
from hil.terminal import Found

_HZ, _QUICK_HZ = (0.5, 1.0, 2.0, 4.0), (0.5, 4.0)
#: The acceleration acts on the light motor side of the cables: 5 Hz is what it bears.
LAW = {"acceleration_hz": 5.0, "velocity_hz": 80.0, "force_hz": 60.0}


@dataclass(frozen=True)
class WithoutForceSensorsRow:
    """One frequency.

    Parameters
    ----------
    hz : float
        [Hz].
    theory, measured : tuple of 4 floats
        Difference of the two hybrid matrices, h11, h12, h21, h22, each over its own size:
        predicted with filters, and between the two sets of sessions.
    master_error, master_size, slave_error, slave_size : float
        Amplitude at this frequency of the error of the estimated force in the stiffer gel, and
        of the force itself [N].
    fluctuation : tuple of 2 floats
        Of the master's force in free space, both laws: rms of what is not of the motion's own
        frequency [N].
    profile : float
        Rms of the difference of the two laws' master forces over a period in the stiffer gel, over
        the rms of the first one's.
    """

    hz: float
    theory: tuple[float, ...]
    measured: tuple[float, ...]
    master_error: float
    master_size: float
    slave_error: float
    slave_size: float
    fluctuation: tuple[float, float]
    profile: float


@dataclass(frozen=True)
class SensorFreeStudy:
    """Result of the experiment.

    Parameters
    ----------
    kappa, D, smallest, bound : float
        Conditioning, and the sampled-data condition of the transform.
    rows : list of Row
        By frequency.
    refused : str
        What is said of the same design closer to the singularity.
    """

    kappa: float
    D: float
    smallest: float
    bound: float
    rows: list[WithoutForceSensorsRow]
    refused: str


def four_channel_designs(axes: Any, share: float = 0.3) -> list[Design]:
    """Design with all four channels on every axis; `share` is c2 = c3."""
    pull = MotionTerm(130.0, 0.8)
    return [
        Design(
            c1=pull,
            c4=-pull,
            c7=pull,
            c8=pull,
            c2=share,
            c3=share,
            c5=0.1,
            c6=0.1,
            master=RobotImpedance(m),
            slave=RobotImpedance(s),
            name="with-sensors",
        )
        for m, s in zip(axes.master, axes.slave, strict=True)
    ]


def study(
    seed: int = 1, report: Callable[[str], None] = lambda _: None, hz: tuple[float, ...] = _HZ
) -> SensorFreeStudy:
    """Both controllers at all frequencies."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        given, axes = rig.arm_parameters(rig.identified_arms(folder, seed), LAW)
        own = four_channel_designs(axes)
        laws = [
            given | law_parameters.law_table(own),
            given | law_parameters.law_table([force_sensor_free.transform(d) for d in own]),
        ]
        rows = []
        for f in hz:
            report(f"{f:g} Hz")
            rows.append(_row(laws, f, folder, seed))
    d = own[rig.VERTICAL]
    condition = force_sensor_free.sampled_condition(d, LAW["acceleration_hz"], rig.PERIOD)
    return SensorFreeStudy(
        force_sensor_free.conditioning(d),
        d.D,
        condition.smallest,
        condition.bound,
        rows,
        _refusal(axes),
    )


def _row(
    laws: Sequence[Mapping[str, Any]], hz: float, folder: Path, seed: int
) -> WithoutForceSensorsRow:
    found, goal, free, gel = [], [], [], []
    for law in laws:
        runs = rig.sessions(law, hz, folder, seed)
        free.append(_fluctuation(runs[0].fm))
        gel.append(runs[-1].fm.reshape(rig.CUT_PERIODS, -1).mean(axis=0))
        found.append(hybrid.estimate_hybrid(runs).h)
        goal.append(rig.predicted(law, np.array([hz]))[0])
    f_m, of_m, f_s, of_s = _estimates(folder / f"{hz:g}-2.mcap", hz)
    return WithoutForceSensorsRow(
        hz,
        tuple(rig.relative_errors(goal[1], goal[0]).ravel().tolist()),
        tuple(rig.relative_errors(found[1], found[0]).ravel().tolist()),
        f_m,
        of_m,
        f_s,
        of_s,
        (free[0], free[1]),
        float(np.linalg.norm(gel[1] - gel[0]) / np.linalg.norm(gel[0])),
    )


def _fluctuation(force: Any) -> float:
    """Rms of a force over whole periods without its mean and the motion's own frequency [N]."""
    lines = np.fft.rfft(force) / force.size
    lines[[0, rig.CUT_PERIODS]] = 0.0
    return float(np.sqrt(2.0 * np.sum(np.abs(lines) ** 2)))


def _estimates(path: Path, hz: float) -> list[float]:
    """Errors and sizes of f_m and f_s as the law believes them, at the motion's frequency [N]."""
    run = rig.last_periods(path, hz)
    out: list[float] = []
    topic = read(path).topics["/controller/state"]
    values = decode_numbers(topic)
    names = registry.load("hil.controllers", "lawrence").Lawrence.state_names
    for arm, truth in (("leader", run.fm), ("follower", run.fs)):
        # the state may be recorded every few ticks only
        every = round(topic.sequence[-1] - topic.sequence[-2])
        kept = truth[every - 1 :: every]
        guess = values[-kept.size :, names.index(f"{arm}_estimate_z")]
        wave = np.exp(-2j * np.pi * rig.CUT_PERIODS * np.arange(kept.size) / kept.size)
        out += [float(2 * abs(wave @ x) / kept.size) for x in (guess - kept, kept)]
    return out


def _refusal(axes: Any) -> str:
    try:
        force_sensor_free.transform(four_channel_designs(axes, share=1.05)[rig.VERTICAL])
    except ConfigError as error:
        return str(error)
    return ""


# ------------------------------------------------------------ the command, and the page


def command(args: argparse.Namespace) -> Found:
    """A law with force sensors against its transform that needs none."""
    s = study(args.seed, terminal.log, _QUICK_HZ if args.quick else _HZ)
    cells = [
        [
            f"{r.hz:g}",
            *(f"{100 * a:.1f}, {100 * b:.1f}" for a, b in zip(r.theory, r.measured, strict=True)),
            f"{r.master_error:.3f} of {r.master_size:.3f}",
            f"{r.slave_error:.3f} of {r.slave_size:.3f}",
            f"{r.fluctuation[0]:.3f}, {r.fluctuation[1]:.3f}",
            f"{100 * r.profile:.1f}",
        ]
        for r in s.rows
    ]
    head = ["Hz", *(f"{h} %" for h in rig.HYBRID_ENTRIES), "f_m error [N]", "f_s error [N]"]
    head += ["free [N]", "gel %"]
    text = (
        f"With force sensors, and transformed to need none: condition of Q {s.kappa:.3g}, D "
        f"{s.D:.3g}\n  sampled-data condition: {s.smallest:.3g} > {s.bound:.3g}\n\n"
        f"{terminal.table(head, cells)}\n  h11..h22: difference of both laws over the entry's own "
        f"size: theory, sessions\n  free: fluctuation of the master's force in free space, with "
        f"sensors and without\n  gel: difference of the master's force over a period in the gel"
        f"\n\n  closer to the singularity: {s.refused}"
    )
    return text, asdict(s)


def _page_rows(data: PageData) -> TableRows:
    out = {}
    for r in data["rows"]:
        differ = [100 * x for x in r["measured"]]
        shares = [100 * r[f"{a}_error"] / r[f"{a}_size"] for a in ("master", "slave")]
        out[f"{r['hz']:g} Hz"] = (*differ, *shares, *r["fluctuation"], 100 * r["profile"])
    return out


def _page_read(found: Means) -> list[str]:
    names = list(found)
    low, high = found[names[0]], found[names[-1]]
    return [
        "Thesis: frequency responses almost identical at low frequencies, not at higher ones. "
        f"Here h12, h21 and h22 of the two laws differ by {max(v.mean for v in low[1:4]):.1f} % "
        f"at most at {names[0]} and by {max(v.mean for v in high[1:4]):.1f} % at {names[-1]}.",
        "Thesis: similar profiles in the gel, a fluctuating master force in free space. Here the "
        f"master's force over a period in the gel differs by {low[8].mean:.0f} % of its rms at "
        f"{names[0]} and by {high[8].mean:.0f} % at {names[-1]}. In free space it fluctuates by "
        f"{low[6].mean:.3f} N (rms, beside the motion's own frequency) with sensors and "
        f"{low[7].mean:.3f} N without at {names[0]}, {high[6].mean:.3f} and {high[7].mean:.3f} N "
        f"at {names[-1]}.",
        f"The estimated master force is wrong by {low[4].mean:.0f} % of its rms at {names[0]} and "
        f"by {high[4].mean:.0f} % at {names[-1]}; h11, what is felt in free space, differs most.",
        "Why: the law without sensors takes the force from the arm's model. What the compensation "
        "leaves of friction, or takes too much, counts as force: h11 is small where the motion is "
        "slow, so it is a large part of it there. The filter of the acceleration delays the "
        "inertia's share of the force, by more the quicker the motion is.",
    ]


PAGE = StudyPage(
    "A law with force sensors, and its transform without",
    "The same teleoperation law with force sensors and after the force-sensor-free "
    "transformation, on the simulated rig. Columns h11 to h22: difference of the two laws as "
    "measured, of the entry's own size. Forces: error of what the arm's model says in the gel, of "
    "the force's rms. *Fluctuation*: rms of the master's force in free space without the motion's "
    "own frequency. *Profile*: difference of the master's force over a period in the gel.",
    "Paper V: in theory equivalent; alike in the gel, fluctuating in free space, alike at low "
    "frequencies.",
    (
        "frequency",
        "h11 %",
        "h12 %",
        "h21 %",
        "h22 %",
        "master force %",
        "slave force %",
        "fluctuation, sensors [N]",
        "fluctuation, none [N]",
        "profile %",
    ),
    _page_rows,
    _page_read,
    "Difference of the two laws [% of the entry]",
    (0, 1, 2, 3),
    quick=f"{len(_QUICK_HZ)} frequencies of {len(_HZ)}",
)
