"""Sensitivity by palpation on the simulated rig: how much of a stiffer spot reaches the operator.

A machine presses the leader down and up on a sine; the follower is in a gel, then over a bolt in
it (thesis sections 3.3.3 and 4.3; paper VI).  From the forces and speeds of both runs at the
motion's frequency

    sigma = |z_t,bolt - z_t,gel| / |z_e,bolt - z_e,gel|,   z_t = f_m / v_m,  z_e = f_s / v_s,

which the theory gives exactly as  |h12 h21 / ((1 + h22 z_e,gel)(1 + h22 z_e,bolt))|  with the
hybrid matrix of the sampled loop.  1 is a pen in the hand.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from hil import registry
from hil.experiments import transparency as rig
from hil.experiments import without_force_sensors
from hil.runtime import runner
from hil.teleop import force_sensor_free, hybrid, law_parameters, rig_designs, summary
from hil.teleop.architecture import Design
from hil.teleop.rig_designs import ArmImpedances
from hil.toml import parse

HZ, _TRIALS = 1.0, 6
#: Stiffness of the gel, and over the bolt [N/m^1.3].
_GEL, _BOLT = 250.0, 400.0
#: Named designs beside the optimised one: the measure, half as stiff as that may be, and one that
#: hands half of the force back.
MEASURE, FREE_FORM = "benchmark (position error)", ", force-sensor-free"
NAMED = {
    MEASURE: ("position-error", {
        "stiffness": 75.0, "damping": 0.75, "master_stiffness": 75.0, "master_damping": 0.75,
    }),
    "position-force": ("position-force", {
        "stiffness": 150.0, "damping": 1.0, "share": 0.5, "master_damping": 0.5,
    }),
}  # fmt: skip


@dataclass(frozen=True)
class PalpationRow:
    """One controller.

    Parameters
    ----------
    controller : str
        Which.
    designed : float
        Weighted sensitivity of the design, tangent at its environment, 0.2 to 5 Hz.
    predicted : float
        Sigma at the motion's frequency for the measured environments.
    measured : tuple of float
        Sigma of every trial.
    """

    controller: str
    designed: float
    predicted: float
    measured: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Mean of the trials."""
        return float(np.mean(self.measured))

    @property
    def std(self) -> float:
        """Standard deviation of a trial."""
        return float(np.std(self.measured, ddof=1)) if len(self.measured) > 1 else float("nan")


def study(
    seed: int = 1, report: Callable[[str], None] = lambda _: None, trials: int = _TRIALS
) -> tuple[list[PalpationRow], dict[str, float]]:
    """All controllers, and the `differences` between them."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        given, axes = rig.arms(rig.identified(folder, seed), without_force_sensors.LAW)
        for controller, designs in controllers(given, axes).items():
            report(controller)
            law = given | law_parameters.table(designs)
            rows.append(palpate(controller, designs, law, folder, seed, trials))
    return rows, differences(rows)


def controllers(given: Mapping[str, Any], axes: ArmImpedances) -> dict[str, list[Design]]:
    """Sensitivity-optimised, with four channels, named ones; and what of them needs no sensor.

    An optimised design without force gains is its own force-sensor-free form and stands once.
    """
    config = parse(
        registry.load("hil.controllers", "lawrence").Config,
        {"c1": [0.0] * 3, "c7": [0.0] * 3} | dict(given),
        "experiment",
    )
    best = [f.design for f in rig_designs.optimised({}, axes, config)]
    four = without_force_sensors.designs(axes)
    out = {"sensitivity-optimised (SO)": best, "four channels": four}
    for name, designs in list(out.items()):
        if any(x > 1e-6 for d in designs for x in (d.c2, d.c3, d.c5, d.c6)):
            out[name + FREE_FORM] = [force_sensor_free.transform(d) for d in designs]
    return out | {n: rig_designs.designs(kind, wish, axes) for n, (kind, wish) in NAMED.items()}


def palpate(
    controller: str,
    designs: Sequence[Design],
    law: Mapping[str, Any],
    folder: Path,
    seed: int,
    trials: int,
) -> PalpationRow:
    """Trials on gel and bolt with one controller."""
    h = rig.predicted(law, np.array([HZ]))[0]
    found, expected = [], []
    for trial in range(trials):
        zt, ze = np.array(
            [
                impedances(folder, law, stiffness, seed + 10 * trial + k)
                for k, stiffness in enumerate((_GEL, _BOLT))
            ]
        ).T
        found.append(float(abs((zt[1] - zt[0]) / (ze[1] - ze[0]))))
        expected.append(
            float(abs(h[0, 1] * h[1, 0] / ((1 + h[1, 1] * ze[0]) * (1 + h[1, 1] * ze[1]))))
        )
    config = parse(registry.load("hil.controllers", "lawrence").Config, law, "experiment")
    design, environment = designs[rig.AXIS], hybrid.Impedance(*config.environment)
    s = hybrid.jw(summary.band())
    near = hybrid.sensitivity(hybrid.hybrid(design, s), environment(s))
    designed = summary.weighted(near, summary.band())
    return PalpationRow(controller, designed, float(np.mean(expected)), tuple(found))


def impedances(
    folder: Path, law: Mapping[str, Any], stiffness: float, seed: int
) -> tuple[complex, complex]:
    """Transmitted and environment's impedance of one run [N s/m]."""
    path = folder / "palpation.mcap"
    seconds = rig.SETTLE + rig.PERIODS / HZ
    runner.run(rig.config_of(law, HZ, stiffness), seconds, seed, "lockstep", path).enabled()
    y, u = (x.mean(0) for x in rig.cut(path, HZ).spectra(1))
    # y = (f_m, -v_s), u = (v_m, f_s)
    return complex(y[0] / u[0]), complex(-u[1] / y[1])


def differences(rows: Sequence[PalpationRow]) -> dict[str, float]:
    """Two-sided exact Mann-Whitney p of what was asked beforehand, times Holm's factor.

    Every controller against the benchmark, and every force-sensor-free one against its own.
    """
    by = {r.controller: r for r in rows}
    pairs = [(by[n], by[MEASURE]) for n in by if n != MEASURE]
    pairs += [(by[n], by[n + FREE_FORM]) for n in by if n + FREE_FORM in by]
    raw = [
        float(stats.mannwhitneyu(a.measured, b.measured, method="exact").pvalue) for a, b in pairs
    ]
    out, least = {}, 0.0
    for rank, k in enumerate(np.argsort(raw)):
        a, b = pairs[int(k)]
        least = max(least, min(1.0, raw[int(k)] * (len(pairs) - rank)))
        out[f"{a.controller} / {b.controller}"] = least
    return out
