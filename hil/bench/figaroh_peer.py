"""FIGAROH on the speed benchmark, as a script: it may live in another environment than hil.

    PYTHON figaroh_peer.py FOLDER REPEATS

FOLDER holds arm.urdf, train.npz and test.npz (t, q, qd, qdd, tau); the result is one line of JSON.
FIGAROH gets the exact motion and does not filter it; `solve` decimates by ten, as it does by
default.
"""

import contextlib
import importlib.metadata
import io
import json
import logging
import sys
import time
from pathlib import Path
from typing import Any

began = time.perf_counter()
import numpy as np  # noqa: E402
import pinocchio as pin  # noqa: E402
from figaroh.identification.base_identification import BaseIdentification  # noqa: E402

IMPORT = time.perf_counter() - began
_SIGNALS = {"positions": "q", "velocities": "qd", "accelerations": "qdd", "torques": "tau"}


def load(path: Path) -> dict[str, Any]:
    """One run by FIGAROH's names."""
    with np.load(path) as data:
        return {"timestamps": data["t"], **{k: data[v] for k, v in _SIGNALS.items()}}


class Arm(BaseIdentification):  # type: ignore[misc]
    """The benchmark's arm."""

    folder = Path()

    def load_trajectory_data(self, data_source: str | None = None) -> dict[str, Any]:
        """Training run."""
        return load(self.folder / "train.npz")

    def filter_kinematics_data(self, filter_config: object = None) -> None:
        """Take the motion as it is: it is exact."""
        self.processed_data = dict(self.raw_data)


def configuration(names: list[str]) -> dict[str, Any]:
    """Friction, rotor inertia and offset of every joint beside the rigid bodies."""
    parts = {"friction": True, "actuator_inertia": True, "joint_offset": True}
    ones, none = [1.0] * len(names), [0.0] * len(names)
    return {
        "schema_version": "2.0",
        "robot": {"name": "bench-arm", "properties": {
            "joints": {"active_joints": names},
            "mechanics": {
                "friction_coefficients": {"viscous": none, "static": none},
                "actuator_inertias": none, "joint_offsets": none, "reduction_ratios": ones},
            "coupling": {"has_coupled_wrist": False}}},
        "tasks": {"identification": {
            "type": "dynamic_identification", "enabled": True,
            "problem": {"model_components": parts, "include_external_forces": False},
            "signal_processing": {"sampling_frequency": 1000.0, "cutoff_frequency": 100.0}}},
    }  # fmt: skip


def main(folder: Path, repeats: int) -> dict[str, Any]:
    """Identify once to warm up and `repeats` times on the clock."""
    robot = pin.RobotWrapper.BuildFromURDF(str(folder / "arm.urdf"))
    names = list(robot.model.names)[1:]
    config = folder / "figaroh.yaml"  # YAML reads JSON
    config.write_text(json.dumps(configuration(names)), encoding="utf-8")
    Arm.folder = folder
    seconds, wall = [], []
    for _ in range(1 + repeats):
        start, clock = time.process_time(), time.perf_counter()
        arm = Arm(robot, str(config))
        arm.identif_config.update(act_idxq=range(robot.nq), act_idxv=range(robot.nv))
        arm.initialize()
        arm.solve(plotting=False, save_results=False)
        seconds.append(time.process_time() - start)
        wall.append(time.perf_counter() - clock)
    arm._val_processed_data = test = load(folder / "test.npz")  # noqa: SLF001
    arm._val_num_samples, arm._val_available = len(test["timestamps"]), True  # noqa: SLF001
    joints = arm._compute_validation_metrics()["per_joint"]  # noqa: SLF001
    return {
        "version": importlib.metadata.version("figaroh"),
        "import": IMPORT,
        "seconds": seconds[1:],
        "wall": wall[1:],
        "parameters": len(arm.standard_parameter),
        "base": len(arm.phi_base),
        "rms": [joints[n]["rmse_identified"] for n in names],
    }


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    with contextlib.redirect_stdout(io.StringIO()):
        result = main(Path(sys.argv[1]), int(sys.argv[2]))
    sys.stdout.write(json.dumps(result) + "\n")
