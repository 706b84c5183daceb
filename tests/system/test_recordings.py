"""Recordings that no simulator made: the published sets, with the figures that must hold."""

import os

import pytest

from hil.bench import recordings

pytestmark = pytest.mark.skipif(
    "HIL_DATA" not in os.environ, reason="the public recordings are not here (HIL_DATA is not set)"
)


def test_emps_published_identification_is_reproduced():
    here = recordings.emps_published()
    for name, value in recordings.PUBLISHED.items():
        assert here.values[name] == pytest.approx(value, rel=0.01)
    assert here.error == pytest.approx(recordings.PUBLISHED_ERROR, abs=0.1)
    assert here.heldout == pytest.approx(6.00, abs=0.1)


@pytest.mark.slow
def test_emps_missing_effect_is_named_and_lowers_the_heldout_error():
    here = recordings.emps_diagnosed()
    assert here.diagnosis.verdict == "missing-effect"
    assert here.diagnosis.findings[0].effect == "asymmetric-viscous"
    assert here.heldout[1] < 0.85 * here.heldout[0]
    assert here.free_run_mm(0) == pytest.approx(8.31, rel=0.05)


@pytest.mark.slow
def test_emps_refined_on_its_first_record_runs_freely_through_the_other():
    here = recordings.emps_refined(((),))
    found = here.fits[here.taken]
    before, after = found.official
    assert found.better and found.result is found.refined
    assert 1e3 * before.simulated[0] == pytest.approx(8.31, rel=0.05)
    assert 1e3 * after.simulated[0] < recordings.REFERENCES["linear state space"]
    assert found.heldout[1].simulated[0] < 0.7 * found.heldout[0].simulated[0]


@pytest.mark.slow
def test_foam_law_is_found_and_halves_the_error():
    found = [recordings.contact(r) for r in recordings.contact_runs("foam")]
    assert recordings._median_of([c.spring for c in found]) > 30
    assert recordings._median_of([c.final for c in found]) < 17.5
    assert {"contact-damping", "contact-hysteresis"} <= {n for c in found for n in c.named}


def test_real_spring_gets_no_extra_effect():
    found = [recordings.contact(r) for r in recordings.contact_runs("spring")]
    assert not [c for c in found if c.named]


def test_rigid_wall_is_not_identifiable():
    found = [recordings.contact(r) for r in recordings.contact_runs("rigid")]
    assert {c.verdict for c in found} == {"not-identifiable"}


@pytest.mark.slow
def test_wrist_coupling_is_found_in_the_first_half_and_holds_in_the_second():
    d = recordings.wrist("halves").diagnosis
    first = d.findings[0]
    assert (first.effect, first.joint) == ("coupled-transmission", "joint_5")
    assert d.ladder[0].heldout.relative[4] > 100 and d.ladder[-1].heldout.relative[4] < 22
    assert first.relative_before > 55 and first.relative_after < 25


@pytest.mark.slow
def test_wrist_coupling_is_found():
    d = recordings.wrist().diagnosis
    first = d.findings[0]
    assert (first.effect, first.joint) == ("coupled-transmission", "joint_5")
    assert first.relative_before > 55 and first.relative_after < 20
