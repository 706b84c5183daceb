"""One identification session on request (entry point ``phantom`` of ``hil.sim_sessions``)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.sim_devices.fast import effects, kernel, sensors
from hil.sim_devices.fast.layout import ARM, STATE
from hil.sim_devices.plants import arm, truth
from hil.sim_devices.plants.layout import NOISES, SUBSTEPS

FloatArray = NDArray[np.float64]
TICK = 1e-3
#: Torque noise [N m] of the two colours, alike below 20 Hz: at 5 Hz corner, and white at 1 kHz.
NOISE = {"coloured": (1.0e-3, 5e-4), "white": (0.0, 4.0e-3)}
#: Gains of the joint controller: stiffness, damping, nominal gravity, inertia, friction.
GAINS = np.array(
    [
        [8.0, 8.0, 4.0],
        [0.14, 0.14, 0.07],
        [0.0, 0.08, 0.0],
        [0.0035, 0.003, 0.0013],
        [0.012, 0.011, 0.010],
    ]
)
VELOCITY_FILTER = 3e-3
SENSOR = "nano17"


def simulate(
    reference: FloatArray,
    push: FloatArray | None,
    hidden: list[dict[str, Any]],
    noise: str,
    seed: int,
    locked: bool = False,
) -> dict[str, FloatArray]:
    """Record one session at 1 kHz.

    Parameters
    ----------
    reference : ndarray (n, 3, 3)
        Place, speed and acceleration of every joint [rad, rad/s, rad/s^2].
    push : ndarray (n, 3) or None
        True force ON the tip, base frame [N]; measured where given.
    hidden : list of dict
        ``effect``, ``joint`` (0..2), ``amplitude`` of every hidden effect.
    noise : str
        ``"white"`` or ``"coloured"``.
    seed : int
        Of all noise.
    locked : bool
        Whether joints 2 and 3 are clamped.

    Returns
    -------
    dict
        ``t`` (n,) [s], ``q``, ``qd``, ``tau`` (n, 3) [rad, rad/s, N m], ``wrench`` (n, 6) if
        there is a force.
    """
    p, chain = plant(hidden, noise, locked)
    n = len(reference)
    rng = np.random.default_rng([seed, 0xFA57])
    out = np.zeros((n, 9))
    kernel.run(
        p[0],
        start(p, reference[0, :, 0])[0],
        reference,
        GAINS,
        1.0 - float(np.exp(-TICK / VELOCITY_FILTER)),
        np.zeros((n, 3)) if push is None else push,
        rng.standard_normal((n, NOISES)),
        TICK,
        SUBSTEPS,
        out,
    )
    q = sensors.late(out[:, :3], chain.get("lag", 0.0), int(chain.get("joint", 0)), TICK)
    found: dict[str, FloatArray] = {}
    found |= {
        "t": TICK * np.arange(n, dtype=np.float64),
        "q": q,
        "qd": out[:, 3:6],
        "tau": out[:, 6:],
    }
    if push is not None:
        found["wrench"] = sensors.force(push, out[:, :3], chain, rng, TICK)
    return found


def plant(
    hidden: list[dict[str, Any]], noise: str, locked: bool
) -> tuple[NDArray[np.void], dict[str, float]]:
    """Record (1,) of the arm with its hidden effects, and the amplitudes of sensor effects."""
    nominal = truth.arm(truth.load("nominal"), SENSOR, np.zeros((6, 6)))
    p = np.zeros(1, ARM)
    for name in nominal.dtype.names or ():
        p[name] = nominal[name]
    p["noise_low"], p["noise_white"] = NOISE[noise]
    p["locked"] = int(locked)
    chain: dict[str, float] = {}
    for row in hidden:
        effects.apply(p, chain, row)
    return p, chain


def start(p: NDArray[np.void], home: FloatArray) -> NDArray[np.void]:
    """State (1,) at rest at `home` (3,) [rad]."""
    x = np.zeros(1, STATE)
    x["qm"][0], x["q"][0], x["osc"][0, :, 0] = home, home, home
    # idlers of the pairs (1, 2), (2, 3), (1, 3)
    x["idle"][0, :, 0] = home[[0, 1, 0]] + home[[1, 2, 2]]
    x["flip"], x["thick"] = 1.0, 1.0
    arm.tip(p[0], x[0])
    return x


def kinds() -> dict[str, tuple[str, float, float]]:
    """What may be hidden -> what it needs, its smallest and largest amplitude (`Law`)."""
    return {name: (law.needs, law.least, law.most) for name, law in effects.EFFECTS.items()}
