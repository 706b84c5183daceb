"""Encoders as edges: exact when the decoder is fast, wrong in the known ways when it is not."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.errors import ConfigError
from hil.record.schema import read_fields
from hil.rig.config import load_rig
from hil.runtime import runner
from hil.sim_devices.bench import Quadrature, tracks

RIG = Path(__file__).parents[2] / "rigs" / "identify.toml"
MS = 1e-3


def turn(encoder, per_sample, samples=2000, rate=1e3):
    """Evenly so many edges per sample of a decoder of `rate`; true edges, counts, flags."""
    start = 0.37
    encoder.reset(np.array([start]))
    for k in range(1, samples + 1):
        encoder.advance(np.array([start + per_sample * k]), 1.0 / rate)
    return int(np.floor(start + per_sample * samples)), encoder.counts[0], encoder.illegal[0]


def test_the_tracks_run_through_the_gray_code():
    clean = np.zeros(8, bool)
    assert [tracks(x + 0.5, 0.0, clean) for x in range(-4, 6)] == [0, 1, 3, 2] * 2 + [0, 1]


#: Places off the edges themselves, where rounding decides.
PLACES = st.integers(-2400, 2400).map(lambda k: k / 8 + 1 / 16)


@settings(deadline=None)
@given(st.lists(PLACES, max_size=12), st.floats(-0.4, 0.4))
def test_a_fast_decoder_counts_every_edge_forth_and_back(places, phase):
    encoder = Quadrature(1, phase_error=phase)
    encoder.reset(np.array([0.5]))
    for place in places:
        encoder.advance(np.array([place]), MS)
    end = np.floor(places[-1]) if places else 0
    assert encoder.illegal[0] == 0
    # a displaced track moves an edge by less than one count
    assert abs(encoder.counts[0] - end) <= (1 if phase else 0)


@pytest.mark.parametrize("speed", [0.3, 0.99, -0.8])
def test_up_to_one_edge_a_sample_nothing_is_lost(speed):
    true, counted, flags = turn(Quadrature(1, decoder_hz=1e3), speed)
    assert counted == true
    assert flags == 0


def test_between_one_and_three_edges_a_sample_counts_are_lost_with_flags():
    true, counted, flags = turn(Quadrature(1, decoder_hz=1e3), 1.5)
    # every other sample sees two edges at once (thesis rig's rate: 2000 lost, 1000 flags)
    assert true - counted == pytest.approx(2000, abs=3)
    assert flags == pytest.approx(1000, abs=2)


def test_three_edges_a_sample_count_backwards_without_a_flag():
    true, counted, flags = turn(Quadrature(1, decoder_hz=1e3), 3.0)
    assert true == 6000
    assert counted == pytest.approx(-2000, abs=2)
    assert flags == 0


@pytest.mark.parametrize("way", [1, -1])
def test_a_dirty_line_loses_four_counts_a_pass_without_a_flag(way):
    encoder = Quadrature(1, lines=100, dirty=[17])
    encoder.reset(np.array([0.5]))
    for k in range(1, 101):
        encoder.advance(np.array([0.5 + way * 12.0 * k]), MS)
    # three turns of 400 edges
    assert encoder.counts[0] == way * (1200 - 3 * 4)
    assert encoder.illegal[0] == 0


def test_values_out_of_range_are_named():
    for bad in ({"phase_error": 1.0}, {"decoder_hz": 0.0}, {"dirty": [5], "lines": 4}):
        with pytest.raises(ConfigError, match="quadrature"):
            Quadrature(1, **bad)


@pytest.mark.parametrize("backend", ["sim", "sim-wire"])
def test_a_rig_file_gives_an_arm_bad_encoders(backend, tmp_path):
    def counts(name, **encoders):
        over = {"simulation": {"quadrature": encoders}} if encoders else {}
        force = {"leader-force": {"backend": "sim"}, "follower-force": {"backend": "sim"}}
        # nothing is fed back: a count more or less must not make another motion
        off = {"stiffness": [0.0] * 3, "damping": [0.0] * 3}
        over["controller"] = {"parameters": off}
        config = load_rig(RIG, {"backend": backend, "devices": force, **over})
        runner.run_session(config, 0.4, seed=2, output=tmp_path / name)
        _, words = read_fields(tmp_path / name, "/rig/raw")
        return {arm: words[f"{arm}_count2"] for arm in ("leader", "follower")}

    good = counts("good.mcap")
    clean = counts("clean.mcap", arm="follower")
    assert np.abs(clean["follower"] - good["follower"]).max() <= 1
    # lines of joint 2 around its home of 0.4 rad
    home = int(0.4 * 11.2 / (2 * np.pi) * 1024)
    near = [line % 1024 for line in range(home - 10, home + 10, 4)]
    bad = counts("bad.mcap", arm="follower", dirty=near)
    assert np.abs(bad["leader"] - good["leader"]).max() <= 1
    assert np.abs(bad["follower"] - good["follower"]).max() > 3
