"""A session: the same bytes for a seed, the right channels, honest counts."""

import dataclasses
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.errors import ConfigError, DeviceError
from hil.record.container import read
from hil.record.mcap_read import load, summary
from hil.rig.config import load_rig
from hil.rig.open import open_rig
from hil.runtime.board import Ring
from hil.runtime.clock import MonotonicClock, VirtualClock
from hil.runtime.loop import Loop
from hil.runtime.runner import Operator, run_session
from hil.signals.frame import FrameLayout

RIGS = Path(__file__).parents[2] / "rigs"
ALL = sorted(p.name for p in RIGS.glob("*.toml"))


def record(path, rig="teleop.toml", seconds=0.3, seed=7, over=None, **options):
    run_session(load_rig(RIGS / rig, over), seconds, seed, output=path, **options)
    return path


@pytest.mark.parametrize("rig", ALL)
def test_two_sessions_of_a_seed_are_the_same_bytes(rig, tmp_path):
    a, b = (record(tmp_path / f"{n}.mcap", rig, seed=1) for n in "ab")
    c = record(tmp_path / "c.mcap", rig, seed=2)
    assert a.read_bytes() == b.read_bytes()
    assert a.read_bytes() != c.read_bytes()


@pytest.mark.slow
def test_a_fresh_process_writes_the_same_bytes(tmp_path):
    here = record(tmp_path / "here.mcap", seed=5)
    words = ["run", str(RIGS / "teleop.toml"), "--seed", "5", "--seconds", "0.3"]
    words += ["--clock", "lockstep", "-o", str(tmp_path / "there.mcap")]
    subprocess.run([sys.executable, "-m", "hil.cli", *words], check=True, capture_output=True)
    assert here.read_bytes() == (tmp_path / "there.mcap").read_bytes()


def test_channels_rates_and_metadata(tmp_path):
    found = summary(record(tmp_path / "s.mcap"))
    rates = {c.topic: (c.count, c.missing, round(c.rate_hz)) for c in found.channels}
    arms = [
        f"/{a}/{c}"
        for a in ("leader", "follower")
        for c in ("measured_js", "setpoint_jf", "measured_cf")
    ]
    for topic in (*arms, "/rig/raw", "/loop/timing"):
        assert rates[topic] == (300, 0, 1000)
    assert rates["/controller/state"] == (30, 0, 100)
    assert rates["/events"][0] == 3
    assert found.metadata["session"]["seed"] == "7"
    assert found.metadata["robot/leader"]["preset"] == "phantom-premium-1.5"
    assert json.loads(found.metadata["robot/leader"]["joints"]) == ["joint1", "joint2", "joint3"]
    assert "rig.toml" in found.attachments


def test_the_leaders_force_is_what_the_hand_does_on_it(tmp_path):
    recording = load(record(tmp_path / "s.mcap", seconds=3.0), "leader")
    follower = load(tmp_path / "s.mcap", "follower")
    assert recording.t[0] == pytest.approx(1e-3)
    assert np.abs(recording.q - recording.q[0]).max() > 0.02
    assert np.abs(recording.q - follower.q).max() < 0.06
    assert recording.wrench is not None
    assert recording.wrench[:, :3].std() > 0.02


def test_the_gel_pushes_the_follower_up(tmp_path):
    over = {"simulation": {"gel": {"below_home": -0.003}}}
    path = record(tmp_path / "s.mcap", seconds=0.5, over=over)
    assert load(path, "follower").wrench[-1, 2] > 0.05


def test_trajectory_noise_and_hidden_effect_have_seeds_of_their_own(tmp_path):
    def sent(name, seed, motion, hidden):
        secret = {"hidden_seed": hidden, "hidden": [{"effect": "random"}]}
        over = {"controller": {"parameters": {"seed": motion}}, "simulation": secret}
        path = record(tmp_path / name, "identify.toml", 1.5, seed, over)
        return load(path, "follower").tau

    base, noise = sent("a", 1, 1, 1), sent("b", 2, 1, 1)
    motion, hidden = sent("c", 1, 2, 1), sent("d", 1, 1, 2)
    small = np.abs(noise - base).max()
    assert 0 < small < np.abs(motion - base).max()
    assert small < np.abs(hidden - base).max()


@pytest.mark.real_time
def test_real_clock_runs_and_counts(tmp_path):
    config = load_rig(RIGS / "identify.toml")
    done = run_session(config, 0.2, seed=1, clock="real", output=tmp_path / "s.mcap")
    assert done.ticks + done.missed >= 200
    assert done.dropped == 0
    assert done.longest_tick_us > 0
    assert load(tmp_path / "s.mcap", "leader").n == done.ticks


@pytest.mark.real_time
def test_progress_and_live_figures_come_while_the_loop_runs(tmp_path):
    done, said = [], []
    operator = Operator(live=said.append)
    config = load_rig(RIGS / "teleop.toml", {"loop": {"realtime": False}})
    found = run_session(
        config,
        0.6,
        clock="real",
        output=tmp_path / "s.mcap",
        progress=done.append,
        operator=operator,
    )
    assert len(done) >= 3 and sum(done) == found.ticks + found.missed
    assert 2 <= len(said) <= 4 and all("ENABLED" in s and "late p50" in s for s in said)


def test_a_runaway_stops_the_session_and_keeps_the_record(tmp_path):
    over = {"arms": {"leader": {"speed_limit": [0.01, 0.01, 0.01]}}}
    with pytest.raises(DeviceError, match="FAULT"):
        record(tmp_path / "s.mcap", "identify.toml", 2.0, 1, over)
    assert 0 < load(tmp_path / "s.mcap", "leader").n < 2000


def test_hardware_that_is_not_there_is_one_sentence(tmp_path, capsys):
    rig = tmp_path / "usb.toml"
    rig.write_text((RIGS / "teleop.toml").read_text().replace('backend = "sim"', 'backend = "usb"'))
    assert main(["run", str(rig), "-o", str(tmp_path / "s.mcap")]) == 3
    said = capsys.readouterr().err
    assert "USB-QUAD08" in said
    assert not (tmp_path / "s.mcap").exists()
    assert main(["devices", str(rig)]) == 3
    assert main(["devices", str(RIGS / "teleop.toml"), "--json"]) == 0


def test_json_stands_alone_on_stdout(tmp_path, capsys):
    words = ["run", str(RIGS / "teleop.toml"), "-o", str(tmp_path / "s.mcap"), "--seconds", "0.05"]
    assert main([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["ticks"] == 50
    assert main(words) == 0
    assert "missed deadlines" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"t,q1,tau1\n0,0,0\n", "model M.toml cannot be read"),
        (bytes(range(256)), "model M.toml cannot be read"),
        (b'schema = "hil.rig/1"\n', "schema is 'hil.rig/1', expected 'hil.model/1'"),
        (b'schema = "hil.model/1"\nrobot.arm = "lead"\n', "unknown arm of the rig 'lead'"),
        (
            b'schema = "hil.model/1"\nrobot.preset = "phantom-omni"\n',
            "is of phantom-omni, the rig 'identify' has phantom-premium-1.5 with joint1",
        ),
        (
            b'schema = "hil.model/1"\n[[effects]]\ntype = "coulomb"\njoints = ["elbow"]\n',
            "is of a robot with elbow, the rig 'identify' has",
        ),
    ],
)
def test_what_is_no_model_of_the_rig_is_not_attached(tmp_path, monkeypatch, capsys, text, said):
    monkeypatch.chdir(tmp_path)
    Path("M.toml").write_bytes(text)
    words = ["run", "identify", "--seconds", "0.01", "--clock", "lockstep", "-o", "s.mcap"]
    assert main([*words, "--model", "M.toml"]) == 2
    error = capsys.readouterr().err
    assert said in error and error.count("\n") == 1
    assert not Path("s.mcap").exists()


@pytest.mark.parametrize("robot", ['preset = "phantom-premium-1.5"\narm = "follower"', ""])
def test_a_model_of_the_rig_is_attached_as_it_stands(tmp_path, monkeypatch, robot):
    monkeypatch.chdir(tmp_path)
    text = f'schema = "hil.model/1"\n[robot]\n{robot}\n'
    Path("M.toml").write_text(text)
    words = ["run", "identify", "--seconds", "0.01", "--clock", "lockstep", "-o", "s.mcap"]
    assert main([*words, "--model", "M.toml"]) == 0
    assert read(Path("s.mcap")).attachments["model.toml"].decode() == text


def test_a_missing_folder_is_one_sentence(tmp_path):
    with pytest.raises(ConfigError, match="cannot write"):
        record(tmp_path / "no" / "s.mcap")


def test_the_hot_path_keeps_no_memory(memory_growth):
    config = load_rig(RIGS / "teleop.toml")
    rig = open_rig(config, 0)
    layout = FrameLayout(2, len(rig.controller.state_names))
    ring = Ring(100, layout.width)
    loop = Loop(
        rig.ports, rig.controller, VirtualClock(1_000_000), ring, layout, 1_000_000, rig.origin_ns
    )
    loop.rehearse()
    rig.enable()
    grown = memory_growth(loop.step)
    assert grown < 4096
    assert ring.dropped == 500
    rig.close()


def test_late_ticks_are_skipped_not_caught_up():
    clock = MonotonicClock(1_000_000)
    clock.start()
    while clock.since_start() < 5_200_000:
        pass
    tick = clock.wait(1)
    assert tick >= 5
    assert clock.missed == tick - 1


def test_ring_keeps_order_and_counts_what_it_drops():
    ring = Ring(4, 2)
    for k in range(6):
        ring.push(k, 10 * k, np.array([k, -k], float))
    stamps, data = ring.take()
    assert stamps[:, 0].tolist() == [0, 1, 2, 3]
    assert data[:, 1].tolist() == [0, -1, -2, -3]
    assert ring.dropped == 2
    ring.push(9, 90, np.array([9.0, 9.0]))
    assert ring.take()[0].tolist() == [[9, 90]]


def test_summary_is_plain_data(tmp_path):
    done = run_session(load_rig(RIGS / "teleop.toml"), 0.02, output=tmp_path / "s.mcap")
    assert set(done.as_dict()) == {"schema", *(f.name for f in dataclasses.fields(done))}


def test_a_session_at_the_same_place_is_kept(tmp_path, capsys):
    from hil.outputs import keep_old

    path = tmp_path / "s.mcap"
    for text in ("first", "second"):
        keep_old(path)
        path.write_text(text)
    keep_old(path)
    assert not path.exists()
    assert (tmp_path / "s.1.mcap").read_text() == "first"
    assert (tmp_path / "s.2.mcap").read_text() == "second"
    assert "kept as" in capsys.readouterr().err
