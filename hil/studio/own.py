"""A user's own effect from the studio's editor: agreed to, written, checked, in the catalogue.

The text runs as a Python program with the user's rights.  It runs only in the process that
computes, and only after the user has agreed to this very text.
"""

from __future__ import annotations

import tempfile
from collections.abc import Collection, Iterable
from pathlib import Path

from hil import consent
from hil.errors import ConfigError
from hil.models import catalogue
from hil.testing import check_effect

#: Largest text of the editor [character].
LARGEST = 12_000
TEMPLATE = '''"""One effect of our own."""

from hil.models.effect import Doc, Effect, Param


class EyeletDrag(Effect):
    """A cable that drags over a fixed eyelet."""

    name, family = "eyelet-drag", "friction"
    doc = Doc(
        equation="tau = fe (q - q_low) tanh(v / v0)",
        signature="friction that grows from one end of the range to the other",
        confused_with=("position-friction", "load-friction"),
        shown_by="slow strokes over the whole range, both directions",
        source="where it comes from",
    )
    params = (Param("fe", "{F}/{x}", "friction per wound-up angle", 0.0),)

    def columns(self, motion, j, shape):
        wound = motion.q[:, j] - motion.span[j, 0]
        return (wound * motion.sign(j))[:, None]


EFFECTS = (EyeletDrag(),)
'''


def again(paths: Iterable[str]) -> None:
    """Load the effects that models name into a new process; only what was agreed to runs."""
    for path in paths:
        catalogue.load_plugin(Path(path), said_in=Path(path))


def learn(
    path: Path, text: str, agreed: bool, ours: bool, needed: Collection[str] = ()
) -> list[str]:
    """Write, load and check the effects of an editor; their names.

    Parameters
    ----------
    path : Path
        File to write, ending in ``.py``.
    text : str
        Its content.
    agreed : bool
        Whether the user agreed that this text runs.
    ours : bool
        Whether the file was written by this studio, and may be written over.
    needed : collection of str
        Effects that the models have; a text that no longer holds one of its own is refused.

    Raises
    ------
    ConfigError
        If the user has not agreed, or the file must not be written, holds no effects, or
        lacks one that is needed; the file and the catalogue are as before.
    ConformanceError
        If an effect breaks the contract; the catalogue is as before.
    """
    if not agreed:
        raise ConfigError(
            "this text runs as a program with your rights; agree to it below the editor first"
        )
    if path.suffix != ".py" or not path.stem.isidentifier():
        raise ConfigError(f"cannot write {path}: a file of effects is called NAME.py")
    if len(text) > LARGEST:
        raise ConfigError(f"the text has {len(text)} characters; at most {LARGEST} are taken")
    source = text.encode()
    if path.exists() and not ours and path.read_bytes() != source:
        raise ConfigError(f"cannot write {path}: a file is there; choose another name")
    consent.give(consent.plugin(path, source))
    # tried elsewhere first: one that never ends must not be loaded again by the next process
    with tempfile.TemporaryDirectory() as folder:
        trial = Path(folder) / path.name
        trial.write_bytes(source)
        names = _load(trial, needed)
    try:
        path.write_bytes(source)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}") from error
    return names


def _load(path: Path, needed: Collection[str]) -> list[str]:
    """Names of the effects of a file, checked; the catalogue is as before where one fails."""
    table = catalogue.table()
    before = dict(table)
    module = f"hil_plugin_{path.stem}"
    try:
        for name in [n for n, e in table.items() if type(e).__module__ == module]:
            del table[name]  # an effect that was renamed in the editor
        catalogue.load_plugin(path, said_in=path)
        names = [n for n, e in table.items() if type(e).__module__ == module]
        for name in names:
            check_effect(table[name])
        if gone := sorted(set(needed) & set(before) - set(table)):
            raise ConfigError(
                f"a model has {', '.join(gone)}, which this text no longer holds; keep the name, "
                "or keep the new effect in a file of its own"
            )
    except BaseException:
        table.clear()
        table.update(before)
        raise
    return names
