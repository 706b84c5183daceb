"""What the loop compensates, from fitted models of any effects."""

import numpy as np
import pytest

from hil.errors import ConfigError
from hil.estimate import compensation as kernels
from hil.estimate import compensation_tables
from hil.models import catalogue
from hil.models.effect import terms_of
from hil.models.model import Range, RobotModel, Use, Value
from hil.models.motion import Motion
from hil.models.phantom import Premium
from hil.record.recording import RobotSource

ROBOT = RobotSource("phantom-premium-1.5")
SPAN = [-0.6, 0.7] * 3
RIGID = Use(
    "rigid-body",
    values={
        f"rigid-body.{n}": Value(float(v))
        for n, v in zip(Premium.names, Premium.prior, strict=True)
    },
)
#: Shapes of a likely size, where the effect's own grid depends too much on the motion.
SHAPES = {
    "friction-drift": (10.0, 0.0),
    "offset-drift": (10.0, 0.0),
    "gain-drift": (10.0, 0.0),
    "friction-network": (1.0, 2.0, 2.0),
    "end-stop": (0.3, 1.0),
    "two-stops": (0.2, -0.1),
    "presliding": (2e-3, 0.0, 0.02, 0.0),
    "position-friction": (2.2,),
    "cogging": (5.3,),
    "second-cogging": (7.7,),
    "backlash": (1e-2, 0.0, 0.01, 0.0),
    "torque-ripple": (5.3,),
    "load-friction": (0.0, 0.0),
    "load-viscous": (0.0,),
    "coupled-load-friction": (2.0, 0.0),
    "stribeck": (0.12, 2.0),
    "coulomb": (0.02,),
}
REFUSED = {
    "rigid-body", "armature", "payload", "payload-change", "base-tilt", "tip-impedance",
    "coupled-transmission", "coupled-spring", "differential", "contact-stiffness",
    "contact-damping", "contact-hardening", "contact-hysteresis", "contact-inclusion",
    "periodic-disturbance", "force-bias", "force-drift", "force-gain", "force-crosstalk",
    "encoder-eccentricity", "missed-counts", "joint-zero", "joint-ratio", "filter-lag",
    "elastic-transmission",
    "variable-inertia",
    "hardening-cable", "backlash", "vibration-mode", "delay", "actuator-lag", "capstan-friction",
    "relaxation", "record-delay",
    # a memory, an acceleration, or more joints than a table holds
    "correction-hysteresis", "correction-relaxation", "correction-load", "correction-joint",
    "generic-gravity", "generic-posture", "generic-inertia",
    "generic-parallel", "generic-swing", "generic-centrifugal", "generic-reach", "generic-loop",
}  # fmt: skip


def use(name, at, **values):
    return Use(
        name, (f"joint{at}",), {}, {f"j{at}.{name}.{k}": Value(v) for k, v in values.items()}
    )


def ride(n=3000):
    """A motion of three joints at 1 kHz within SPAN, with loads."""
    rng, t = np.random.default_rng(7), np.arange(n) * 1e-3
    w, phase = 2 * np.pi * rng.uniform(0.3, 2.0, (3, 4)), rng.uniform(0, 6.28, (3, 4))
    angle = w * t[:, None, None] + phase
    q = 0.05 + 0.14 * np.sin(angle).sum(-1)
    qd = 0.14 * (w * np.cos(angle)).sum(-1)
    load = 0.2 * np.sin(3.1 * angle).sum(-1)
    return Motion(
        t=t, q=q, qd=qd, qdd=np.zeros((n, 3)), tau=load, tau_ext=np.zeros((n, 3)), load=load,
        static=0.3 * load, v0=np.full(3, compensation_tables.SIGN_SPEED),
        resolution=np.full(3, 1e-3),
        span=np.reshape(SPAN, (3, 2)), contact=np.full((3, 2), np.nan), robot=Premium(()),
        temperature=np.full((n, 3), 20.0),
    )  # fmt: skip


def values_of(effect, motion, j=1):
    grid = effect.search.grid(motion, j)
    shape = SHAPES.get(effect.name, grid[len(grid) // 2])
    theta = 0.01 * np.cos(np.arange(len(terms_of(effect, motion, j)))) + 0.02
    given = {
        f"j{j + 1}.{effect.name}.{p.name}": float(v)
        for p, v in zip(effect.shape, shape, strict=True)
    }
    given |= {
        f"j{j + 1}.{effect.name}.{p.name}": float(v)
        for p, v in zip(terms_of(effect, motion, j), theta, strict=True)
    }
    return given, shape, theta


def loop(tables, motion):
    """Torques (n, 3) of the loop's kernel, tick by tick."""
    out, past, now = np.zeros((motion.n, 3)), np.zeros(12), np.zeros(12)
    z = np.zeros(len(kernels.VARIABLES))
    for k in range(motion.n):
        z[:13] = *motion.q[k], *motion.qd[k], *motion.load[k], *motion.static[k], motion.t[k]
        kernels.friction(k > 0, z, tables.terms, tables.slips, tables.values, past, now, out[k])
        past, now = now, past
    return out


@pytest.mark.parametrize("name", sorted(catalogue.table()))
def test_the_loop_computes_what_the_library_does_or_says_why_not(name):
    """Every effect of the catalogue: equal torques tick by tick, or a refusal by name."""
    effect, motion = catalogue.get(name), ride()
    given, shape, theta = values_of(effect, motion)
    if name in REFUSED:
        with pytest.raises(ConfigError, match=f"'{name}' cannot be compensated"):
            compensation_tables.tables(given, SPAN)
        return
    wanted = effect.columns(motion, 1, shape) @ theta
    found = loop(compensation_tables.tables(given, SPAN), motion)
    assert np.ptp(wanted) > 0 or name == "torque-offset"
    # the kink of a stop lies between knots
    miss = 0.06 if name in ("end-stop", "two-stops") else 0.012
    np.testing.assert_allclose(found[:, 1], wanted, atol=miss * np.abs(wanted).max())
    assert not found[:, [0, 2]].any()


@pytest.mark.parametrize("form", [0.0, 1.0])
def test_presliding_has_the_state_of_the_library(form):
    motion = ride()
    shape, theta = (1.5e-3, form, 0.02, 0.0), np.array([0.002, 0.004, 0.003, 0.002])
    names = ("s", "form", "v0", "vs", "f0", "f1", "f2", "f3")
    given = {f"j3.presliding.{n}": float(v) for n, v in zip(names, (*shape, *theta), strict=True)}
    found = loop(compensation_tables.tables(given), motion)[:, 2]
    wanted = catalogue.get("presliding").columns(motion, 2, shape) @ theta
    np.testing.assert_allclose(found, wanted, atol=2e-5)


def test_lugre_s_form_is_refused_by_name():
    names = ("s", "form", "v0", "vs", "f0", "f1", "f2", "f3")
    values = (1.5e-3, 2.0, 0.02, 0.1, 0.002, 0.004, 0.003, 0.002)
    given = {f"j3.presliding.{n}": v for n, v in zip(names, values, strict=True)}
    with pytest.raises(ConfigError, match=r"'presliding' cannot be compensated.*LuGre"):
        compensation_tables.tables(given)


def test_all_effects_of_a_fitted_model_go_into_the_loop():
    effects = (
        RIGID,
        use("coulomb", 2, fc=0.01, v0=0.02),
        use("viscous", 2, fv=0.002),
        use("coupled-friction", 3, fk=0.01, vk=0.0, joint=1.0, mode=1.0),
    )
    model = RobotModel(ROBOT, effects)
    np.testing.assert_allclose(compensation_tables.rigid_parameters(model), Premium.prior)
    motion = ride(500)
    found = loop(compensation_tables.tables(compensation_tables.compensated_values(model)), motion)
    v = motion.qd
    np.testing.assert_allclose(
        found[:, 1], 0.01 * np.tanh(v[:, 1] / 0.02) + 0.002 * v[:, 1], atol=1e-4
    )
    np.testing.assert_allclose(found[:, 2], 0.01 * np.tanh((v[:, 0] + v[:, 2]) / 0.02), atol=1e-4)


def test_refusals_say_what_is_missing():
    def said(match, *effects, **more):
        with pytest.raises(ConfigError, match=match):
            compensation_tables.compensated_values(RobotModel(ROBOT, (RIGID, *effects), **more))

    smooth = {"t0": 0.1, **{f"c{k}": 0.01 for k in range(1, 7)}}
    said("relative to the range of positions", use("position-torque", 1, **smooth))
    ranges = tuple(Range(f"joint{j}", (-0.6, 0.7), (-1, 1), (-1, 1)) for j in (1, 2, 3))
    known = RobotModel(ROBOT, (RIGID, use("position-torque", 1, **smooth)), valid=ranges)
    assert len(compensation_tables.compensated_values(known)) == 7
    said("its fc on joint 2 are unknown", use("coulomb", 2, v0=0.02))
    said("unknown", Use("viscous"))
    rubs = use("load-friction", 1, mu=0.1, of=1.0, i=0.0)
    said("the load that it refers to holds spring", rubs, use("spring", 1, k=0.2, t0=0.0))
    said("temperature", use("friction-drift", 1, T=60.0, of=1.0, dc=0.01, dv=0.0))


EYELET = """
from hil.models.effect import Doc, Effect, Param


class LoopEyelet(Effect):
    name, family = "loop-eyelet", "friction"
    doc = Doc(
        equation="tau = fe (q - q_low) tanh(v / v0)",
        signature="friction that grows from one end of the range to the other",
        shown_by="slow strokes over the whole range",
        source="notebook",
    )
    params = (Param("fe", "{F}/{x}", "friction per wound-up angle", 0.0),)

    def columns(self, motion, j, shape):
        return ((motion.q[:, j] - motion.span[j, 0]) * motion.sign(j))[:, None]


EFFECTS = (LoopEyelet(),)
"""


def test_a_users_own_effect_is_compensated_as_any_other(tmp_path, monkeypatch):
    monkeypatch.setattr(catalogue, "_table", dict(catalogue.table()))
    plugin = tmp_path / "eyelet.py"
    plugin.write_text(EYELET, encoding="utf-8")
    ranges = tuple(Range(f"joint{j}", (-0.6, 0.7), (-1, 1), (-1, 1)) for j in (1, 2, 3))
    model = RobotModel(
        ROBOT, (RIGID, use("loop-eyelet", 1, fe=0.02)), valid=ranges, plugins=(str(plugin),)
    )
    motion = ride(500)
    found = loop(
        compensation_tables.tables(
            compensation_tables.compensated_values(model), compensation_tables.span(model)
        ),
        motion,
    )
    wanted = (
        0.02 * (motion.q[:, 0] + 0.6) * np.tanh(motion.qd[:, 0] / compensation_tables.SIGN_SPEED)
    )
    np.testing.assert_allclose(found[:, 0], wanted, atol=1e-4)


def test_a_model_without_values_or_of_another_robot_is_refused():
    with pytest.raises(ConfigError, match="hil fit"):
        compensation_tables.rigid_parameters(RobotModel(ROBOT, (Use("rigid-body"),)))
    with pytest.raises(ConfigError, match="single-axis"):
        compensation_tables.rigid_parameters(RobotModel(RobotSource("single-axis"), (RIGID,)))


@pytest.mark.parametrize("span", [[np.nan, 1.0] * 3, [0.5, -0.5] * 3, [-0.5, 0.5], [0.0] * 5])
def test_a_span_that_is_none_is_refused(span):
    with pytest.raises(ConfigError, match="span = "):
        compensation_tables.tables({}, span)
