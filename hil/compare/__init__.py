"""Comparison: where a model fails, and which physical effect is missing.

The package is callable: `hil.compare(runs, model)` is `hil.compare.analysis.compare`, so that
the verb of the Python API and the package of that name are one.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class _Verb(ModuleType):
    """A module that can be called."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Compare a model with recordings; see `hil.compare.analysis.compare`."""
        from hil.compare.analysis import compare

        return compare(*args, **kwargs)


sys.modules[__name__].__class__ = _Verb
