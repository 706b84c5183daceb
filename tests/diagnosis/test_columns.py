"""Efforts of wrong sign or in swapped columns are bad data, not physics; right ones are not."""

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil import cli
from hil.diagnosis import columns
from hil.diagnosis.joint_zeros import Lengths, with_lengths
from hil.diagnosis.preconditions import contradicted, without_effort
from hil.diagnosis.residual_tests import changes
from hil.errors import DataError
from hil.identify.fit import fit
from hil.identify.problem import Problem
from hil.identify.result import FitResult
from hil.models.effect import Trait
from hil.models.model import base_model
from hil.record.recording import Recording


def said(run: Recording) -> tuple[str, list[tuple[str, str]]]:
    d = hil.diagnose([run], hil.base_model(run.robot))
    return d.verdict, d.warnings


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda tau: -tau, "sign", "all efforts have the wrong sign"),
        (lambda tau: tau * [1, -1], "sign", "tau2 (joint2) has the wrong sign"),
        (lambda tau: tau[:, ::-1], "swapped", "tau1 and tau2 (joint1, joint2) are swapped"),
    ],
)
def test_mistaken_columns_are_bad_data(change, code, words):
    run = plants.axes_apart()
    verdict, warnings = said(replace(run, tau=np.ascontiguousarray(change(run.tau))))
    assert verdict == "bad-data"
    assert [c for c, _ in warnings] == [code] and words in warnings[0][1]


@pytest.mark.parametrize("order", [plants.further([1, 0, 2]), [1, 2, 0]])
def test_positions_in_another_order_than_their_efforts_are_told_both_ways(order):
    """Of axes nothing says which of the two stand in the wrong columns: it was the efforts."""
    run = plants.slow_axes(1, d=3)
    fit = hil.fit([replace(run, q=run.q[:, order])], hil.base_model(run.robot))
    ((code, text),) = columns.mistaken(fit, [replace(run, q=run.q[:, order])])
    back = [order.index(k) for k in range(3)]
    assert code == "swapped" and "change only one of them" in text
    for stem, taken in (("q", back), ("tau", order)):
        for k, c in enumerate(taken):
            assert (f"{stem}{k + 1} from the column of {stem}{c + 1}" in text) == (k != c)


@pytest.mark.parametrize("order", [[1, 0, 2, 3], plants.further([1, 2, 0, 3])])
@pytest.mark.slow
def test_a_description_tells_that_the_positions_are_in_another_order(order):
    run = plants.serial_arm(4, 1)
    for wrong, stem in (
        (replace(run, q=run.q[:, order]), "q"),
        (replace(run, tau=run.tau[:, order]), "tau"),
    ):
        fit = hil.fit([wrong], hil.base_model(run.robot))
        ((code, text),) = columns.mistaken(fit, [wrong])
        back = order.index(0) + 1
        assert code == "swapped" and f"{stem}1 from the column of {stem}{back}" in text
        assert ("tau1" in text) == (stem == "tau")


def test_two_positions_are_exchanged_where_no_effort_follows_its_own(monkeypatch):
    """A wrist carries a hand's weight: 90 to 107 % were left of three efforts, and names sought."""
    run = plants.serial_arm(3, 1, seconds=10.0)
    monkeypatch.setattr(columns, "_followed", lambda problem: list(range(problem.d)))
    wrong = replace(run, q=run.q[:, [0, 2, 1]])
    ((code, text),) = columns.mistaken(hil.fit([wrong], hil.base_model(run.robot)), [wrong])
    assert code == "swapped" and "q2 from the column of q3" in text and "tau2" not in text
    assert columns.mistaken(hil.fit([run], hil.base_model(run.robot)), [run]) == []


@pytest.mark.parametrize(
    ("turn", "efforts", "said"),
    [
        plants.further(
            [[1, 0, 0], [0, 1, 0], [0, 1, 1]], True, ["q2 = -1, q3 = 1", "tau2 = 1, tau3 = 1"]
        ),
        ([[1, 0, 0], [0, 1, 0], [0, -1, 1]], True, ["q2 = 1, q3 = 1", "tau2 = 1, tau3 = -1"]),
        ([[1, 0, 0], [1, 1, 0], [1, 1, 1]], False, ["q1 = -1, q2 = 1", "q2 = -1, q3 = 1"]),
    ],
)
def test_motors_that_count_from_another_link_are_told_with_their_map(turn, efforts, said):
    """A palletiser's motors stand in its base: a spring at 1.00 and minutes were the answer."""
    run, turn = plants.serial_arm(3, 1, seconds=10.0), np.array(turn, float)
    tau = run.tau @ np.linalg.inv(turn) if efforts else run.tau
    motors = replace(run, q=run.q @ turn.T, qd=None, tau=tau)
    ((code, text),) = columns.mistaken(hil.fit([motors], hil.base_model(run.robot)), [motors])
    assert code == "coupled" and all(x in text for x in said) and ("tau" in text) == efforts
    assert text.count(" sum = ") == len(said)


@pytest.mark.parametrize(("d", "seed", "joint"), [(3, 2, 2), plants.further(4, 1, 3)])
def test_an_offset_of_many_times_an_effort_is_no_scale_and_no_zero(d, seed, joint):
    """A gripper's effort with an offset of twelve times itself was "in another unit or scale"."""
    run = plants.serial_arm(d, seed, seconds=10.0)
    tau = run.tau.copy()
    tau[:, joint] -= 12.0 * tau[:, joint].std()
    offset = replace(run, tau=tau)
    fit = hil.fit([offset], hil.base_model(run.robot) - "torque-offset")
    assert fit.relative.max() > 40.0
    assert columns.mistaken(fit, [offset]) == []


@pytest.mark.slow
def test_a_comparison_says_which_column_is_mistaken():
    run = plants.axes_apart()
    swapped = replace(run, tau=np.ascontiguousarray(run.tau[:, ::-1]))
    c = hil.compare([swapped], hil.base_model(run.robot), simulate=False)
    assert [f.code for f in c.faults if f.code in ("sign", "swapped")] == ["swapped"]
    c = hil.compare([run], hil.base_model(run.robot), simulate=False)
    assert not [f.code for f in c.faults if f.code in ("sign", "swapped")]


def test_one_axis_of_wrong_sign():
    run = plants.axis(1)
    verdict, warnings = said(replace(run, tau=-run.tau))
    assert verdict == "bad-data" and warnings[0][0] == "sign"


@pytest.mark.slow
def test_right_columns_are_not_bad_data():
    assert said(plants.axes_apart())[0] == "adequate"
    # a large effect is one, not a wrong column
    assert said(plants.axis(1, extra=lambda t, q, v: 2.0 * np.sin(3 * q)))[0] != "bad-data"


def test_friction_that_drives_raises_suspicion_though_free_masses_take_the_sign():
    run = plants.axis(1)
    fits = [
        hil.fit([replace(run, tau=sign * run.tau)], hil.base_model(run.robot)) for sign in (1, -1)
    ]
    assert [columns.driven(f) for f in fits] == [False, True]


def fitted(run: Recording) -> FitResult:
    return hil.fit([run], hil.base_model(run.robot))


def wrong(run: Recording) -> list[tuple[str, str]]:
    return columns.mistaken(fitted(run), [run])


def sprung(seed: int = 1) -> Recording:
    """A planar arm with a spring on the elbow that nobody described."""
    run = plants.planar(seed, seconds=12.0)
    return replace(run, tau=run.tau + 0.3 * (run.q - 0.3) * [0.0, 1.0])


@pytest.mark.parametrize("make", [plants.further(lambda: plants.planar(1, seconds=12.0)), sprung])
def test_efforts_of_wrong_sign_on_an_arm_are_told_though_an_effect_is_hidden(make):
    run = make()
    ((code, text),) = wrong(replace(run, tau=-run.tau))
    assert code == "sign" and text.startswith("all efforts have the wrong sign")
    ((code, text),) = wrong(replace(run, tau=run.tau * [1.0, -1.0]))
    assert code == "sign" and "tau2 (elbow) has the wrong sign" in text
    assert not wrong(run)


def test_a_joint_counted_the_other_way_round_is_one_joint_and_no_shift():
    run = plants.planar(1, seconds=12.0)
    turned = replace(run, q=run.q * [1.0, -1.0], tau=run.tau * [1.0, -1.0])
    ((code, text),) = wrong(turned)
    assert code == "posture" and text.count("sign = -1") == 2 and "shift" not in text


def test_the_zero_of_a_last_joint_that_no_data_show_is_not_told():
    run = plants.planar(1, seconds=12.0)
    assert not wrong(replace(run, q=run.q + np.array([0.0, 1.0])))


@pytest.mark.parametrize(
    ("j", "times", "make"),
    [
        (0, 50, lambda: plants.planar(1, seconds=12.0)),
        (0, 50, sprung),
        (1, 50, lambda: plants.planar(1)),
    ],
)
def test_an_effort_in_another_unit_is_told_on_its_own_joint(j, times, make):
    run = make()
    scale = np.where(np.arange(2) == j, 1 / times, 1.0)
    ((code, text),) = wrong(replace(run, tau=run.tau * scale))
    assert code == "scale" and text.startswith(f"tau{j + 1} ")
    assert float(text.split("scale = ")[1].split(";")[0]) == pytest.approx(times, rel=0.1)


def test_positions_are_exchanged_also_where_friction_is_foretold_all_the_same():
    """A light wrist's: 26 and 23 % were left, and *coupled-friction* was named at 1.00."""
    run = plants.serial_arm(3, 1, axes=("0 1 0", "1 0 0", "0 1 0"), seconds=10.0)
    run = replace(run, q=run.q[:, [2, 1, 0]])
    found = hil.fit([run], base_model(run.robot))
    result = replace(found, residual=0.3 * found.residual)
    assert 20 < max(result.relative) < 50 and sorted(result.relative)[1] > 10
    assert columns._exchanged_positions(result, [run]) == [2, 1, 0]


def test_a_gain_of_a_thousand_is_no_other_explanation_of_another_unit():
    """An effort in mN m was a *torque-gain* of 998: it leaves as little as the right unit."""
    right = plants.serial_arm(3, 1, seconds=10.0)
    run = replace(right, tau=right.tau * [1.0, 1.0, 1000.0])
    model = base_model(run.robot)
    as_read, mended = (hil.fit([r], model) for r in (run, right))
    answer = columns._Answer(1.0, mended, "scale", "", fitted=True)
    assert not columns._effects_do_as_much(as_read, answer)
    with_gain, without = (
        min(columns._beside_effects(as_read, but)) for but in (Trait.NONE, Trait.GAIN)
    )
    assert with_gain < 1.05 * min(columns._beside_effects(mended, Trait.NONE)) < 0.2 * without


def test_a_position_in_another_scale_is_told():
    run = plants.planar(1, seconds=12.0)
    ((code, text),) = wrong(replace(run, q=run.q * [1.0, 0.5]))
    assert code == "scale" and text.startswith("q2 ")
    assert float(text.split("scale = ")[1].split(";")[0]) == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("order", ["order", "swapped"])
def test_wrong_columns_are_told_though_an_effect_is_hidden(order):
    run = sprung()
    q = run.q[:, ::-1] if order == "order" else run.q
    ((code, text),) = wrong(replace(run, q=q.copy(), tau=run.tau[:, ::-1].copy()))
    assert code == order and "2" in text


# ------------------------------------------------------------ gravity beside the description


def gravity(run: Recording) -> list[tuple[str, str]]:
    return contradicted(fitted(run))


@pytest.mark.parametrize(("times", "said"), [(0.02, "are 0.02 (1/50"), (1000.0, "are 1")])
def test_a_scale_of_all_efforts_is_said_as_one(times, said):
    for run in (plants.planar(1, seconds=12.0), sprung()):
        ((code, text),) = gravity(replace(run, tau=times * run.tau))
        assert code == "effort-scale" and said in text
        assert f"scale = {1 / times:.2g}" in text and "<gravity>" not in text


def test_a_zero_that_explains_a_gravity_is_named_before_masses_and_gravity():
    run = plants.planar(1, seconds=12.0)
    for j in (0, 1):
        shifted = replace(run, q=run.q - np.pi / 2 * (np.arange(2) == j))
        ((code, text),) = wrong(shifted) or gravity(shifted)
        assert code in ("posture", "description-gravity")
        assert f"q{j + 1} (" in text and "(90 deg)" in text
        assert "No masses" not in text and "<gravity>" not in text


def test_a_missing_gravity_is_told_with_what_was_measured():
    run = plants.planar(1, seconds=12.0)
    q, (m1, m2), (c1, c2) = run.q, plants.M, plants.C
    far = plants.G * m2 * c2 * np.cos(q.sum(axis=1))
    near = plants.G * (m1 * c1 + m2 * plants.L) * np.cos(q[:, 0]) + far
    light = replace(run, tau=run.tau - 0.97 * np.stack([near, far], axis=1))
    ((code, text),) = gravity(light)
    assert code == "description-gravity"
    assert re.search("data give 0.0[23]", text) and "<gravity>0 0 0</gravity>" in text


def test_masses_of_another_size_are_no_other_scale_of_the_efforts():
    run = plants.planar(1, seconds=12.0)
    light = run.robot.urdf.replace('mass value="0.9"', 'mass value="0.6"')
    told = gravity(replace(run, robot=replace(run.robot, urdf=light)))
    assert told and all(code == "description-gravity" for code, _ in told)
    assert all("Check the masses" in text for _, text in told)


# ------------------------------------------------------------ lengths beside the description


def resized(run: Recording, factor: float, joint: str = "") -> Recording:
    """The run with a description that has another size, or one other distance."""
    root = ET.fromstring(run.robot.urdf)
    for e in root.findall("joint") if joint else [root]:
        if e.get("name", "") == joint or not joint:
            for place in e.iter("origin"):
                numbers = (float(x) * factor for x in place.get("xyz", "0 0 0").split())
                place.set("xyz", " ".join(map(repr, numbers)))
    return replace(run, robot=replace(run.robot, urdf=ET.tostring(root, encoding="unicode")))


def test_a_description_of_another_size_is_told_with_the_factor():
    """An arm of another size got a differential, a spring over two joints, a relaxation at 1.00."""
    ((code, text),) = wrong(resized(plants.serial_arm(3, 1, noise=0.003, seconds=10.0), 0.3))
    assert code == "lengths" and "by about 3.3 " in text and "may be wrong alike" in text


def test_a_description_in_millimetres_is_told_though_two_springs_do_as_much():
    """A unit is no number that was fitted; in the noise of this run it was a tip-impedance."""
    ((code, text),) = wrong(resized(plants.serial_arm(3, 1, seconds=10.0), 1000.0))
    assert code == "lengths" and "by about 0.001 " in text and "every <origin xyz>" in text


def test_one_spring_stands_where_it_does_as_much_as_one_length():
    """In this noise both do, and nothing says that the description is wrong."""
    run = resized(plants.serial_arm(3, 1), 100.0)
    answers = columns._other_posture(fitted(run), [run])
    assert [(x.code, x.fitted) for x in answers] == [("lengths", True)] * 2
    assert wrong(run) == []


def test_one_wrong_distance_of_the_description_is_told_with_its_joints():
    run = plants.serial_arm(4, 1, noise=0.003, seconds=10.0)
    ((code, text),) = wrong(resized(run, 2.0, "joint3"))
    assert code == "lengths" and "from joint2 to joint3" in text and "by about 0.5 " in text
    assert wrong(run) == []


def test_the_verdict_does_not_lay_it_on_the_recording_alone(tmp_path, capsys):
    table, robot = tmp_path / "run.csv", tmp_path / "arm.urdf"
    run = resized(plants.serial_arm(3, 1, noise=0.003, seconds=10.0), 1000.0)
    robot.write_text(run.robot.urdf)
    head = "t,q1,q2,q3,tau1,tau2,tau3"
    rows = np.column_stack([run.t, run.q, run.tau])
    np.savetxt(table, rows, delimiter=",", header=head, comments="")
    page = tmp_path / "page.html"
    assert cli.main(["diagnose", str(table), "--robot", str(robot), "--report", str(page)]) == 2
    assert "the recording or the robot description is faulty" in capsys.readouterr().out
    text = page.read_text()
    assert "The recording or the robot description is faulty" in text
    assert "Correct what is said above" in text and "&lt;origin xyz&gt;" in text


def test_fixed_joints_between_two_moving_ones_count_to_their_distance():
    run = plants.serial_arm(3, 1, seconds=10.0)
    root = ET.fromstring(run.robot.urdf)
    held = next(e for e in root.findall("joint") if e.get("name") == "joint2")
    held.set("type", "fixed")
    x = Lengths(0.0, 2.0, ("joint1", "joint3"), 0.1)
    before = replace(run.robot, urdf=ET.tostring(root, encoding="unicode"))
    after = with_lengths(before, x, 2.0)

    def places(urdf: str) -> list[list[float]]:
        each = ET.fromstring(urdf).iterfind("joint/origin")
        return [[float(v) for v in e.get("xyz", "0 0 0").split()] for e in each]

    was, now = np.array(places(before.urdf)), np.array(places(after.urdf))
    assert np.array_equal(now[:1], was[:1]) and np.array_equal(now[1:3], 2 * was[1:3])


# ------------------------------------------------------------ mistakes in one of several runs


def of_several(changed: Recording, *others: Recording) -> list[tuple[str, str]]:
    runs = [*others, changed]
    return columns.mistaken(hil.fit(runs, hil.base_model(changed.robot)), runs)


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda r: replace(r, tau=r.tau * [1, -1, 1]), "sign", "tau2 (joint2) has the wrong sign"),
        (lambda r: replace(r, q=r.q[:, [0, 2, 1]]), "swapped", "q2 and q3 (joint2, joint3) are"),
    ],
)
def test_a_mistake_in_one_of_two_runs_is_told_of_that_run(change, code, words):
    """They had been an offset a run at 1.00, and *unexplained*."""
    one, two = (plants.serial_arm(3, k, noise=0.003, seconds=10.0) for k in (1, 2))
    ((found, text),) = of_several(change(two), one)
    assert found == code and text.startswith("in run2 alone, ") and words in text
    assert of_several(two, one) == []


@pytest.mark.parametrize("shift", [0.5, plants.further(0.1)])
def test_another_zero_of_one_run_is_told_with_the_shift(shift):
    """An incremental encoder counts from where it was switched on: an offset a run at 0.99."""
    runs = [plants.serial_arm(3, k, noise=0.003, seconds=10.0) for k in (1, 2, 3)]
    changed = replace(runs[1], q=runs[1].q - [0.0, shift, 0.0])
    ((code, text),) = of_several(changed, runs[0], runs[2])
    assert code == "posture"
    assert "in run2, q2 (joint2) is counted from another zero than in run1 and others" in text
    found = float(re.search(r"shift = (-?[0-9.]+) rad", text)[1])
    assert found == pytest.approx(shift, abs=0.01)


def test_the_recording_is_told_and_not_its_part_behind_a_gap():
    """Its samples are in several parts then, of which the second is not the second recording."""
    runs = [plants.serial_arm(3, k, noise=0.003, seconds=10.0) for k in (1, 2)]
    whole = np.abs(runs[0].t - 5.0) > 0.5
    gap = replace(runs[0], t=runs[0].t[whole], q=runs[0].q[whole], tau=runs[0].tau[whole])
    ((code, text),) = of_several(replace(runs[1], q=runs[1].q - [0.0, 0.5, 0.0]), gap)
    assert code == "posture" and "than in run" in text
    found = float(re.search(r"shift = (-?[0-9.]+) rad", text)[1])
    assert abs(found) == pytest.approx(0.5, abs=0.01)


def test_zeros_of_several_joints_of_one_run_are_told_together():
    runs = [plants.serial_arm(3, k, noise=0.003, seconds=10.0) for k in (1, 2)]
    changed = replace(runs[1], q=runs[1].q - [0.0, 0.5, -0.3])
    ((code, text),) = of_several(changed, runs[0])
    assert code == "posture" and "q2 (joint2) and q3 (joint3) are counted from other zeros" in text
    assert "or the opposite in run1" in text


def test_what_is_missing_in_all_runs_is_sought_in_no_run_alone(monkeypatch):
    """Twelve runs with payloads and offsets of their own took 54 s where 36 are enough."""
    runs = []
    for k in (1, 2, 3, 4):
        run = plants.serial_arm(3, k, seconds=8.0)
        size = np.std(run.tau, axis=0) * [0.3, 0.0, 0.0]
        offset = [0.0, 50.0 * k, 0.0]
        runs.append(replace(run, tau=run.tau + size * np.sin(20 * run.q) + offset))
    fit, corrected, looked = hil.fit(runs, hil.base_model(runs[0].robot)), columns._corrected, []

    def counted(result, recordings, doubtful):
        looked.append(len(recordings))
        return corrected(result, recordings, doubtful)

    monkeypatch.setattr(columns, "_corrected", counted)
    assert columns.mistaken(fit, runs) == []
    assert looked == [4]


def test_an_offset_of_one_run_is_no_other_zero():
    """Half a turn of one joint took three quarters of such an error, and no more."""
    one, two = (plants.serial_arm(3, k, noise=0.003, seconds=10.0) for k in (1, 2))
    assert of_several(replace(two, tau=two.tau + np.array([0.0, 30.0, 3.0])), one) == []


def test_a_run_at_rest_is_looked_at_with_the_others_alone():
    one, two, still = (plants.serial_arm(3, k, noise=0.003, seconds=10.0) for k in (1, 2, 3))
    still = replace(still, q=np.broadcast_to(still.q[0], still.q.shape))
    changed = replace(two, tau=two.tau * [1.0, -1.0, 1.0])
    for _, text in of_several(changed, one, still):
        assert "in run2 alone" in text


def test_a_payload_of_one_run_is_no_other_zero():
    one, two = plants.serial_arm(3, 1), plants.serial_arm(3, 2, link=3)
    assert of_several(two, one) == []


# ------------------------------------------------------------ efforts that never change


@pytest.mark.parametrize("value", [0.1, -3.0])
def test_efforts_that_never_change_are_bad_data_with_what_to_do(value):
    run = plants.axis(1, seconds=6.0)
    dead = replace(run, tau=np.full_like(run.tau, value))
    found = hil.diagnose([dead], hil.base_model(run.robot))
    assert found.verdict == "bad-data"
    ((code, text),) = found.warnings
    assert code == "constant-effort" and f"{value:g} throughout" in text and "in a map" in text
    for verb in (hil.fit, hil.compare):
        with pytest.raises(DataError, match="no effort changes"):
            verb([dead], hil.base_model(run.robot))


def test_one_run_of_a_constant_effort_beside_others_is_no_fault():
    run = plants.axis(1, seconds=6.0)
    held = replace(run, tau=np.full_like(run.tau, 0.1), name="held")
    assert not without_effort([run, held]) and without_effort([held])
    other = replace(held, tau=held.tau + 1.0)
    assert not without_effort([held, other])


# ------------------------------------------------------------ one session that differs


@pytest.mark.parametrize("first", [0, 1])
def test_which_session_differs_does_not_depend_on_their_order(first):
    runs = [replace(plants.axis(k, seconds=10.0), name=f"run{k}") for k in (1, 2, 3)]
    v = np.gradient(runs[first].q[:, 0], runs[first].t)
    odd = replace(runs[first], tau=runs[first].tau + 0.4 * v[:, None], name="odd")
    given = [odd if k == first else r for k, r in enumerate(runs)]
    (change,) = changes(fit(Problem(given, given[0].robot), hil.base_model(given[0].robot)))
    assert (change.run, change.what) == ("odd", "viscous friction")
    assert change.value == pytest.approx(0.4, rel=0.2)


@pytest.mark.parametrize("make", [plants.planar, plants.further(plants.spatial)])
def test_a_strong_spring_on_the_last_joint_is_no_other_order_of_the_columns(make):
    """The last joint of an arm hardly needs an effort: with the columns exchanged more was left."""
    runs = []
    for seed in (1, 2):
        run = make(seed, seconds=10.0)
        tau, q = run.tau.copy(), run.q[:, -1]
        tau[:, -1] += 3.0 * np.std(tau[:, -1]) / np.std(q) * (q - 0.2)
        runs.append(replace(run, tau=tau))
    d = hil.diagnose(runs[0], hil.base_model(runs[0].robot), runs[1])
    assert [(f.effect, f.joint) for f in d.findings] == [("spring", runs[0].joints[-1])]
    assert d.findings[0].confidence > 0.95
