"""What is said beside the names: one cause of several, a blind joint, a value that changed."""

from dataclasses import replace

import numpy as np
from compare_axes import session

from hil.cli import main
from hil.commands.compare import text as compared
from hil.commands.diagnose import text
from hil.diagnosis.engine import diagnose
from hil.diagnosis.verbs import compare, ladder
from hil.diagnosis.verdict import COMMON
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
    (sentence,) = [x for code, x in d.warnings if code == COMMON]
    assert sentence.startswith("joint1, joint2 are late by the same time, 12 ms")
    assert text(d, ladder(d)).count(sentence) == 1
    # two drives of their own are two causes
    run = late((4, 12))
    d = diagnose([run], base_model(run.robot))
    assert len(d.findings) == 2 and COMMON not in dict(d.warnings)


def test_a_joint_that_reads_the_same_throughout_may_be_blind():
    run = session("", 1, "still")
    q = run.q.copy()
    q[:, 1] = 0.3
    told = dict(diagnose([replace(run, q=q)], base_model(run.robot)).warnings)["holds"]
    assert "joint2: held" in told and "joint2 never changes by one count" in told


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


def against_a_stop(swing: float, seed: int) -> Recording:
    """One axis that swings up to 0.65 rad times `swing`, with a stop at 0.5 rad."""
    rng, t = np.random.default_rng(seed), np.arange(20000) / 1000.0
    w, phase = 2 * np.pi * np.array([0.11, 0.53, 1.3]), np.array([0.0, 1.0, 2.0]) * seed
    size, angle = swing * np.array([0.35, 0.2, 0.1]), np.outer(t, w) + phase
    q, v, a = (
        (size * x).sum(axis=1) for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle))
    )
    effort = 0.02 * a + 0.15 * np.tanh(v / 0.01) + 0.05 * v + 8.0 * np.maximum(q - 0.5, 0.0)
    effort += 0.004 * rng.standard_normal(t.size)
    return Recording(f"stop{seed}", "arm", ("joint1",), t, q[:, None], effort[:, None])


def test_an_effect_that_later_ones_have_emptied_gets_no_name():
    # a torque over position stands in for a stop until the stop is found
    run = against_a_stop(1.0, 1)
    assert [f.effect for f in diagnose([run], base_model(run.robot)).findings] == ["end-stop"]


def test_a_held_out_session_that_goes_farther_is_no_other_rig():
    near, far = against_a_stop(0.7, 1), against_a_stop(1.0, 2)
    d = diagnose([near], base_model(near.robot), [far])
    told = " ".join(x for _, x in d.warnings)
    assert d.verdict == "unexplained" and "end-stop would explain" in told
    assert "the motion of stop1 can hardly show it" in told
    assert "the sessions differ" not in told and "[offsets]" not in told
