"""What is said beside the names: one cause of several, a blind joint, a value that changed."""

from dataclasses import replace

import numpy as np
from compare_axes import session

from hil.cli import main
from hil.commands.compare import text as compared
from hil.commands.diagnosetext import text
from hil.compare.analysis import compare, ladder
from hil.compare.common import CODE
from hil.compare.diagnose import diagnose
from hil.models.model import base_model
from hil.record.export import write_recordings
from hil.record.recording import Recording


def late(samples: tuple[int, int], seed: int = 1) -> Recording:
    """Efforts that act some samples of 2 ms after they were recorded, by joint."""
    run, n = session("", seed, "late"), max(samples)
    tau = np.stack([run.tau[k : run.n - n + k, j] for j, k in enumerate(samples)], axis=1)
    return replace(run, t=run.t[:-n], q=run.q[:-n], tau=tau)


def test_one_lateness_of_all_joints_is_one_cause():
    run = late((6, 6))
    d = diagnose([run], base_model(run.robot))
    (sentence,) = [x for code, x in d.warnings if code == CODE]
    assert sentence.startswith("joint1, joint2 are late by the same time, 12 ms")
    assert text(d, ladder(d)).count(sentence) == 1
    # two drives of their own are two causes
    run = late((4, 12))
    d = diagnose([run], base_model(run.robot))
    assert len(d.findings) == 2 and CODE not in dict(d.warnings)


def test_a_joint_that_reads_the_same_throughout_may_be_blind():
    run = session("", 1, "still")
    q = run.q.copy()
    q[:, 1] = 0.3
    told = dict(diagnose([replace(run, q=q)], base_model(run.robot)).warnings)["holds"]
    assert "joint2: only held" in told and "joint2 never changes by a single count" in told


def test_a_comparison_says_what_changed_at_once():
    run = session("", 1, "changed")
    tau = run.tau.copy()
    tau[run.t > 8.0, 1] += 0.3
    shown = compared(compare([replace(run, tau=tau)], base_model(run.robot)))
    assert (
        "joint2: another effort at rest from 7.87 s of changed on" in shown
        and "(+0.3 N m)" in shown
    )


def test_an_improved_model_says_which_of_its_names_are_not_settled(tmp_path, capsys):
    write_recordings(str(tmp_path / "a.mcap"), [late((6, 6))])
    assert main(["improve", str(tmp_path / "a.mcap"), "-o", str(tmp_path / "m.toml")]) == 0
    shown = capsys.readouterr().out
    assert "not settled: delay on joint1 or actuator-lag; these data fit either" in shown
