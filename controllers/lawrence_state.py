"""State of the Lawrence law from tick to tick: its names, and where each part starts.

The kernels are compiled with these offsets, and the cache of numba looks at their own file alone:
who changes something here deletes controllers/__pycache__.
"""

from __future__ import annotations

from hil.controllers.lawrence_config import AXES

_ARMS = ("leader", "follower")
_JOINTS = (1, 2, 3)
#: Of one axis: where it started, and the memory of `ela.sense`.
_FILTERS = ("origin", "velocity", "raw", "acceleration", "force", "on")
#: Of one arm: the momentum observer of `hil.controllers.observer`.
_OBSERVER = (
    *(f"impulse{j}" for j in _JOINTS),
    *(f"sent{j}" for j in _JOINTS),
    *(f"observed_{axis}" for axis in AXES),
)
#: Of one arm: friction with a state, `hil.controllers.compensation`.
_SLIP = (
    *(f"last{j}" for j in _JOINTS),
    *(f"slip{j}_{e}" for j in _JOINTS for e in (1, 2, 3)),
)
NAMES = (
    "started",
    *(f"{arm}_{what}_{axis}" for arm in _ARMS for axis in AXES for what in _FILTERS),
    *(f"{arm}_estimate_{axis}" for arm in _ARMS for axis in AXES),
    *(f"{arm}_{what}" for arm in _ARMS for what in _OBSERVER),
    *(f"{arm}_{what}" for arm in _ARMS for what in _SLIP),
)
#: Where the filters, the law's estimates of the forces, the momentum observer's memory and the
#: memory of friction with a state start; the leader's, then the follower's.
FIRST_FILTER = NAMES.index("leader_origin_x")
FIRST_ESTIMATE = NAMES.index("leader_estimate_x")
FIRST_OBSERVED = NAMES.index("leader_impulse1")
FIRST_SLIP = NAMES.index("leader_last1")
