"""Recordings and tables that the tests of this folder make."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from hil.record.recording import Recording

URDF = """<robot name="two"><link name="base"/><link name="upper"/><link name="fore"/>
<link name="hand"/><link name="tip"/><link name="idle"/>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="9"/></joint>
<joint name="copy" type="revolute"><parent link="base"/><child link="idle"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="9" velocity="9"/>
<mimic joint="elbow"/></joint>
<joint name="wrist" type="fixed"><parent link="fore"/><child link="hand"/></joint>
<joint name="end" type="fixed"><parent link="hand"/><child link="tip"/></joint></robot>"""

needs_data = pytest.mark.skipif(
    not os.environ.get("HIL_DATA"), reason="HIL_DATA (folder of the public recordings) is not set"
)


def columns(r: Recording) -> dict[str, np.ndarray]:
    """Table of a recording by the default column names."""
    out = {"t": r.t}
    for stem, values in (("q", r.q), ("qd", r.qd), ("tau", r.tau), ("tauext", r.tau_ext)):
        for k in range(0 if values is None else r.d):
            out[f"{stem}{k + 1}"] = values[:, k]
    return out


def write_csv(path: Path, table: dict[str, np.ndarray], delimiter: str = ",") -> Path:
    """Table with a header row."""
    rows = zip(*(v.tolist() for v in table.values()), strict=True)
    text = [delimiter.join(table), *(delimiter.join(map(repr, row)) for row in rows)]
    path.write_text("\n".join(text) + "\n")
    return path
