"""Outputs: looked at before the work begins, and never written over an input or a recording.

What the same command makes again (a report, a model, an imported session) may be replaced;
anything else that stands at the place is refused or kept aside.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import count
from pathlib import Path

from hil.errors import ConfigError, HilError
from hil.record.mcap_read import read_metadata
from hil.userfile import read_text


def check(
    path: str | Path | None,
    ending: str,
    inputs: Iterable[str | Path] = (),
    ours: Callable[[Path], bool] | None = None,
    what: str = "",
) -> None:
    """Refuse an output that cannot or must not be written; nothing is touched.

    Parameters
    ----------
    path : str, Path or None
        The output; None is no output.
    ending : str
        What its name must end in, e.g. ``".toml"``.
    inputs : iterable of str or Path
        Files that the command reads.
    ours : callable, optional
        Whether a file that is there may be replaced.
    what : str
        What may be replaced, e.g. ``"a model file"``.

    Raises
    ------
    ConfigError
        Before any work is done.
    """
    if path is None or path == "":
        return
    place = Path(path)
    if place.suffix.lower() != ending:
        raise ConfigError(
            f"cannot write {path}: this output must end in {ending}; nothing was touched"
        )
    refuse_input(place, inputs)
    writable(place)
    # a device, a pipe: nothing is lost by writing to it, and reading it may never end
    if ours is not None and place.is_file() and not ours(place):
        raise ConfigError(
            f"cannot write {path}: a file is there that is not {what}; nothing was touched, "
            "choose another name or move it away"
        )


def refuse_input(path: Path, inputs: Iterable[str | Path]) -> None:
    """Refuse an output that is one of the inputs, also by another name or link."""
    for source in inputs:
        given = Path(source)
        same = given.resolve() == path.resolve()
        if same or (given.exists() and path.exists() and given.samefile(path)):
            raise ConfigError(
                f"cannot write {path}: it is the same file as the input {source}; nothing was "
                "touched, choose another name"
            )


def writable(path: Path) -> None:
    """Refuse a place where no file can be written, by trying; what is there stays as it is."""
    folder = path.resolve().parent
    if not folder.is_dir():
        raise ConfigError(f"cannot write {path}: folder {folder} does not exist; make it first")
    if path.is_dir():
        raise ConfigError(f"cannot write {path}: it is a folder; name a file in it")
    there = path.exists()
    try:
        # a pipe that nobody reads is an error, and no reason to wait
        os.close(os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK, 0o666))
        if not there:
            path.resolve().unlink()
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror}; choose another place") from error


def make_folder(path: str | Path) -> Path:
    """A folder for outputs, made with those above it where it is not there.

    Parameters
    ----------
    path : str or Path
        The folder.

    Raises
    ------
    ConfigError
        If a file is in the way, or the folder cannot be made.
    """
    folder = Path(path)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise ConfigError(
            f"cannot write into {folder}: a folder is needed, and a file is there; name another"
        ) from error
    except OSError as error:
        raise ConfigError(
            f"cannot make the folder {folder}: {error.strerror}; choose another place"
        ) from error
    return folder


@contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Give an error of the operating system the name of the output, which a full disk omits."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def is_model(path: Path) -> bool:
    """Whether a file is a model file, or empty."""
    from hil.models import files  # the catalogue of effects, only where a file is there

    return files.is_model(path)


def is_report(path: Path) -> bool:
    """Whether a file is a report of `hil`, or empty."""
    from hil.report import html  # plotly's, so only where a file is there

    return html.is_report(path)


def same_text(path: Path, text: str) -> bool:
    """Whether a file holds this text, however its lines end."""
    try:
        return read_text(path) == text.replace("\r\n", "\n")
    except (OSError, ValueError):
        return False


def keep_old(path: Path) -> None:
    """Move a session that stands at the output's place aside: no recording is written over."""
    if not path.exists():
        return
    if path.is_dir():
        raise ConfigError(f"cannot write {path}: it is a folder; name a file in it")
    # only where a file is there
    from hil.record.recovery import in_use
    from hil.runtime.watchdog import report_path

    if in_use(path):
        raise ConfigError(
            f"cannot write {path}: another process is writing this session; nothing was touched, "
            "end that one or choose another name"
        )
    number = next(n for n in count(1) if not path.with_suffix(f".{n}{path.suffix}").exists())
    aside = path.with_suffix(f".{number}{path.suffix}")
    path.rename(aside)
    if report_path(path).exists():  # what the watchdog did goes with the session that it ended
        report_path(path).rename(report_path(aside))
    sys.stderr.write(f"{path} was there already; it is kept as {aside}\n")


def keep_unless(path: Path, record: str, expected: Mapping[str, str]) -> None:
    """Keep an old session aside unless its metadata say that this command makes it again.

    Parameters
    ----------
    path : Path
        Output.
    record : str
        Name of the metadata record that says where a session is from.
    expected : mapping of str to str
        What it holds in a session that may be replaced.
    """
    if not path.exists():
        return
    try:
        found = read_metadata(path).get(record, {})
    except HilError:  # no session, or a damaged one: not for us to judge
        found = {}
    if not all(found.get(key) == value for key, value in expected.items()):
        keep_old(path)


def refuse_urdf(path: str | Path | None, urdf: str) -> None:
    """Refuse a model whose URDF would be written over another file beside it.

    Raises
    ------
    ConfigError
        If that file exists and holds something else.
    """
    if not path or not urdf:
        return
    beside = Path(path).with_suffix(".urdf")
    if beside.exists() and not same_text(beside, urdf):
        raise ConfigError(
            f"cannot write {path}: its robot goes into {beside} beside it, where another file is; "
            "nothing was touched, move that file away or choose another name"
        )
