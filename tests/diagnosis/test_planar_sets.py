"""What no joint of a planar arm feels: it is said in numbers, and no motion is sold for it."""

import warnings

import plants
import pytest

import hil
from hil.cli import main
from hil.diagnosis.equivalence import sets_of


@pytest.mark.slow
def test_what_the_joints_never_feel_is_named_without_a_number_that_is_none():
    run = plants.planar(1, seconds=12.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = sets_of(hil.diagnose([run], hil.base_model(run.robot)))
    (tip,) = (s for s in found if s.effects[0] == "tip-impedance")
    assert tip.reason == "structural" and "nan" not in tip.why
    assert (
        "in all motions of the menu together, the model's own parameters explain all of it as well"
        in tip.why
    )
    assert "fy" in tip.why.split("its joints never feel")[1]


@pytest.mark.slow
def test_no_motion_is_sold_for_two_that_the_model_does_both(tmp_path, capsys):
    arm = tmp_path / "arm.urdf"
    arm.write_text(plants.PLANAR)
    words = ["--for", "base-tilt,tip-impedance", "--seconds", "10", "-o", str(tmp_path / "n.toml")]
    assert main(["excite", str(arm), *words]) == 2
    assert "no motion within the limits of this robot separates" in capsys.readouterr().err
