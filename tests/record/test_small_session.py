"""A committed session: read by this package, by the official one, and by @mcap/core where it is."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from hil.record.mcap_read import load_arms, summary
from hil.replay import replay

SMALL = Path(__file__).with_name("small.mcap")


def test_it_reads_as_it_was_written():
    leader, follower = load_arms(SMALL)
    assert (leader.n, follower.n) == (200, 200)
    assert summary(SMALL).metadata["session"]["seed"] == "3"
    assert {c.topic: c.missing for c in summary(SMALL).channels}["/controller/state"] == 0


def test_the_official_reader_sees_named_scalars_with_units():
    with SMALL.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()], validate_crcs=True)
        rows = list(reader.iter_decoded_messages(topics=["/loop/timing"]))
    assert len(rows) == 200
    assert rows[-1][3].state == 1.0 and rows[-1][3].winding > 20
    assert b"winding  # [degC]" in rows[0][0].data


def test_its_commands_are_reproduced():
    # another processor's libm may differ in the last bit: then it must say where
    found = replay(SMALL)
    assert found.compared == 200
    assert found.differ == 0 or found.first is not None


NODE = os.environ.get("MCAP_NODE_MODULES", "")


@pytest.mark.skipif(not (NODE and shutil.which("node")), reason="needs MCAP_NODE_MODULES and node")
def test_mcap_core_reads_it(tmp_path):
    script = tmp_path / "read.mjs"
    script.write_text(SMALL.with_name("read_session.mjs").read_text())
    (tmp_path / "node_modules").symlink_to(NODE)
    said = subprocess.run(
        ["node", script, SMALL], capture_output=True, text=True, check=True
    ).stdout
    counts, state, timing = (json.loads(line) for line in said.splitlines())
    assert counts["/leader/measured_js"] == 200 and timing["state"] == 1
    assert state["name"] == ["joint1", "joint2", "joint3"]
