"""A name whose rung lowers neither error: what was found later has taken its work."""

from dataclasses import replace

import compare_plants as plants

import hil
from hil.compare import judge


def test_a_rung_that_lowers_neither_error_is_no_name():
    run = plants.axis(1, extra=lambda t, q, v: 0.2 * v * abs(v))
    d = hil.diagnose([run], hil.base_model(run.robot))
    (drag,) = [c for c in d.first.candidates if c.name == "quadratic-drag"]
    first, second = d.ladder
    assert [f.effect for f in d.findings] == ["quadratic-drag"]
    nothing = replace(first, label=second.label)
    found = [(drag, 1.0, [])]
    named = judge.judge([first, second], found, d.first, d.last)
    assert [f.effect for f in named.findings] == ["quadratic-drag"]
    emptied = judge.judge([first, nothing], found, d.first, d.first)
    assert not emptied.findings and "emptied" in [code for code, _ in emptied.warnings]


def test_what_the_ladder_takes_and_no_name_stands_for_is_not_adequate(monkeypatch):
    run = plants.axis(1, extra=lambda t, q, v: 0.2 * v * abs(v))
    d = hil.diagnose([run], hil.base_model(run.robot))
    assert (d.ladder[0].result.rms > judge.FAR * d.noise).all()
    (drag,) = [c for c in d.first.candidates if c.name == "quadratic-drag"]
    monkeypatch.setattr(judge, "_idle", lambda c, steps: True)
    left = judge.judge(d.ladder, [(drag, 1.0, [])], d.first, d.last)
    assert not left.findings and left.verdict == "unexplained"
