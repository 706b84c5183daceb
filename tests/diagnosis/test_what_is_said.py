"""What is said beside the names: one cause of several, a blind joint, a value that changed."""

from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace

import numpy as np
import plants
import pytest

from hil.cli import main
from hil.commands.compare import text as compared
from hil.commands.diagnose import short, text
from hil.diagnosis import engine, rules
from hil.diagnosis.engine import diagnose
from hil.diagnosis.types import Diagnosis, Finding
from hil.diagnosis.verbs import compare, ladder
from hil.diagnosis.verdict import COMMON
from hil.models.model import base_model
from hil.record.export import write_recordings
from hil.report.data import from_diagnosis
from hil.report.text import headline, remains


@pytest.fixture(scope="module")
def late(tmp_path_factory):
    """All joints late by the same time: the diagnosis that `hil improve` made, and its words."""
    folder, found, shown = tmp_path_factory.mktemp("late"), [], StringIO()
    write_recordings(str(folder / "a.mcap"), [plants.late_axes((6, 6))])
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(shown):
        patch.setattr(engine, "diagnose", lambda *a: found.append(diagnose(*a)) or found[-1])
        assert main(["improve", str(folder / "a.mcap"), "-o", str(folder / "m.toml")]) == 0
    (d,) = found
    return d, shown.getvalue()


@pytest.mark.slow
def test_one_lateness_of_all_joints_is_one_cause(late):
    d, _ = late
    (sentence,) = [x for code, x in d.warnings if code == COMMON]
    assert sentence.startswith("joint1, joint2 are late by the same time, 12 ms")
    assert text(d, ladder(d)).count(sentence) == 1
    # two drives of their own are two causes
    run = plants.late_axes((4, 12))
    d = diagnose([run], base_model(run.robot))
    assert len(d.findings) == 2 and COMMON not in dict(d.warnings)


def test_a_joint_that_reads_the_same_throughout_may_be_blind():
    run = plants.two_axes("", 1, "still")
    q = run.q.copy()
    q[:, 1] = 0.3
    told = dict(diagnose([replace(run, q=q)], base_model(run.robot)).warnings)["holds"]
    assert "joint2: held" in told and "joint2 never changes by one count" in told


def test_a_comparison_says_what_changed_at_once():
    run = plants.two_axes("", 1, "changed")
    tau = run.tau.copy()
    tau[run.t > 8.0, 1] += 0.3
    shown = compared(compare([replace(run, tau=tau)], base_model(run.robot)))
    assert (
        "joint2: another effort at rest from 7.87 s of changed on" in shown
        and "(+0.3 N m)" in shown
    )


@pytest.mark.slow
def test_an_improved_model_says_which_of_its_names_are_not_settled(late, tmp_path, capsys):
    d, shown = late
    open_names = [f.joint for f in d.findings if f.rivals]
    assert open_names
    for joint in ("joint1", "joint2"):
        line = f"not settled: delay on {joint} or actuator-lag; these data fit either"
        assert (line in shown) == (joint in open_names)
    write_recordings(str(tmp_path / "b.mcap"), [plants.axis_with_stop(1.0, 1)])
    assert main(["improve", str(tmp_path / "b.mcap"), "-o", str(tmp_path / "n.toml")]) == 0
    shown = capsys.readouterr().out
    assert "end-stop on joint1" in shown and "not settled" not in shown


@pytest.mark.slow
def test_an_effect_that_later_ones_have_emptied_gets_no_name():
    # a torque over position stands in for a stop until the stop is found
    run = plants.axis_with_stop(1.0, 1)
    assert [f.effect for f in diagnose([run], base_model(run.robot)).findings] == ["end-stop"]


def test_a_held_out_session_that_goes_farther_is_no_other_rig():
    near, far = plants.axis_with_stop(0.7, 1), plants.axis_with_stop(1.0, 2)
    d = diagnose([near], base_model(near.robot), [far])
    told = " ".join(x for _, x in d.warnings)
    assert d.verdict == "unexplained" and "end-stop would explain" in told
    assert "the motion of stop1 can hardly show it" in told
    assert "the sessions differ" not in told and "[offsets]" not in told


@pytest.fixture(scope="module")
def half_named():
    """Two joints: a law of the catalogue on one, friction that fades as it slides on the other."""
    run = plants.serial_arm(2, 1, axes=("0 1 0",) * 2, seconds=12.0)
    v = np.gradient(run.q, run.t, axis=0)
    slid, fresh = 0.0, np.empty(run.t.size)
    for k in range(run.t.size):
        turned = k > 0 and v[k, 1] * v[k - 1, 1] < 0
        slid = 0.0 if turned else slid + abs(v[k, 1]) * 0.004
        fresh[k] = np.exp(-slid / 0.15) * np.tanh(v[k, 1] / 0.01)
    low = 0.3 * np.exp(-((v[:, 0] / 0.1) ** 2)) * np.tanh(v[:, 0] / 0.01)
    run = replace(run, tau=run.tau + np.stack([low, 1.5 * fresh], axis=1))
    return diagnose([run], base_model(run.robot))


@pytest.mark.slow
def test_what_has_no_name_is_said_first_with_its_joint_its_size_and_its_variable(half_named):
    d = half_named
    assert {f.joint for f in d.findings} == {"joint1"}
    shown = short(d, ladder(d), None)
    first = shown.splitlines()[0]
    assert first.endswith("On joint2 more is missing, and no effect of the catalogue explains it.")
    (left,) = [line for line in shown.splitlines() if "error of joint2 is still" in line]
    assert "A function of its position and speed could explain" in left
    assert headline(from_diagnosis(d)).endswith(first.split(". ")[1])


def test_each_figure_of_what_is_left_has_its_model(half_named):
    """Without the corrections and with them: two figures of one joint looked like one too many."""
    d = half_named
    assert d.corrected
    named, last = (s.heldout.rms[1] / d.noise[1] for s in (d.explained, d.ladder[-1]))
    shown = short(d, ladder(d), None)
    assert (
        f"is still {named:.2f} times the noise floor, and {last:.2f} times with the corrections "
        "below" in shown
    )
    assert "joint2" in shown.split("error/floor")[1].split("error %:")[0]
    m = from_diagnosis(d)
    own = m.rungs[: len(m.rungs) - m.corrected]
    same = replace(m, rungs=[*own, own[-1]], corrected=1)  # a correction that is none here
    said = remains(same)
    assert f"is still {named:.2f} times the noise floor" in said and "with the corr" not in said


def test_an_unexplained_joint_is_in_the_verdict(half_named):
    d = replace(half_named, verdict="unexplained", findings=[])
    first = short(d, ladder(d), None).splitlines()[0]
    assert first.endswith(
        "an effect is missing on joint2; none of the catalogue passes every test."
    )


def asked_again(monkeypatch, verdict, was, now, rise, **said):
    """A diagnosis with one name, whose confidence beside the last model is another one."""
    few = {"relative_before": 9.0, "relative_after": 9.0 + rise, "se": 0.1, "excess_explained": 0.9}
    named = Finding("stribeck", "j1", was, **few, parameters={}, rivals=["presliding"], **said)
    before = SimpleNamespace(candidate=SimpleNamespace(name="stribeck"), confidence=was)
    after = SimpleNamespace(candidate=before.candidate, confidence=now, rivals=[])
    monkeypatch.setattr(engine, "separated", lambda search, n: after)
    monkeypatch.setattr(engine, "joint_of", lambda c, problem: "j1")
    out = Diagnosis(verdict, findings=[named])
    return engine.separate(out, SimpleNamespace(problem=None), [before])


def test_a_name_that_is_less_sure_beside_the_last_model_leaves_no_missing_effect(monkeypatch):
    """The verdict was of the model before; the answer then told to accept nothing, and broke."""
    out = asked_again(monkeypatch, "missing-effect", 0.9, 0.4, -6.0)
    assert (out.verdict, out.findings[0].confidence) == ("ambiguous", 0.4)


@pytest.mark.parametrize(("reason", "most"), [*((x, 0.5) for x in rules.DOUBTS), ("", 0.9)])
def test_a_name_that_is_doubtful_stays_so_when_its_rivals_go(monkeypatch, reason, most):
    out = asked_again(monkeypatch, "ambiguous", 0.4, 0.9, 0.06, reason=reason)
    assert (out.findings[0].confidence, out.findings[0].reason) == (most, reason)
