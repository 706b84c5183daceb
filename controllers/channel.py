"""Communication channel: which sample has arrived by which tick; constant, varying, lossy.

Every tick one packet leaves; it arrives after its own delay or never.  The receiver holds the
newest packet that it has.  The schedule is drawn once from a seed and repeats.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

#: Ticks after which a schedule repeats.
CYCLE = 8192


@dataclass(frozen=True)
class ChannelConfig:
    """One direction of the link.

    Parameters
    ----------
    delay : float
        Shortest delay [s], rounded to whole ticks.
    jitter : float
        Packets take up to so much longer [s], uniformly distributed.
    loss : float
        Share of packets that never arrive, 0 to below 1.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0

    def __post_init__(self) -> None:
        if self.delay < 0.0 or self.jitter < 0.0 or not 0.0 <= self.loss < 1.0:
            raise ConfigError("channel: delay and jitter must not be negative, 0 <= loss < 1.")
        if self.delay + self.jitter > 2.0:
            raise ConfigError("channel: at most 2 s of delay and jitter.")


def schedule(config: ChannelConfig, period: float, seed: int) -> NDArray[np.int64]:
    """Age in ticks of the newest packet that has arrived, per tick of a cycle (CYCLE,).

    Parameters
    ----------
    config : ChannelConfig
        The link.
    period : float
        Tick [s].
    seed : int
        Of jitter and loss.
    """
    rng = np.random.default_rng([seed, 0xC4A])
    base = round(config.delay / period)
    # two cycles, so that the second one starts with packets under way
    n = 2 * CYCLE
    travel = base + np.floor(rng.uniform(0.0, config.jitter / period + 1e-12, n)).astype(np.int64)
    arrives = np.where(rng.uniform(size=n) < config.loss, n + CYCLE, np.arange(n) + travel)
    newest = np.full(n, -1, np.int64)
    sent = np.flatnonzero(arrives < n)
    np.maximum.at(newest, arrives[sent], sent)
    newest = np.maximum.accumulate(newest)
    age: NDArray[np.int64] = (np.arange(n) - newest)[CYCLE:]
    return age


def mean_delay(config: ChannelConfig, period: float, seed: int = 0) -> float:
    """Mean age of what the receiver acts on [s], jitter and losses included."""
    return float(schedule(config, period, seed).mean() * period)
