"""The study of transparency: its designs hand over the whole force, and its page says so."""

from __future__ import annotations

import pytest

from hil.experiments import transparency
from hil.experiments.pages import means
from hil.rig.config import load_rig
from hil.rig.open import build_controller

WHOLE = (transparency.FOUR_CHANNELS, transparency.OTHER, transparency.THREE_CHANNELS)


@pytest.mark.parametrize("name", WHOLE)
def test_designs_that_hand_over_the_whole_force_pass_the_check_before_the_start(name):
    """c2 = 1 + c6 and c3 = 1 + c5: share 1; on the arms of the rig file."""
    shown = transparency.SHOWN_DESIGNS[name]
    law = transparency.law_of_design(shown, {})
    for c, local in (("c2", "c6"), ("c3", "c5")):
        assert law[c] == pytest.approx([1.0 + x for x in law[local]])
    assert not any(law[c][k] for c in ("c1", "c4", "c7", "c8") for k in (2, 5, 8))
    build_controller(load_rig("lawrence", {"controller": {"parameters": law}}))


def test_one_matrix_belongs_to_several_sets_of_gains():
    first, other = (
        transparency.law_of_design(transparency.SHOWN_DESIGNS[n], {}) for n in WHOLE[:2]
    )
    assert first["c1"] != pytest.approx(other["c1"])
    h, g = (abs(transparency.predicted(x, transparency.np.array([1.0]))[0]) for x in (first, other))
    assert h[0, 1] == pytest.approx(g[0, 1], abs=0.01)
    assert h[1, 0] == pytest.approx(g[1, 0], abs=0.01)


def test_the_page_tells_classic_and_transparent_designs_apart():
    sizes = {"h11": 1.0, "h12": 1.0, "h21": 1.0, "h22": 0.01}
    rows = [
        {"design": d, "entry": e, "hz": hz, "predicted": x, "measured": x, "difference": off * x}
        for d, shown in transparency.SHOWN_DESIGNS.items()
        for hz in shown.hz
        for e, x in sizes.items()
        for off in (0.5 if d in WHOLE and e == "h22" else 0.02,)
    ]
    found = means(transparency.PAGE, [{"rows": rows}] * 2)
    said = "\n".join(transparency.PAGE.read(found))
    assert "2.0 % of h22" in said and "off by up to 50 % of it" in said
    assert "four channels: h12 1 to 1, h21 1 to 1, h11 1 to 1 N s/m" in said
    assert "with 250 and 120 N/m between the arms, differ by at most 0.0 % in h12" in said
