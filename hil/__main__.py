"""The program `hil`, also as ``python -m hil``; Ctrl-C is arranged before anything is imported."""

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


try:
    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _at_once)
except ValueError:  # imported outside of the main thread, which alone gets signals
    pass

from hil.interrupt import CODE, interrupts  # noqa: E402


def program() -> NoReturn:
    """Run the command line and end the process."""
    interrupts.arm()
    from hil.cli import main
    from hil.terminal import Quoting

    # for good: the interpreter prints the traceback of --debug after this
    sys.stdout, sys.stderr = Quoting(sys.stdout), Quoting(sys.stderr)
    code = main()
    if code == CODE:
        interrupts.end()
    interrupts.done(code)
    sys.exit(code)


if __name__ == "__main__":
    program()
