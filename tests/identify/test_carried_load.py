"""A load that laws multiply is that of the masses and springs that are fitted, and as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plants
import pytest

import hil
from hil.record.recording import RobotSource

#: Motor and link [kg m^2], spring [N m/rad], its damping [N m s/rad], weight of the link [N m].
MOTOR, LINK, SPRING, DAMPING, WEIGHT = 0.09, 0.28, 180.0, 0.6, 9.0
DT, PARTS = 4e-3, 8


def swinging(seed: int, weight: float, seconds: float = 24.0):
    """A link of 4 Hz on a spring, moved through it by a servo that knows nothing of the link."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds / DT) * PARTS) * DT / PARTS
    wanted, speed, _ = plants.sines(
        t,
        2 * np.pi * np.array([0.3, 0.9, 2.1, 3.1]),
        np.array([0.4, 0.2, 0.06, 0.04]),
        rng.uniform(0, 6.28, 4),
    )
    rise = np.clip(t / 3, 0, 1)
    wanted, speed = rise * wanted, rise * speed + (t < 3) * wanted / 3
    m = vm = link = vl = 0.0
    h, q, tau = DT / PARTS, [], []
    for k in range(t.size):
        effort = 60.0 * (wanted[k] - m) + 6.0 * (speed[k] - vm)
        pull = SPRING * (m - link) + DAMPING * (vm - vl)
        if k % PARTS == 0:
            q.append(m)
            tau.append(effort)
        vm += h * (effort - pull - 0.9 * np.tanh(vm / 0.01) - 0.35 * vm) / MOTOR
        vl += h * (pull - weight * np.sin(link)) / LINK
        m, link = m + h * vm, link + h * vl
    noise = 0.05 * rng.standard_normal(len(tau))
    return plants.single(f"swing{seed}", t[::PARTS], np.array(q), np.array(tau) + noise)


@pytest.mark.parametrize("weight", [0.0, WEIGHT])
def test_a_spring_near_its_resonance_is_as_good_on_another_run(weight: float) -> None:
    run, other = swinging(1, weight), swinging(2, weight)
    model = hil.base_model(run.robot) + "elastic-transmission"
    fitted = hil.fit([run], model + "unbalance" if weight else model)
    as_it_is = fitted.model.as_it_is()
    own, seen = (float(hil.fit([r], as_it_is).relative[0]) for r in (run, other))
    # what the written values foretell of the fitted run is what the fit has left of it
    assert own == pytest.approx(float(fitted.relative[0]), rel=0.05)
    assert seen < 1.5
    k, a = (fitted.values[f"j1.elastic-transmission.{n}"] for n in ("k", "a"))
    assert k.value * a.value == pytest.approx(SPRING, rel=0.03)
    if weight:  # only the weight tells the motor's inertia from the link's
        assert abs(k.value - SPRING) < 3 * k.stderr


#: The same link on a motor, as somebody describes it: a weight of 3 kg, 0.3 m below its axis.
DESCRIBED = (
    '<robot name="swing"><link name="world"/><link name="link"><inertial><origin xyz="0 0 -0.3"/>'
    '<mass value="3"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    '</inertial></link><joint name="joint1" type="revolute"><parent link="world"/>'
    '<child link="link"/><axis xyz="0 -1 0"/>'
    '<limit lower="-3" upper="3" effort="9" velocity="30"/></joint></robot>'
)


def test_what_a_run_does_not_show_of_a_described_link_stays_as_described() -> None:
    run = replace(swinging(1, WEIGHT), robot=RobotSource("", DESCRIBED))
    fitted = hil.fit([run], hil.base_model(run.robot) + "elastic-transmission")
    values = {n.rpartition(".")[2]: v.value for n, v in fitted.values.items() if "rigid" in n}
    for name, described in {"m": 3.0, "my": 0.0, "Ixx": 0.28, "Ixy": 0.0, "Izz": 0.01}.items():
        assert values[name] == pytest.approx(described, rel=1e-6, abs=1e-6), name
    # the inertia about the axis and the weight are seen
    assert values["Iyy"] == pytest.approx(LINK, rel=0.03)
    assert values["mz"] == pytest.approx(-WEIGHT / 9.81, rel=0.1)


def rubbing(seed: int):
    """An axis on a bundle of 6 N m/rad about -0.3 rad that rubs with a third of what it pulls."""

    def bundle(t, q, v, a):
        pull = 6.0 * (q + 0.3)
        return pull + 0.33 * np.abs(pull) * np.tanh(v / 0.02)

    return plants.smooth_axis(seed, 12.0, 250.0, bundle)


@pytest.mark.parametrize("law", ["spring", "position-torque"])
def test_friction_of_a_load_is_of_what_springs_pull_too(law: str) -> None:
    """Whatever holds the constant: a motor's offset and a spring's own are one value."""
    run, other = rubbing(3), rubbing(4)
    fitted = hil.fit([run], hil.base_model(run.robot) + law + "load-friction")
    mu = fitted.values["j1.load-friction.mu"]
    assert fitted.values["j1.load-friction.of"].value < 2.0
    assert mu.value == pytest.approx(0.33, rel=0.02)
    as_it_is = fitted.model.as_it_is()
    own, seen = (float(hil.fit([r], as_it_is).relative[0]) for r in (run, other))
    assert own == pytest.approx(float(fitted.relative[0]), rel=0.05)
    assert seen < 1.1 * own if law == "spring" else seen < 1.5 * own


def test_the_load_at_rest_of_a_given_model_holds_its_springs() -> None:
    """With the values as they are, what rubs is a share of what the spring pulls."""
    run = rubbing(3)
    fitted = hil.fit([run], hil.base_model(run.robot) + "spring" + "load-friction").model

    def left(mu: float) -> float:
        given = {"j1.load-friction.mu": mu, "j1.load-friction.of": 1.0, "j1.load-friction.i": 0.0}
        values = [
            {k: replace(v, value=given.get(k, v.value)) for k, v in use.values.items()}
            for use in fitted.effects
        ]
        uses = [replace(u, values=v) for u, v in zip(fitted.effects, values, strict=True)]
        model = replace(fitted, effects=tuple(uses)).as_it_is()
        return float(hil.fit([run], model).relative[0])

    assert left(0.33) < 0.2 * min(left(0.0), left(0.66))
