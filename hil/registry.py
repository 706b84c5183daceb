"""Registry: names in a rig file to drivers, controllers and simulators; strings until used.

Entry points of other distributions (plug-ins) join in.  What goes wrong in one says whose it is,
and spoils no other.
"""

from __future__ import annotations

import importlib
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from hil.errors import ConfigError, HilError, unknown
from hil.interrupt import Ended

#: group -> name -> module (with `Config` and `open_device` or `build`) or ``module:attribute``.
#: Entry points of the same groups join in.
BUILT_IN: dict[str, dict[str, str]] = {
    "hil.drivers": {
        "premium": "hil.drivers.premium",
        "ft-sensor": "hil.drivers.ft_sensor",
        "damiao": "hil.drivers.damiao",
        "haply": "hil.drivers.haply",
    },
    "hil.boxes": {
        "usb-quad08": "hil.drivers.usb_quad08.driver",
        "usb-31xx": "hil.drivers.usb_31xx.driver",
        "damiao-can": "hil.drivers.damiao_can",
        "haply-inverse": "hil.drivers.haply:BOX",
        "netcanoem": "hil.drivers.netcanoem.driver",
        "netft-can": "hil.drivers.netft_can",
        "netft-rdt": "hil.drivers.netft_rdt",
    },
    "hil.controllers": {
        "cartesian-coupling": "hil.controllers.cartesian:CARTESIAN_COUPLING",
        "computed-torque": "hil.controllers.joint_space:COMPUTED_TORQUE",
        "joint-coupling": "hil.controllers.joint_space:JOINT_COUPLING",
        "joint-pd": "hil.controllers.joint_space:JOINT_PD",
        "joint-tracking": "hil.controllers.joint_tracking",
        "delayed": "hil.controllers.delayed",
        "lawrence": "hil.controllers.lawrence",
        "position-force": "hil.controllers.position_force",
    },
    "hil.estimators": {
        "force": "hil.controllers.estimators.forces",
        "friction-network": "hil.controllers.estimators.network",
        "elastic-ukf": "hil.controllers.estimators.transmission",
    },
    "hil.taps": {"usb": "hil.drivers.usb_quad08.usb_tap", "hid": "hil.drivers.usb_31xx.hid_tap"},
    "hil.velocity": {
        "first-difference": "hil.signals.velocity:FirstDifference",
        "filtered-difference": "hil.signals.velocity:FilteredDifference",
        "foaw-end-fit": "hil.signals.velocity:FoawEndFit",
        "foaw-best-fit": "hil.signals.velocity:FoawBestFit",
        "kalman": "hil.signals.velocity:Kalman",
    },
    "hil.kinematics": {"phantom-premium-1.5": "hil.controllers.dynamics:premium"},
    "hil.exports": {
        "urdf": "hil.export.urdf:TARGET",
        "mjcf": "hil.export.simulators:MJCF",
        "sdf": "hil.export.simulators:SDF",
        "isaac": "hil.export.urdf:ISAAC",
        "c": "hil.export.code:C",
        "cpp": "hil.export.code:CPP",
        "python": "hil.export.code:PYTHON",
        "ros2": "hil.export.code:ROS2",
        "card": "hil.export.card:TARGET",
    },
    "hil.sim_devices": {},
    "hil.sim_sessions": {},
}


#: What stands behind a name of a group must have.
_PARTS: dict[str, tuple[str, ...]] = {
    "hil.drivers": ("Config", "open_device"),
    "hil.boxes": ("BUS", "Config", "open_box"),
    "hil.controllers": ("Config", "build"),
    "hil.estimators": ("Config", "build"),
}
#: Files of plug-ins that were loaded, with their group and name.
_FILES: dict[str, tuple[str, str]] = {}


def names(group: str) -> dict[str, str]:
    """All names of a group with where they live."""
    return {name: found[0].value for name, found in _installed(group).items()} | BUILT_IN[group]


@cache
def _installed(group: str) -> dict[str, list[EntryPoint]]:
    """Entry points of a group by name; reading those of all packages takes milliseconds."""
    found: dict[str, list[EntryPoint]] = {}
    for e in entry_points(group=group):
        same = found.setdefault(e.name, [])
        if all((e.value, _whose(e)) != (o.value, _whose(o)) for o in same):
            same.append(e)
    return found


def load(group: str, name: str) -> Any:
    """What stands behind `name` of `group`, imported now.

    Raises
    ------
    ConfigError
        If there is no such name, several plug-ins have it, or it cannot be imported.
    """
    known = names(group)
    if name not in known:
        kind = group.removeprefix("hil.").removesuffix("s")
        raise ConfigError(unknown("box" if kind == "boxe" else kind, name, known))
    _only(group, name)
    module, _, attribute = known[name].partition(":")
    with blaming(group, name, f"{name!r} of {group} cannot be imported"):
        try:
            found = importlib.import_module(module)
        except ImportError as error:
            if not own(group, name):
                raise
            raise ConfigError(f"{name!r} of {group} cannot be imported: {error}.") from error
        if not own(group, name):
            _FILES[str(getattr(found, "__file__", ""))] = group, name
        found = getattr(found, attribute) if attribute else found
    lacking = [part for part in _PARTS.get(group, ()) if not hasattr(found, part)]
    if lacking:
        raise ConfigError(
            f"{name!r} of {group} has no {' and no '.join(lacking)}; "
            f"{', '.join(_PARTS[group])} are needed. Mend {plug_in(group, name)}."
        )
    return found


def loadable(group: str) -> Iterator[tuple[str, Any]]:
    """Names of a group in order with what stands behind them; what is broken is left out."""
    for name in sorted(names(group)):
        try:
            found = load(group, name)
        except ConfigError:
            continue
        yield name, found


def own(group: str, name: str) -> bool:
    """Whether a name is of this package, and no plug-in's."""
    return name not in _installed(group) or names(group)[name].startswith("hil.")


def plug_in(group: str, name: str) -> str:
    """Whose a name is, e.g. ``the plug-in my-laws 1 (entry point coupling = coupling)``."""
    found = _installed(group).get(name)
    if not found:
        return "this package"
    return f"the plug-in {_whose(found[0])} (entry point {name} = {found[0].value} of {group})"


def _whose(entry: EntryPoint) -> str:
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist is not None else "of no name"


def _only(group: str, name: str) -> None:
    """Refuse a name that two have: which one runs a motor must not be left to an order."""
    found = [f"{_whose(e)} ({e.value})" for e in _installed(group).get(name, ())]
    if name in BUILT_IN[group]:
        found.insert(0, f"this package ({BUILT_IN[group][name]})")
    if len(found) > 1:
        raise ConfigError(
            f"{name!r} of {group} is several: of {' and of '.join(found)}; give the entry point "
            "of your own another name, or uninstall one of them."
        )


@contextmanager
def blaming(group: str, name: str, what: str, kind: type[HilError] = ConfigError) -> Iterator[None]:
    """Have an error of a plug-in say what failed and whose it is; other errors pass.

    Parameters
    ----------
    group, name : str
        Of the entry point.
    what : str
        Beginning of the sentence, e.g. ``device 'arm' cannot be opened``.
    kind : type of HilError
        What is raised.
    """
    try:
        yield
    except (HilError, Ended):
        raise
    except (Exception, SystemExit) as error:
        if own(group, name):
            raise
        raise kind(blamed(group, name, what, error)) from error


def blamed(group: str, name: str, what: str, error: BaseException) -> str:
    """Sentence of an error in a plug-in."""
    text = " ".join(str(error).split())
    said = f"{type(error).__name__}: {text}" if text else type(error).__name__
    place = _place(error, names(group)[name].partition(":")[0])
    return f"{what}: {said}{place and f' ({place})'}. Mend {plug_in(group, name)}."


def culprit(error: BaseException) -> str:
    """Sentence of an error that passed through the file of a plug-in; empty if it did not."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if frame.filename in _FILES:
            group, name = _FILES[frame.filename]
            return blamed(group, name, f"{name!r} of {group} failed", error)
    return ""


def _place(error: BaseException, module: str) -> str:
    """File, line and function of a plug-in that an error passed through last."""
    if isinstance(error, SyntaxError):
        return f"{error.filename}, line {error.lineno}"
    stem = module.partition(".")[0]
    frames = [
        f
        for f in traceback.extract_tb(error.__traceback__)
        if stem in (Path(f.filename).stem, *Path(f.filename).parts)
    ]
    return f"{frames[-1].filename}, line {frames[-1].lineno}, {frames[-1].name}" if frames else ""
