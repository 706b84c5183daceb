"""`hil bench studio`: from Add to the falling ladder, and to the whole answer."""

import pytest

from hil.cli import main
from hil.commands import studio


@pytest.mark.slow
def test_the_ladder_falls_before_the_whole_answer_is_there():
    row = studio.studio_row(3, 6.0, 1)
    assert (row.joints, row.recorded) == (3, 6.0)
    assert 0.0 < row.ladder < row.whole
    assert row.first > 0.0


def test_the_table_says_which_goal_is_met(monkeypatch, tmp_path, capsys):
    taken = {3: 0.7, 7: 4.2}
    monkeypatch.setattr(
        studio, "studio_row", lambda d, s, turns: studio.StudioRow(d, s, 2.0, 0.2, taken[d])
    )
    page = tmp_path / "studio.md"
    words = ["bench", "studio", "--seconds", "60", "--turns", "1", "--report", str(page)]
    assert main(words) == 0
    out = capsys.readouterr().out
    rows = [x.split() for x in out.splitlines() if x.split()[:2] in (["3", "60"], ["7", "60"])]
    assert [(r[-2], r[-1]) for r in rows] == [("1", "met"), ("3", "missed")]
    assert rows[1][-3] == "4.20" and "4.20" in page.read_text()
    assert main([*words[:4], "--turns", "0"]) == 2
