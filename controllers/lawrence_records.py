"""What the kernels of the Lawrence law take: its constants, friction tables and scratch."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from hil.controllers import compensation, ela
from hil.controllers.lawrence_config import SHAPES, LawrenceConfig
from hil.estimate import compensation_tables
from hil.models import catalogue

_F = np.float64
#: Scratch of one tick.
WORK = np.dtype([
    ("tip", _F, (2, 3)), ("jacobian", _F, (2, 3, 3)), ("signals", _F, (2, 3, ela.SIGNALS)),
    ("heard", _F, (3, ela.SIGNALS)), ("force", _F, (3,)), ("push", _F, (3,)),
    ("goal", _F, (3,)), ("bend", _F, (3,)), ("impulse", _F, (3,)), ("room", _F, (6, 3)),
    ("pull", _F, (2, 3)), ("square", _F, (3, 3)), ("rub", _F, (2, 3)),
    ("known", _F, (len(compensation.VARIABLES),)),
])  # fmt: skip


def constants(config: LawrenceConfig, period: float) -> Any:
    """Record of what does not change, for the kernels."""
    n = len(config.friction_speeds)
    kind = np.dtype([
        ("gains", _F, (3, ela.GAINS)), ("masses", _F, (2, 3)), ("models", _F, (2, 8)),
        ("shares", _F, (3,)), ("lengths", _F, (2,)), ("period", _F), ("shape", np.int64),
        ("observer", _F), ("share", _F), ("estimated", np.int64),
        ("speeds", _F, (max(n, 1),)), ("friction", _F, (2, 3, max(n, 1))),
    ])  # fmt: skip
    c = np.zeros(1, kind)[0]
    c["gains"], c["masses"] = config.gains(), config.masses()
    c["models"] = np.stack([config.leader_model, config.follower_model])
    c["shares"], c["lengths"], c["period"] = config.shares(period), config.lengths, period
    c["observer"] = 2 * np.pi * config.observer_hz
    c["share"], c["estimated"] = config.friction_share, config.forces == "estimated"
    c["shape"] = SHAPES.index(config.shape)
    if n:
        c["speeds"] = config.friction_speeds
        c["friction"][0] = np.reshape(config.leader_friction, (3, n))
        c["friction"][1] = np.reshape(config.follower_friction, (3, n))
    return c


def friction_of(config: LawrenceConfig) -> tuple[tuple[Any, Any, Any], ...]:
    """Terms, presliding and table values of leader and follower, for the kernels."""
    catalogue.load_files(config.plugins)
    both = (
        (config.leader_effects, config.leader_span), (config.follower_effects, config.follower_span)
    )  # fmt: skip
    found = (_tables(tuple(effects.items()), tuple(span)) for effects, span in both)
    return tuple((t.terms, t.slips, t.values) for t in found)


@lru_cache(maxsize=8)
def _tables(
    values: tuple[tuple[str, float], ...], span: tuple[float, ...]
) -> compensation_tables.Tables:
    """Tables, made once: an operator who sets a parameter makes a new law while the loop runs."""
    return compensation_tables.tables(dict(values), span)
