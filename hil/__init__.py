"""Haptic teleoperation rigs in Python, and the physics that their models miss.

>>> import hil                                               # doctest: +SKIP
>>> run = hil.load("run1.mcap")                              # doctest: +SKIP
>>> model = hil.base_model(run.robot)                        # doctest: +SKIP
>>> hil.diagnose(run, model).verdict                         # doctest: +SKIP
'missing-effect'
>>> hil.fit(run, model + "stribeck").relative                # doctest: +SKIP
"""

from __future__ import annotations

# nothing is imported here: until the program has arranged for Ctrl-C, one prints a traceback
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from hil.diagnosis.engine import diagnose
    from hil.diagnosis.verbs import add, compare, fit, ladder
    from hil.identify.simulated import refine
    from hil.models.files import read_model, write_model
    from hil.models.model import RobotModel, Use, base_model
    from hil.record.arrays import from_arrays
    from hil.record.recording import Recording
    from hil.record.sources import load

_WHERE = {
    "load": "hil.record.sources",
    "from_arrays": "hil.record.arrays",
    "Recording": "hil.record.recording",
    "RobotModel": "hil.models.model",
    "Use": "hil.models.model",
    "base_model": "hil.models.model",
    "read_model": "hil.models.files",
    "write_model": "hil.models.files",
    "fit": "hil.diagnosis.verbs",
    "compare": "hil.diagnosis.verbs",
    "diagnose": "hil.diagnosis.verbs",
    "add": "hil.diagnosis.verbs",
    "ladder": "hil.diagnosis.verbs",
    "refine": "hil.identify.simulated",
    "widget": "hil.studio.notebook",
}

#: Public modules by the package that holds them.
_MODULES = {
    "errors": ("hil.errors",),
    "models": ("hil.models.effect", "hil.models.motion", "hil.models.parts"),
    "rig": ("hil.rig.config",),
    "signals": ("hil.signals.bus", "hil.signals.device", "hil.signals.settable"),
    "studio": ("hil.studio.notebook",),
    "testing": ("hil.testing",),
}

__all__ = [
    "Recording",
    "RobotModel",
    "Use",
    "add",
    "base_model",
    "compare",
    "diagnose",
    "fit",
    "from_arrays",
    "ladder",
    "load",
    "read_model",
    "refine",
    "widget",
    "write_model",
]


def __getattr__(name: str) -> Any:
    """Load a public name at first use, so that `import hil` costs nothing."""
    if name == "__version__":
        from importlib.metadata import version

        return version("hil-teleop")
    if name not in _WHERE and name not in _MODULES:
        raise AttributeError(f"module 'hil' has no attribute {name!r}")
    import importlib

    if name in _MODULES:
        for module in _MODULES[name]:
            importlib.import_module(module)
        return importlib.import_module(f"hil.{name}")
    found = getattr(importlib.import_module(_WHERE[name]), name)
    if isinstance(found, type):
        return found
    from hil.errors import public

    return public(found)


def __dir__() -> list[str]:
    """The public names; what happens to be imported is not listed."""
    return sorted([*__all__, *_MODULES, "__doc__", "__version__"])
