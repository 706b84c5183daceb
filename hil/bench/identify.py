"""`hil bench identify`: how long identification and diagnosis take, beside peers, in one run.

A three-joint arm, 60 s at 1 kHz, 42 parameters; once complete, once with a Stribeck effect that
the fitted models lack.  Times are processor seconds on one thread (on an idle core: wall clock),
medians after a warm-up; peers take turns, so that a busy machine slows all of them alike.  Longer
recordings are diagnosed as a user would, by the wall clock and with both threads.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from hil import outputs, terminal
from hil.diagnosis.verbs import fit
from hil.errors import ConfigError
from hil.identify.result import FitResult
from hil.models.model import base_model
from hil.record.export import write_recordings
from hil.record.recording import Recording, RobotSource
from hil.revision import machine
from hil.terminal import Found
from hil.userfile import write_text

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class BenchArm:
    """An arm of d revolute joints of which the sessions are calculated.

    Parameters
    ----------
    joints : tuple of str
        Names.
    links : tuple
        Axis, offset from the joint before [m], link length [m] and mass [kg] of each.
    fc, fv, ia, t0 : ndarray (d,)
        Coulomb [N m], viscous [N m s/rad], rotor inertia [kg m^2], offset [N m] of each joint.
    """

    joints: tuple[str, ...]
    links: tuple[tuple[str, float, float, float], ...]
    fc: FloatArray
    fv: FloatArray
    ia: FloatArray
    t0: FloatArray

    def urdf(self) -> str:
        """Description with the masses that the sessions have."""
        links, joints, parent = ['<link name="world"/>'], [], "world"
        for name, (axis, at, length, mass) in zip(self.joints, self.links, strict=True):
            i = mass * max(length, 0.06) ** 2 / 12
            links.append(
                f'<link name="{name}_link"><inertial><origin xyz="{length / 2 + 0.01} 0.004 '
                f'0.006"/><mass value="{mass}"/><inertia ixx="{0.3 * i}" iyy="{i}" izz="{1.05 * i}"'
                f' ixy="{0.05 * i}" ixz="{-0.03 * i}" iyz="{0.02 * i}"/></inertial></link>'
            )
            joints.append(
                f'<joint name="{name}" type="revolute"><origin xyz="{at} 0 0"/>'
                f'<parent link="{parent}"/><child link="{name}_link"/><axis xyz="{axis}"/>'
                '<limit lower="-3" upper="3" effort="9" velocity="30"/></joint>'
            )
            parent = f"{name}_link"
        return f'<robot name="bench-arm">{"".join(links + joints)}</robot>'


#: Shoulder about z, then two pitch joints; 0.215 m upper arm.
THREE_JOINT_ARM = BenchArm(
    ("base", "upper", "fore"),
    (("0 0 1", 0.0, 0.0, 0.30), ("0 1 0", 0.0, 0.215, 0.18), ("0 1 0", 0.215, 0.17, 0.11)),
    np.array([0.040, 0.035, 0.025]),
    np.array([0.008, 0.007, 0.004]),
    np.array([2.0e-4, 1.5e-4, 0.8e-4]),
    np.array([0.010, -0.008, 0.005]),
)
#: Four more joints of the kind of the last ones, rolling and bending in turn.
SEVEN = BenchArm(
    (*THREE_JOINT_ARM.joints, "roll", "bend", "turn", "hand"),
    (
        *THREE_JOINT_ARM.links,
        ("1 0 0", 0.17, 0.05, 0.09),
        ("0 1 0", 0.05, 0.12, 0.08),
        ("1 0 0", 0.12, 0.04, 0.06),
        ("0 1 0", 0.04, 0.08, 0.05),
    ),
    np.append(THREE_JOINT_ARM.fc, [0.020, 0.018, 0.014, 0.012]),
    np.append(THREE_JOINT_ARM.fv, [0.003, 0.003, 0.002, 0.002]),
    np.append(THREE_JOINT_ARM.ia, [0.6e-4, 0.5e-4, 0.4e-4, 0.3e-4]),
    np.append(THREE_JOINT_ARM.t0, [0.004, -0.004, 0.003, -0.002]),
)
#: By their number of joints.
ARMS = {3: THREE_JOINT_ARM, 7: SEVEN}
#: White noise of the effort [N m]: what no model explains.
_NOISE = 0.005
#: The effect that is missing: share of Coulomb friction, and its speed [rad/s].
PEAK, _SPEED = 0.5, 0.15
_RATE, _HARMONICS, _FUNDAMENTAL = 1000.0, 12, 0.1


@dataclass(frozen=True)
class BenchData:
    """One run, exact motion included: t (n,), the others (n, d)."""

    t: FloatArray
    q: FloatArray
    qd: FloatArray
    qdd: FloatArray
    tau: FloatArray

    def recording(self, name: str, arm: BenchArm = THREE_JOINT_ARM) -> Recording:
        """What a rig would have recorded of it: positions and efforts."""
        robot = RobotSource("", arm.urdf())
        return Recording(name, "arm", arm.joints, self.t, self.q, self.tau, robot=robot)


def fourier_motion(
    t: FloatArray, seed: int, d: int = 3
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position, velocity and acceleration (n, d) of a Fourier series of 12 harmonics."""
    rng = np.random.default_rng(seed)
    k = np.arange(1, _HARMONICS + 1)
    w = 2 * np.pi * _FUNDAMENTAL * k
    size = rng.uniform(0.5, 1.0, (d, _HARMONICS)) * 0.45 / np.sqrt(k)
    phase = rng.uniform(0, 2 * np.pi, (d, _HARMONICS))
    angle = t[:, None] * w
    s, c = np.sin(angle), np.cos(angle)
    # a sin(w t + p) = a cos p sin w t + a sin p cos w t
    a, b = (size * np.cos(phase)).T, (size * np.sin(phase)).T
    q = s @ a + c @ b
    qd = (c * w) @ a - (s * w) @ b
    qdd = -(s * w**2) @ a - (c * w**2) @ b
    return q, qd, qdd


def simulate_run(
    seconds: float, seed: int, stribeck: bool, arm: BenchArm = THREE_JOINT_ARM
) -> BenchData:
    """Exact motion and noisy effort of one run; `stribeck` adds the missing effect."""
    import pinocchio as pin

    t = np.arange(round(seconds * _RATE)) / _RATE
    q, qd, qdd = fourier_motion(t, seed, len(arm.joints))
    model = pin.buildModelFromXML(arm.urdf())
    data = model.createData()
    tau = np.empty_like(q)
    for k in range(t.size):
        tau[k] = pin.rnea(model, data, q[k], qd[k], qdd[k])
    friction = arm.fc * (1.0 + stribeck * PEAK * np.exp(-((qd / _SPEED) ** 2)))
    tau += friction * np.sign(qd) + arm.fv * qd + arm.ia * qdd + arm.t0
    tau += _NOISE * np.random.default_rng(seed + 1000).standard_normal(tau.shape)
    return BenchData(t, q, qd, qdd, tau)


#: Eigenvalues of the scaled normal equations below this share of the largest are rounding.
_RANK = 1e-12
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def _reference_regressor(data: BenchData) -> FloatArray:
    """Regressor (n, 3, 42) at every sample: bodies, rotor inertia, Coulomb, viscous, offset."""
    import pinocchio as pin

    model = pin.buildModelFromXML(THREE_JOINT_ARM.urdf())
    work = model.createData()
    n, d = data.q.shape
    x = np.zeros((n, d, 10 * d + 4 * d))
    for k in range(n):
        x[k, :, : 10 * d] = pin.computeJointTorqueRegressor(
            model, work, data.q[k], data.qd[k], data.qdd[k]
        )
    for j in range(d):
        first = 10 * d + 4 * j
        x[:, j, first] = data.qdd[:, j]
        x[:, j, first + 1] = np.sign(data.qd[:, j])
        x[:, j, first + 2] = data.qd[:, j]
        x[:, j, first + 3] = 1.0
    return x


def _reference_fit(data: BenchData) -> FloatArray:
    """All 42 parameters by normal equations at the full rate, from the exact motion."""
    x = _reference_regressor(data).reshape(data.tau.size, -1)
    gram, right = x.T @ x, x.T @ data.tau.reshape(-1)
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    value, vector = np.linalg.eigh(gram / np.outer(scale, scale))
    keep = value > _RANK * value[-1]
    theta: FloatArray = vector[:, keep] @ ((vector[:, keep].T @ (right / scale)) / value[keep])
    return theta / scale


def _heldout_of_reference(theta: FloatArray, test: BenchData) -> FloatArray:
    """Rms error (3,) on another run at the full rate [N m]."""
    return rms(test.tau - _reference_regressor(test) @ theta)


def _heldout_of_fit(result: FitResult, test: BenchData) -> FloatArray:
    """The same of a fitted model of hil."""
    nothing = np.zeros_like(test.q)
    motion = replace(
        result.problem.motions[0],
        t=test.t,
        q=test.q,
        qd=test.qd,
        qdd=test.qdd,
        tau=test.tau,
        tau_ext=nothing,
        load=nothing,
        static=nothing,
        average=0.0,
    )
    effort = np.zeros_like(test.tau)
    for term, where in zip(result.terms, result.slices, strict=True):
        part = term.effect.columns(motion, term.joint, term.shape) @ result.theta[where]
        if term.effect.scope.whole:
            effort += part
        else:
            effort[:, term.joint] += part
    return rms(test.tau - effort)


def rms(x: FloatArray) -> FloatArray:
    """Root mean square of each column."""
    out: FloatArray = np.sqrt(np.mean(x**2, axis=0))
    return out


def _timed(call: Callable[[], Any]) -> tuple[float, float]:
    """Processor time and wall clock of a call [s]."""
    start, clock = time.process_time(), time.perf_counter()
    call()
    return time.process_time() - start, time.perf_counter() - clock


def _child_process(
    words: list[str], python: str = sys.executable, limits: dict[str, str] = _ONE_THREAD
) -> dict[str, Any]:
    """Result of a script in a process of its own.

    Parameters
    ----------
    words : list of str
        What the interpreter is given.
    python : str
        The interpreter.
    limits : dict of str
        Environment variables that say how many threads it may have; one, if not given.

    Raises
    ------
    ConfigError
        If it fails.
    """
    environment = {**os.environ, **limits}
    done = subprocess.run(
        [python, *words], capture_output=True, text=True, env=environment, check=False
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise ConfigError(f"{Path(words[0]).name} ended with code {done.returncode}: {last}")
    out: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return out


def _run_figaroh(folder: Path, repeats: int, python: str) -> dict[str, Any] | str:
    """FIGAROH on train.npz and test.npz in a folder, or why it could not run."""
    if not python and importlib.util.find_spec("figaroh") is None:
        return "not installed (pip install 'hil-teleop[bench]', or --figaroh PYTHON)"
    script = str(Path(__file__).with_name("figaroh_peer.py"))
    try:
        return _child_process([script, str(folder), str(repeats)], python or sys.executable)
    except (ConfigError, OSError) as error:
        return f"did not run: {error}"


_LENGTHS = (60, 120, 300, 600)
REFERENCE = "numpy + Pinocchio (reference)"
#: What the data sets are called, by whether there is an effect that the model lacks.
DATA = {False: "complete", True: "Stribeck missing"}


@dataclass(frozen=True)
class IdentifyRow:
    """One peer on one data set.

    Parameters
    ----------
    peer, data : str
        Who, on which data.
    seconds, wall : float
        Medians of processor time and wall clock [s]; NaN where it did not run.
    ratio : float
        Seconds over the reference's of the same run.
    floor : tuple of float
        Held-out rms error over the noise floor, joint by joint.
    note : str
        What else there is to say.
    """

    peer: str
    data: str
    seconds: float
    wall: float
    ratio: float
    floor: tuple[float, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class Length:
    """One diagnosis of a longer recording in its own process."""

    recorded: float
    seconds: float
    wall: float
    peak_mib: float
    verdict: str
    data: str
    joints: int = 3


@dataclass(frozen=True)
class Report:
    """All rows of one run of the benchmark."""

    recorded: float
    repeats: int
    rows: list[IdentifyRow]
    lengths: list[Length]


def run_benchmark(
    seconds: float = 60.0,
    repeats: int = 3,
    lengths: Sequence[float] = _LENGTHS,
    figaroh: str = "",
    report: Callable[[str], None] | None = None,
) -> Report:
    """Measure everything.

    Parameters
    ----------
    seconds : float
        Length of the common problem.
    repeats : int
        Repeats after the warm-up.
    lengths : sequence of float
        Recordings for growth and peak memory [s].
    figaroh : str
        Interpreter of an environment with FIGAROH; empty: this one.
    report : callable, optional
        Told what is measured now.
    """
    tell = report or (lambda _: None)
    rows: list[IdentifyRow] = []
    with tempfile.TemporaryDirectory() as name, threadpool_limits(limits=1):
        folder = Path(name)
        for stribeck, data in DATA.items():
            tell(data)
            train, test = (simulate_run(seconds, seed, stribeck) for seed in (1, 2))
            own = _in_process(train, test, data, repeats)
            own.append(_figaroh(folder, train, test, data, repeats, figaroh, own[0].seconds))
            own += _diagnoses(folder, train, test, data, repeats, own[0].seconds)
            rows += own
        grown = []
        jobs = [(x, True, 3) for x in lengths] + [(x, False, 3) for x in lengths[-1:]]
        # more joints beside the same length of fewer
        jobs += [(seconds, missing, d) for d in ARMS for missing in DATA if lengths]
        for length, missing, d in dict.fromkeys(jobs):
            tell(f"{length:g} s, {d} joints, {DATA[missing]}")
            grown.append(_length(folder, length, missing, ARMS[d]))
    return Report(seconds, repeats, rows, grown)


def _in_process(train: BenchData, test: BenchData, data: str, repeats: int) -> list[IdentifyRow]:
    """Reference and `hil.fit`, taking turns."""
    recording = train.recording("train")
    model = base_model(recording.robot)
    calls: dict[str, Callable[[], Any]] = {
        REFERENCE: lambda: _reference_fit(train),
        # a recording keeps what was found in it: each fit gets one that no other has looked at
        "hil.fit": lambda: fit([replace(recording)], model),
    }
    times: dict[str, list[tuple[float, float]]] = {k: [] for k in calls}
    for _ in range(1 + repeats):
        for peer, call in calls.items():
            times[peer].append(_timed(call))
    errors = {
        REFERENCE: _heldout_of_reference(_reference_fit(train), test),
        "hil.fit": _heldout_of_fit(fit([recording], model), test),
    }
    cpu, wall = ({k: median(x[c] for x in t[1:]) for k, t in times.items()} for c in (0, 1))
    return [
        IdentifyRow(k, data, cpu[k], wall[k], cpu[k] / cpu[REFERENCE], tuple(errors[k] / _NOISE))
        for k in calls
    ]


def _figaroh(
    folder: Path,
    train: BenchData,
    test: BenchData,
    data: str,
    repeats: int,
    python: str,
    reference: float,
) -> IdentifyRow:
    (folder / "arm.urdf").write_text(THREE_JOINT_ARM.urdf(), encoding="utf-8")
    np.savez(folder / "train.npz", **vars(train))
    np.savez(folder / "test.npz", **vars(test))
    found = _run_figaroh(folder, repeats, python)
    if isinstance(found, str):
        return IdentifyRow("FIGAROH", data, np.nan, np.nan, np.nan, (), found)
    cpu, wall = median(found["seconds"]), median(found["wall"])
    ratio = tuple(float(x) / _NOISE for x in found["rms"])
    note = f"and {found['import']:.1f} s to import"
    return IdentifyRow(f"FIGAROH {found['version']}", data, cpu, wall, cpu / reference, ratio, note)


def _diagnoses(
    folder: Path, train: BenchData, test: BenchData, data: str, repeats: int, reference: float
) -> list[IdentifyRow]:
    """From the file to the report, judged on fifths of the recording or on the other one."""
    paths = [str(folder / f"{name}.mcap") for name in ("train", "test")]
    for path, run_ in zip(paths, (train, test), strict=True):
        write_recordings(path, [run_.recording(Path(path).stem)])
    rows = []
    for peer, used in (("hil diagnose", paths[:1]), ("hil diagnose --holdout", paths)):
        found = _oneshot(folder, repeats, used)
        cpu, wall = median(found["seconds"]), median(found["wall"])
        note = f"{found['candidates']} candidates, {found['rungs']} models: {found['verdict']}"
        rows.append(
            IdentifyRow(peer, data, cpu, wall, cpu / reference, tuple(found["ratio"]), note)
        )
    return rows


def _oneshot(
    folder: Path, repeats: int, paths: list[str], limits: dict[str, str] = _ONE_THREAD
) -> dict[str, Any]:
    words = ["-m", "hil.bench.diagnose_once", str(repeats), str(folder / "report.html"), *paths]
    return _child_process(words, limits=limits)


def _length(
    folder: Path, seconds: float, stribeck: bool, arm: BenchArm = THREE_JOINT_ARM
) -> Length:
    """One diagnosis of a recording, with the missing effect or without: time and peak memory."""
    path = str(folder / "long.mcap")
    write_recordings(path, [simulate_run(seconds, 1, stribeck, arm).recording("long", arm)])
    # a long recording gets as many threads as a user's would
    found = _oneshot(folder, 0, [path], {"OPENBLAS_NUM_THREADS": "1"})
    times, peak = (found["seconds"][0], found["wall"][0]), found["peak"] / 2**20
    return Length(seconds, *times, peak, found["verdict"], DATA[stribeck], len(arm.joints))


# ------------------------------------------------------------ tables and page

COMMAND = "hil bench identify"
_TITLE = "# Speed of identification and diagnosis"
#: Most that a peer may take, in units of the reference, without and with the missing effect.
GOALS = (
    ("hil.fit", False, 0.8),
    ("hil.fit", True, 0.8),
    ("hil diagnose", False, 6.0),
    ("hil diagnose", True, 15.0),
)
#: Most memory of the longest recording [MiB].
PEAK_MIB = 1024.0
#: Most processor time of seven joints, in units of that of three on the same length.
SEVEN_OVER_THREE = 3.0


def text(r: Report) -> str:
    """Both tables with what they were measured on."""
    lines = [
        f"3 joints, {r.recorded:g} s at 1 kHz, 42 parameters, on a {machine()}",
        f"processor seconds on one thread, median of {r.repeats} after a warm-up; ratio to the "
        "reference of the same run",
        "",
        _peers(r),
        "",
        "held-out / floor: rms error on the second motion, at 1 kHz, over the effort's noise of "
        "5 mN m;\nof hil diagnose: in its own band, over the floor that it measured itself. The "
        "reference and\nFIGAROH get the exact motion, hil only positions.",
    ]
    if r.lengths:
        lines += [
            "",
            "hil diagnose, one cold run each in a process of its own, as a user runs it",
            "",
            _lengths(r),
        ]
    return "\n".join(lines)


def _peers(r: Report) -> str:
    """Times of all peers on the same data."""
    rows = [
        [
            row.peer,
            row.data,
            _number(row.seconds),
            _number(row.ratio),
            " ".join(f"{x:.3f}" for x in row.floor) or "-",
            row.note,
        ]
        for row in r.rows
    ]
    return terminal.table(["peer", "data", "seconds", "ratio", "held-out / floor", ""], rows)


def _lengths(r: Report) -> str:
    """Time and memory of the diagnosis over the length of the recording."""
    grown = [
        [
            f"{x.joints}",
            f"{x.recorded:g}",
            x.data,
            f"{x.wall:.2f}",
            f"{x.seconds:.2f}",
            f"{x.peak_mib:.0f}",
            f"{1e3 * x.wall / x.recorded:.0f}",
            x.verdict,
        ]
        for x in r.lengths
    ]
    names = [
        "joints",
        "recorded s",
        "data",
        "wall s",
        "processor s",
        "peak MiB",
        "wall ms per s",
        "verdict",
    ]
    return terminal.table(names, grown)


def _number(x: float) -> str:
    return "-" if math.isnan(x) else f"{x:.2f}"


def report_data(r: Report) -> dict[str, Any]:
    """The same as JSON; what did not run is null."""
    rows: list[dict[str, Any]] = [asdict(row) for row in r.rows]
    for row in rows:
        for key in ("seconds", "wall", "ratio"):
            row[key] = None if math.isnan(row[key]) else row[key]
    return {
        "machine": machine(),
        "recorded_s": r.recorded,
        "repeats": r.repeats,
        "rows": rows,
        "lengths": [asdict(x) for x in r.lengths],
    }


def page(r: Report) -> str:
    """Markdown page with the printed result."""
    return (
        f"{_TITLE}\n\n"
        f"Printed by `{COMMAND} --figaroh PYTHON --report docs/bench/identify.md`, where\n"
        "PYTHON is an interpreter that has `figaroh` (the extra `bench`). It measures speed: the\n"
        "data come from the same rigid-body equations that are fitted.\n\n"
        f"```\n{text(r)}\n```\n\n"
        f"{goals(r)}\n"
    )


def goals(r: Report) -> str:
    """Which goals hold in this run, a line each."""
    ratios = {(row.peer, row.data): row.ratio for row in r.rows}
    found = [
        (f"{peer}, {DATA[missing]}", ratios.get((peer, DATA[missing]), float("nan")), most)
        for peer, missing, most in GOALS
    ]
    rows = [
        f"- {what}: {ratio:.2f} times the reference, goal {most:g}" for what, ratio, most in found
    ]
    met = [ratio <= most for _, ratio, most in found]
    if r.lengths:
        longest = max(r.lengths, key=lambda x: (x.recorded, x.peak_mib))
        rows.append(f"- {longest.recorded:g} s: {longest.peak_mib:.0f} MiB, goal {PEAK_MIB:g}")
        met.append(longest.peak_mib <= PEAK_MIB)
    for missing in DATA:
        same = {
            x.joints: x.seconds
            for x in r.lengths
            if (x.recorded, x.data) == (r.recorded, DATA[missing])
        }
        if same.keys() >= ARMS.keys():
            ratio = same[7] / same[3]
            goal = f"goal {SEVEN_OVER_THREE:g}"
            rows.append(f"- seven joints, {DATA[missing]}: {ratio:.2f} times three, {goal}")
            met.append(ratio <= SEVEN_OVER_THREE)
    said = (f"{row}: {'met' if ok else 'missed'}" for row, ok in zip(rows, met, strict=True))
    return "Goals:\n\n" + "\n".join(said)


def is_page(path: Path) -> bool:
    """Whether a file is such a page, or empty."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False
    return not text.strip() or text.startswith(_TITLE)


def command(args: argparse.Namespace) -> Found:
    """How long identification and diagnosis take, beside peers."""
    outputs.check(args.report, ".md", (), is_page, "a page of this benchmark")
    report = run_benchmark(
        figaroh=args.figaroh, report=lambda what: terminal.log(f"measuring {what}")
    )
    if args.report:
        with outputs.writing(args.report):
            write_text(args.report, page(report))
    return text(report), report_data(report)
