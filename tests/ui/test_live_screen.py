"""The live screen of a session ends within its terminal."""

import pytest

from hil.ui.desk import screen_lines, wrapped

SNAPSHOT = {
    "state": "ENABLED",
    "why": "",
    "seconds": 1.6,
    "controller": "position-force",
    "arms": {
        name: {
            "force": [0.1, 0.0, 0.0],
            "lamps": [1.0, 2.0],
            "position": [0.1] * 7,
            "effort": [-0.012] * 7,
        }
        for name in ("leader", "follower")
    },
    "late_p99_us": 1.8,
    "missed": 0,
    "dropped": 0,
    "unwritten": 0,
    "ring": 11,
    "winding": 25,
    "record": "s.mcap",
}


@pytest.mark.parametrize("wide", [80, 100, 200])
def test_what_is_beyond_the_terminal_goes_on_below(wide):
    """At 80 columns efforts, the winding and the help were cut off."""
    rows = screen_lines(SNAPSHOT)
    shown = wrapped(rows, wide)
    texts = ["".join(text for _, text in row) for row in shown]
    assert max(map(len, texts)) <= wide
    assert "".join("".join(texts).split()) == "".join(
        "".join(t for r in rows for _, t in r).split()
    )
    assert wide < 200 or texts == ["".join(t for _, t in row) for row in rows]
    assert any("winding 25 degC" in t for t in texts) and any("Ctrl-C" in t for t in texts)
    # what is green stays green
    assert [part for row in shown for part in row if part[0] == "ansigreen"] != []
