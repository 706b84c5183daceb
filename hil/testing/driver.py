"""Check that a driver keeps the contract which the loop, the safety and the user rely on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from hil.signals.device import Device
from hil.testing.bench import Bench
from hil.testing.driverchecks import CHECKS
from hil.testing.effects import ConformanceError
from hil.testing.far import FarEnd, Tolerance

__all__ = ["Checked", "FarEnd", "Tolerance", "check_driver"]


@dataclass
class Checked:
    """What was checked, and what was not because the far end cannot do it.

    Parameters
    ----------
    done, skipped : list of str
        Names of checks.
    """

    done: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)


def check_driver(
    open_device: Callable[[], Device],
    far: FarEnd,
    *,
    period: float = 1e-3,
    settle: float = 0.05,
    tolerance: Tolerance | None = None,
) -> Checked:
    """Check states, time-outs, unplugging, bad frames, units, signs and zero on exit.

    Parameters
    ----------
    open_device : callable
        Opens the driver on the far end; called anew for every check.
    far : FarEnd
        The other side of the wire.
    period, settle : float
        Time between ticks; time after which the far end has what was sent, and the driver what
        was measured [s].
    tolerance : Tolerance, optional
        How near is near.

    Returns
    -------
    Checked
        What was checked, and what the far end could not do.

    Raises
    ------
    ConformanceError
        With a sentence that says what is wrong and what was expected.
    """
    checked = Checked()
    for name, (needs, kinds, check) in CHECKS.items():
        missing = [m for m in needs if not far.can(m)]
        bench = Bench(open_device, far, period, settle, tolerance or Tolerance())
        try:
            applies = any(isinstance(bench.device, kind) for kind in kinds)
            if applies and not missing:
                check(bench)
        finally:
            bench.device.close()
        if applies:
            (checked.skipped if missing else checked.done).append(name)
    if not checked.done:
        raise ConformanceError("the driver measures nothing and moves nothing: see hil.signals")
    return checked
