"""The program `hil`, also as ``python -m hil``; Ctrl-C is arranged before anything is imported.

A file of the user may have the name of a module of Python, e.g. a ``json.py`` in a folder of
PYTHONPATH.  Python imports that file instead, and anything may fail from then on.  Such files are
looked for only when something has failed.
"""

from __future__ import annotations

# built into the interpreter: nothing is read before a handler stands
import _signal  # type: ignore[import-not-found]
import os
import sys

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn


def _at_once(number: int, frame: object) -> None:
    """Ctrl-C before `hil.interrupt` is there."""
    os.write(2, b"hil: interrupted\n")
    os._exit(130)


def _keep_places() -> None:
    """Open what is closed of the three standard streams, to nowhere.

    The next file that is opened, a session, would be in its place, and take what is printed.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free
    if sys.stdin is None:
        sys.stdin = open(0, closefd=False)


def in_place_of_python(error: BaseException) -> str:
    """Sentence about a file that was imported instead of a module of Python; empty if none was.

    Parameters
    ----------
    error : BaseException
        What went wrong.
    """
    found = _hiding()
    passed, trace = set(), error.__traceback__
    while trace is not None:
        passed.add(trace.tb_frame.f_code.co_filename)
        trace = trace.tb_next
    if isinstance(error, SyntaxError):
        passed.add(str(error.filename))
    loaded = {str(getattr(module, "__file__", "")) for module in list(sys.modules.values())}
    blamed = [path for path in found if path in passed] or [
        path for path in found if path in loaded
    ]
    if not blamed:
        return ""
    name = found[blamed[0]]
    return (
        f"{blamed[0]!a} takes the place of Python's own module {name}; rename it, or take its "
        "folder off PYTHONPATH"
    )


def _hiding() -> dict[str, str]:
    """Files that Python finds before its own, with the module whose name they have."""
    own, found = os.path.realpath(os.path.dirname(os.__file__)), {}
    for folder in sys.path:
        if os.path.realpath(folder) == own:
            break
        try:
            folder = folder or os.getcwd()
            names = sorted(os.listdir(folder))
        except OSError:
            continue
        for entry in names:
            name = entry.removesuffix(".py")
            if name in sys.stdlib_module_names:
                inside = "" if entry.endswith(".py") else "__init__.py"
                found[os.path.join(folder, entry, inside).rstrip(os.sep)] = name
    return found


def _away_from_here() -> None:
    """Import nothing of the working directory, which ``python -m`` puts before all else."""
    try:
        here = os.getcwd()
    except OSError:  # it was deleted
        return
    own = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
    if sys.flags.safe_path:  # it is not there, or the user has put it there
        return
    if sys.path and sys.path[0] == here and not os.path.samefile(here, own):
        del sys.path[0]


def _refuse(error: BaseException) -> NoReturn:
    """Leave with one line where such a file is to blame; raise the error for anything else."""
    said = "" if "--debug" in sys.argv else in_place_of_python(error)
    if not said:
        raise error
    os.write(2, f"hil: {said}\n".encode())
    os._exit(2)


try:
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _at_once)
except ValueError:  # imported outside of the main thread, which alone gets signals
    pass

if __name__ == "__main__":
    _away_from_here()

try:
    from hil.interrupt import CODE, interrupts
except (Exception, SystemExit) as error:
    _refuse(error)


def program() -> NoReturn:
    """Run the command line and end the process."""
    _keep_places()
    interrupts.arm()
    try:
        from hil.cli import main
        from hil.terminal import Quoting

        # for good: the interpreter prints the traceback of --debug after this
        sys.stdout, sys.stderr = Quoting(sys.stdout), Quoting(sys.stderr)
    except (Exception, SystemExit) as error:
        _refuse(error)
    try:
        code = main(suspect=in_place_of_python)
    except Exception as error:
        _refuse(error)
    if code == CODE:
        interrupts.end()
    interrupts.done(code)
    sys.exit(code)


if __name__ == "__main__":
    program()
