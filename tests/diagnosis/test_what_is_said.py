"""What is said beside the names: one cause of several, a blind joint, a value that changed."""

from contextlib import redirect_stdout
from dataclasses import replace
from io import StringIO

import plants
import pytest

from hil.cli import main
from hil.commands.compare import text as compared
from hil.commands.diagnose import text
from hil.diagnosis import engine
from hil.diagnosis.engine import diagnose
from hil.diagnosis.verbs import compare, ladder
from hil.diagnosis.verdict import COMMON
from hil.models.model import base_model
from hil.record.export import write_recordings


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
