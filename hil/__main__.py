"""The program `hil`, also as ``python -m hil``; Ctrl-C is arranged before anything is imported."""

from __future__ import annotations

import sys
from typing import NoReturn

from hil.interrupt import CODE, interrupts


def program() -> NoReturn:
    """Run the command line and end the process."""
    interrupts.arm()
    from hil.cli import main
    from hil.commands.terminal import Quoting

    # for good: the interpreter prints the traceback of --debug after this
    sys.stdout, sys.stderr = Quoting(sys.stdout), Quoting(sys.stderr)
    code = main()
    if code == CODE:
        interrupts.end()
    sys.exit(code)


if __name__ == "__main__":
    program()
