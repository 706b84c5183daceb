"""The simulated bench: arms, operator and gel in one world, seen through ideal wires.

A wire answers at signal level: encoder counts and gauge words in, DAC codes out.  The world
advances by whole ticks when a device is read at a later time, whatever the clock.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, unknown
from hil.signals.bus import Bus
from hil.signals.device import Status
from hil.sim_devices.plants import build, world
from hil.sim_devices.plants.layout import GEL, NOISES, OPERATOR, SUBSTEPS
from hil.sim_devices.quadrature import Quadrature

#: Ticks whose random numbers are drawn at once: few, so that no tick is much longer than others.
BLOCK = 16


class Bench:
    """World of one session.

    Parameters
    ----------
    arms : dict of str to str
        Name of every arm -> name of its force sensor.
    section : dict
        Table ``[simulation]`` of the rig file.
    period_ns : int
        Tick of the loop [ns].
    seed : int
        Noise of this session; `hidden_seed` in `section` chooses random hidden effects.
    """

    def __init__(
        self, arms: dict[str, str], section: dict[str, Any], period_ns: int, seed: int
    ) -> None:
        self.names, self.sensors, self.seed = list(arms), dict(arms), seed
        self.period_ns = period_ns
        self.now_ns = 0
        plan = build.plan(arms, section, seed)
        self.parameters, self.state = plan.parameters, plan.state
        self.operators, self.gels = plan.operators, plan.gels
        if self.operators.dtype != OPERATOR or self.gels.dtype != GEL:
            raise ConfigError("[simulation]: operator or gel has another layout.")
        n = len(self.names)
        self.codes = np.zeros((n, 3), np.int64)
        self.counts = np.zeros((n, 3), np.int64)
        self.gauges = np.zeros((n, 6), np.int64)
        self._rng = np.random.default_rng([seed, 0x5EED])
        self._noise = np.zeros((BLOCK, n, NOISES))
        self._left = 0
        #: Called with the time [ns] before and after every tick: devices at wire level.
        self.before: list[Callable[[int], None]] = []
        self.after: list[Callable[[int], None]] = []
        for i in range(n):
            world.sense(
                self.parameters[i],
                self.state[i],
                0.0,
                np.zeros(NOISES),
                self.counts[i],
                self.gauges[i],
            )
        self.encoders = self._bad_encoders(dict(section.get("quadrature", {})))
        if self.encoders:
            self.after.append(self._read_encoders)

    def _bad_encoders(self, table: dict[str, Any]) -> dict[int, Quadrature]:
        """Arm -> encoders as edges, from ``[simulation.quadrature]``; none where it is empty."""
        if not table:
            return {}
        keys = {"arm": "", "lines": 1024, "phase_error": 0.0, "dirty": [], "decoder_hz": 1e7}
        table = build.with_defaults("simulation.quadrature", table, keys)
        arm = table.pop("arm")
        if arm and arm not in self.names:
            raise ConfigError(f"[simulation.quadrature]: {unknown('arm', arm, self.names)}")
        found = {i: Quadrature(3, **table) for i, n in enumerate(self.names) if arm in ("", n)}
        for i, encoder in found.items():
            encoder.reset(self.place(i))
        return found

    def place(self, i: int) -> NDArray[np.float64]:
        """Where the encoders of arm i stand (3,) [quarter lines]."""
        return np.asarray(self.state["qm"][i] * self.parameters["encoder"][i])

    def _read_encoders(self, now_ns: int) -> None:
        """What the decoders of encoders that are emulated as edges make of the tick."""
        for i, encoder in self.encoders.items():
            encoder.advance(self.place(i), self.period_ns * 1e-9)
            self.counts[i] = encoder.counts

    def wire(self, arm: str) -> Wire:
        """Wire to the devices of one arm."""
        if arm not in self.names:
            raise ConfigError(unknown("simulated arm", arm, self.names))
        return Wire(self, self.names.index(arm))

    def buses(self, plan: dict[str, dict[str, Any]]) -> dict[str, Bus]:
        """Simulated buses, by kind, with the boxes of `plan` on them."""
        from hil.sim_devices.wired import WiredBench  # the libraries of the buses, where needed

        self.wired = WiredBench(self, plan)
        return self.wired.buses

    def park(self, arm: int, still: bool) -> None:
        """Hold an arm where it is, as its dock does, or let it go."""
        self.state["parked"][arm] = int(still)
        if still:
            self.state["v"][arm] = self.state["vm"][arm] = 0.0

    def advance(self, t_ns: int) -> None:
        """Run the world up to `t_ns`, in whole ticks."""
        while self.now_ns + self.period_ns <= t_ns:
            for act in self.before:
                act(self.now_ns)
            if self._left == 0:
                self._rng.standard_normal(out=self._noise)
                self._left = BLOCK
            world.run(
                self.parameters,
                self.state,
                self.operators,
                self.gels,
                self.now_ns * 1e-9,
                self.period_ns * 1e-9,
                SUBSTEPS,
                self.codes,
                self._noise[BLOCK - self._left],
                self.counts,
                self.gauges,
            )
            self._left -= 1
            self.now_ns += self.period_ns
            for act in self.after:
                act(self.now_ns)


class Wire:
    """Ideal wire to one arm: what arrives is what was sent.

    Attributes
    ----------
    counts, gauges : ndarray (3,), (6,) of int
        Last answer; the arrays stay the same objects.
    trouble : str
        Empty: an ideal wire is never lost.
    """

    trouble = ""

    def __init__(self, bench: Bench, index: int) -> None:
        self._bench = bench
        self._index = index
        self.counts = bench.counts[index]
        self.gauges = bench.gauges[index]
        self._codes = bench.codes[index]

    def home(self, counts: NDArray[np.int64]) -> None:
        """Nothing to do: an ideal encoder is absolute."""

    def receive(self, t_ns: int) -> Status:
        """Refresh `counts` and `gauges` for time `t_ns`."""
        self._bench.advance(t_ns)
        return Status.OK

    def send(self, codes: NDArray[np.int64]) -> None:
        """Set the DAC codes (3,) that hold until the next call."""
        self._codes[:] = codes

    def power(self, on: bool) -> None:
        """Switch the amplifiers; without power the arm rests in its dock."""
        self._bench.park(self._index, not on)
        self._codes[:] = 0

    def close(self) -> None:
        """Nothing to release."""


def open_bench(arms: dict[str, Any], section: dict[str, Any], period_ns: int, seed: int) -> Any:
    """Open the simulated bench (entry point ``ideal`` of ``hil.sim_devices``).

    `arms` are the names of force sensors on arms that the bench knows, or descriptions of others.
    """
    if not all(isinstance(arm, str) for arm in arms.values()):
        from hil.sim_devices.joints.bench import JointBench  # its physics, where an arm needs them

        return JointBench(arms, section, period_ns, seed)
    return Bench(arms, section, period_ns, seed)
