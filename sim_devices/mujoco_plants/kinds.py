"""Names of all hidden effects: what each needs, and between which amplitudes it is itself."""

from __future__ import annotations

from hil.sim_devices.mujoco_plants import drives, laws, sensors, structure

#: Smallest and largest amplitude where nothing else is said.
USUAL = (0.0, 60.0)

#: ``"force"``: a measured force; ``"arm"``: more than one joint; ``"runs"``: a run with and one
#: without; ``"urdf"``: a described robot with its weight on some joint.
NEEDS = {
    "coupled-friction": "arm",
    "torque-crosstalk": "arm",
    "coupled-transmission": "arm",
    "payload": "runs",
    "payload-change": "urdf",
    "outside-slosh": "urdf",
    "torque-gain": "force",
    "filter-lag": "force",
    "force-bias": "force",
    "force-drift": "force",
    "force-gain": "force",
    "force-crosstalk": "force",
}

RANGES = {
    "friction-drift": (0.0, 40.0),
    "torque-saturation": (0.05, 8.0),
    "torque-gain": (0.0, 8.0),
    "torque-ripple": (0.0, 8.0),
    "actuator-lag": (0.1, 6.0),
    "delay": (0.1, 5.0),
    "elastic-transmission": (0.15, 8.0),
    "hardening-cable": (0.15, 8.0),
    "encoder-eccentricity": (0.0, 30.0),
    "end-stop": (0.02, 200.0),
    "load-friction": (0.0, 8.0),
    "outside-warm-gain": (0.0, 8.0),
    "filter-lag": (0.1, 6.0),
}

NAMES = sorted(
    {"payload-change"}.union(
        laws.MOTOR,
        laws.LINK,
        drives.DRIVES,
        sensors.ENCODERS,
        sensors.RECORDED,
        structure.SHAFTS,
        structure.STRUCTURES,
    )
)


def kinds() -> dict[str, tuple[str, float, float]]:
    """Name -> what it needs, smallest and largest amplitude."""
    return {name: (NEEDS.get(name, ""), *RANGES.get(name, USUAL)) for name in NAMES}
