"""Trajectories: derivatives are right, files come back, mistakes are named."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.errors import ConfigError
from hil.excite import choose, question, trajectory
from hil.excite.choose import decide, menu, survey
from hil.excite.question import Stage, joint_space_room, stage_of, within_limits
from hil.excite.trajectory import (
    HEADROOM,
    Trajectory,
    check_fits_arm,
    motion_margins,
    of_robot,
    period_times,
    sample,
)
from hil.identify.bands import Rates
from hil.identify.problem import Problem
from hil.models.model import base_model
from hil.models.robots import bare_robot
from hil.record.recording import Recording, RobotSource

PREMIUM = RobotSource("phantom-premium-1.5")
JOINTS = ("joint1", "joint2", "joint3")


def premium():
    robot = bare_robot(PREMIUM, JOINTS)
    limits = of_robot(PREMIUM)
    return robot, limits, joint_space_room(limits, robot)


def motion(seed: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.5, 2.0, 6))])
    via = rng.uniform(-0.4, 0.4, (7, 2))
    via[-1] = via[0]
    return Trajectory(
        ("a", "b"),
        ("rad", "m"),
        float(times[-1]),
        times,
        via,
        np.full(7, 0.5),
        0.05 * rng.normal(size=(2, 4, 2)),
    )


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_speed_and_acceleration_are_the_derivatives(seed):
    x = motion(seed)
    t = period_times(x, 2000.0)
    q, qd, qdd = sample(x, t)
    np.testing.assert_allclose(np.gradient(q, t, axis=0)[2:-2], qd[2:-2], atol=3e-4)
    np.testing.assert_allclose(np.gradient(qd, t, axis=0)[2:-2], qdd[2:-2], atol=0.05)
    # it repeats, and any order or spacing of the times gives the same
    rng = np.random.default_rng(seed)
    pick = rng.permutation(t.size)[:50]
    for a, b in zip(sample(x, t[pick] + 3 * x.period), (q, qd, qdd), strict=True):
        np.testing.assert_allclose(a, b[pick], atol=1e-9)


def test_a_file_comes_back(tmp_path):
    x = motion(1)
    trajectory.write_trajectory(x, tmp_path / "x.toml", "a note\nof two lines")
    y = trajectory.read_trajectory(tmp_path / "x.toml")
    assert (y.joints, y.units, y.name) == (x.joints, x.units, x.name)
    for name in ("times", "via", "blend", "series"):
        np.testing.assert_allclose(getattr(y, name), getattr(x, name), atol=1e-11)
    assert trajectory.is_trajectory(tmp_path / "x.toml")


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("hil.trajectory/1", "hil.model/1", "no trajectory file"),
        ("period", "perid", "Did you mean 'period'"),
        ("[path]", "[path]\nz = 1", "unknown key 'z'"),
        ("t = [0.0", "t = [0.1", "increase from 0"),
        ("blend = [0.5", "blend = [9.5", "neighbours"),
        ("blend = [0.5", "blend = [true", "must be a list"),
        ("blend = [0.5", "blend = [nan", "not finite"),
        ("q = [", "q = 3 #[", "not a readable TOML"),
        ('units = ["rad", "m"]', 'units = ["rad"]', "one entry a joint"),
        ('joints = ["a", "b"]', 'joints = ["a", "b", "c"]', "one entry a joint"),
        ("[fourier]", "[furier]", "Did you mean 'fourier'"),
    ],
)
def test_mistakes_in_a_file_are_named(tmp_path, old, new, says):
    text = trajectory.text(motion(2))
    assert old in text
    (tmp_path / "x.toml").write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(ConfigError, match=says.replace("[", r"\[")):
        trajectory.read_trajectory(tmp_path / "x.toml")


@pytest.mark.parametrize("name", choose.MENU)
@pytest.mark.parametrize("joint", [0, 1, 2, None])
def test_the_menu_keeps_to_the_limits(name, joint):
    robot, limits, space = premium()
    x = choose.MENU[name](space, joint, 30.0)
    check_fits_arm(x, limits, robot, 1000.0)
    assert not [m for m in motion_margins(x, limits, robot) if m.broken]
    _, _, qdd = sample(x, period_times(x, 1000.0))
    assert np.abs(qdd).max() < 60.0


def test_what_does_not_fit_the_arm_is_refused():
    robot, limits, space = premium()
    x = choose.fast_strokes(space, 0, 20.0)
    other = Trajectory(("a", "b", "c"), x.units, x.period, x.times, x.via, x.blend, x.series)
    with pytest.raises(ConfigError, match="moves a, b, c"):
        check_fits_arm(other, limits, robot, 1000.0)
    with pytest.raises(ConfigError, match="at 50 Hz"):
        check_fits_arm(x, limits, robot, 50.0)
    with pytest.raises(ConfigError, match=r"position joint1|workspace"):
        check_fits_arm(x.shrunk(2.0, limits.center), limits, robot, 1000.0)


def turning(span: float, seconds: float = 60.0):
    """Problem of an axis that turns on, or swings within `span` [rad]."""
    t = np.arange(0.0, seconds, 0.02)
    q = span * t / seconds if span > 100 else span / 2 * np.sin(2 * np.pi * t / 5)
    run = Recording("run", "arm", ("axis",), t, q[:, None], np.cos(t)[:, None])
    return Problem([run], RobotSource("single-axis"))


def test_an_axis_that_turned_on_is_planned_for_about_its_middle():
    stage = stage_of(turning(600.0))
    (width,), (speed,) = np.ptp(stage.space.alone, axis=1), stage.space.speed
    assert width == pytest.approx(speed * stage.seconds / 4)
    center = stage.space.alone.mean()
    assert center == pytest.approx(300.0, rel=0.02)
    made = [
        choose.MENU[name](stage.space, 0, stage.seconds) for name in choose.MENU if name != "pairs"
    ]
    assert max(x.period for x in made) < 10 * stage.seconds


def test_an_axis_that_swings_keeps_its_range():
    stage = stage_of(turning(2.0))
    assert np.ptp(stage.space.alone) == pytest.approx(0.95 * 2.0, rel=0.03)


def test_motions_that_take_too_long_are_not_foreseen():
    stage = stage_of(turning(2.0))
    slow = replace(stage, space=replace(stage.space, speed=stage.space.speed * 1e-4))
    found = menu(None, slow, 0, ("range-strokes", "rests"))
    assert found == []
    with pytest.raises(ConfigError, match="too slow for their ranges"):
        decide(survey(found, None, slow), None, ())


def test_one_of_several_rivals_is_told_from_the_model_alone():
    """A third that only the model imitates had no other one to compare with: an internal error."""
    stage, base = stage_of(turning(2.0)), base_model(RobotSource("single-axis"))
    asked = choose.question(base, ("spring", "stribeck"), 0, stage)
    seen = survey(menu(asked, stage, 0, ("range-strokes", "rests")), asked, stage)
    alone, both = decide(seen, asked, ("spring",)), decide(seen, asked, ("spring", "stribeck"))
    assert alone.never == () and alone.options[0].verdict.odds >= both.options[0].verdict.odds > 0


def test_steps_of_a_coarse_encoder_are_no_accelerations_of_the_motion():
    """An arm behind 2^14 counts had been moved by a tenth of what its motors allow."""
    _, _, space = premium()
    wanted = choose.MENU["fast-strokes"](space, 0, 12.0)
    fine, coarse = (
        question.problem_of(wanted, PREMIUM, Rates(60.0, 20.0), np.full(3, x)) for x in (1e-9, 4e-4)
    )
    for a, b in zip(fine.motions, coarse.motions, strict=True):
        for x, y in ((a.q, b.q), (a.qd, b.qd), (a.qdd, b.qdd)):
            np.testing.assert_allclose(y, x, atol=1e-6 * np.abs(x).max())
    # what it resolves stays coarse: what is slower than that stands
    assert coarse.motions[0].resolution[0] > 5 * fine.motions[0].resolution[0]


@pytest.mark.parametrize(("rests_at", "moves_with"), [(1.2, 0.5), (0.0, 2.0), (0.3, 0.1)])
def test_the_largest_size_that_keeps_the_torque_is_found(monkeypatch, rests_at, moves_with):
    _, limits, space = premium()
    wanted = choose.MENU["fast-strokes"](space, 0, 12.0)
    seen = []

    def effort(motion):
        seen.append(float(np.ptp(motion.via[:, 0]) / np.ptp(wanted.via[:, 0])))
        return (rests_at + moves_with * seen[-1]) * limits.torque[None]

    monkeypatch.setattr(Stage, "foresee", lambda self, motion: motion)
    monkeypatch.setattr(question, "ready", lambda motion, question: motion)
    monkeypatch.setattr(question, "efforts", effort)
    _, problem, _ = within_limits(
        wanted, Stage(space, PREMIUM, Rates(60.0, 20.0), np.ones(3)), None
    )
    size = float(np.ptp(problem.via[:, 0]) / np.ptp(wanted.via[:, 0]))
    sizes = 0.9 ** np.arange(30)
    fits = sizes[rests_at + moves_with * sizes <= HEADROOM]
    assert size == pytest.approx(fits[0] if fits.size else sizes[-1])
    assert len(seen) == 2 or fits.size  # at any size it would be too much: asked of two of them


def test_a_motion_beside_the_middle_is_tried_at_every_size_between(monkeypatch):
    """Where the smallest breaks the torque limit, the largest that keeps it is taken."""
    _, limits, space = premium()
    wanted = choose.MENU["fast-strokes"](space, 0, 12.0)

    def effort(motion):
        size = float(np.ptp(motion.via[:, 0]) / np.ptp(wanted.via[:, 0]))
        return (0.1 if 0.3 < size < 0.5 else 2.0) * limits.torque[None]

    monkeypatch.setattr(Stage, "foresee", lambda self, motion: motion)
    monkeypatch.setattr(question, "ready", lambda motion, question: motion)
    monkeypatch.setattr(question, "efforts", effort)
    monkeypatch.setattr(question, "_passes_middle", lambda motion, space: False)
    _, problem, _ = within_limits(
        wanted, Stage(space, PREMIUM, Rates(60.0, 20.0), np.ones(3)), None
    )
    sizes = 0.9 ** np.arange(30)
    found = float(np.ptp(problem.via[:, 0]) / np.ptp(wanted.via[:, 0]))
    assert found == pytest.approx(sizes[sizes < 0.5][0])
