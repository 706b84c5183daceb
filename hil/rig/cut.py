"""The program that takes the power off the motors: proven before it is needed.

What can be known without running it: that it is there, may be run, and is a program or a script
whose interpreter is there.  That it switches the right thing off is shown by `hil selftest`, which
runs it.
"""

from __future__ import annotations

import os
import shutil
import struct
from pathlib import Path

from hil.errors import ConfigError
from hil.rig.config import SafetyConfig
from hil.userfile import open_regular

#: Times without a tick that a watchdog can tell from ordinary delays, and that make sense [s].
SHORTEST, LONGEST = 0.02, 10.0
#: Largest program that is taken for one, most that its words may have together [byte].
LARGEST, LONGEST_WORDS = 2**28, 2**14
#: How a compiled program begins: Linux and BSD, macOS (three kinds).
_ELF = b"\x7fELF"
_MAGIC = (_ELF, b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe", b"\xfe\xed\xfa\xcf")
#: Kinds of an ELF file that can be started: a program, and one that lies anywhere.
_STARTED = (2, 3)


def proven(safety: SafetyConfig) -> tuple[str, ...]:
    """Words of the cut program, its place absolute; empty where the rig has no watchdog.

    Raises
    ------
    ConfigError
        If there is a watchdog without a program, a program without a watchdog, a time that no
        watchdog can keep, or the program could not be run.
    """
    words = safety.cut
    if not safety.watchdog:
        if words:
            raise ConfigError(
                f"[safety]: cut = {list(words)} is never run, because watchdog = 0; give the time "
                "without a tick after which it is, e.g. watchdog = 0.1"
            )
        return ()
    if not words or not words[0]:
        raise ConfigError(
            f"[safety]: watchdog = {safety.watchdog:g} has no program to run; give what takes the "
            'power off, e.g. cut = ["usbrelay", "HW554_1=0"]'
        )
    if not SHORTEST <= safety.watchdog <= LONGEST:
        raise ConfigError(
            f"[safety]: watchdog = {safety.watchdog:g} s; {SHORTEST} to {LONGEST:g} s is needed: "
            "an ordinary process is kept waiting for milliseconds, and no arm may run on for long"
        )
    _words(words)
    return (str(_program(words[0], f"[safety] cut: {words[0]!r}")), *words[1:])


def _words(words: tuple[str, ...]) -> None:
    """Refuse what no program can be given: a zero byte, or more than the system passes on."""
    long = sum(len(word.encode()) for word in words)
    held = next((word for word in words if "\0" in word), "")
    if held or long > LONGEST_WORDS:
        why = f"{held!r} holds a zero byte, which no program can be given"
        if not held:
            why = f"its words have {long} bytes, at most {LONGEST_WORDS}; put them into a script"
        raise ConfigError(f"[safety] cut: {why}. The watchdog could not take the power off.")


def _program(name: str, what: str) -> Path:
    """Absolute path of a program that could be run; `what` begins the sentence if it could not."""
    found = shutil.which(name)
    if found is None:
        place = Path(name)
        if place.is_dir():
            why = "is a folder"
        elif place.exists():
            why = f"may not be run; 'chmod +x {name}' allows it"
        elif os.sep in name:
            why = "does not exist"
        else:
            why = "is not found in any folder of PATH; give its whole path or install it"
        raise ConfigError(f"{what} {why}. The watchdog could not take the power off.")
    path = Path(found).resolve()
    try:
        with open_regular(path, LARGEST) as file:
            head = file.readline(256)
    except OSError as error:
        raise ConfigError(
            f"{what} cannot be read ({error.strerror}), so it cannot be known what would run. "
            "The watchdog could not take the power off."
        ) from error
    if head.startswith(b"#!"):
        if head.endswith(b"\r\n"):
            raise ConfigError(
                f"{what} has the line ends of Windows, with which no interpreter is found; save it "
                "with those of Unix. The watchdog could not take the power off."
            )
        _interpreter(head[2:].decode("utf-8", "replace").split(), what)
    elif not head.startswith(_MAGIC):
        raise ConfigError(
            f"{what} is neither a program nor a script: its first line must be #! and its "
            "interpreter, e.g. #!/bin/sh. The watchdog could not take the power off."
        )
    elif head.startswith(_ELF):
        _whole(path, what)
    return Path(found).absolute()


def _whole(path: Path, what: str) -> None:
    """Refuse a compiled program that is cut off, or none that can be started.

    Source: Tool Interface Standard, Executable and Linking Format 1.2, 1-4 (header).
    """
    with open_regular(path, LARGEST) as file:
        head, size = file.read(64), path.stat().st_size
    wide, order = head[4:5] == b"\x02", ">" if head[5:6] == b"\x02" else "<"
    if len(head) == 64 and head[4:5] in (b"\x01", b"\x02"):
        kind = struct.unpack_from(f"{order}H", head, 16)[0]
        # place of the program headers; how long one is, and how many there are
        start = struct.unpack_from(f"{order}{'Q' if wide else 'I'}", head, 32 if wide else 28)[0]
        each, count = struct.unpack_from(f"{order}HH", head, 54 if wide else 42)
        if kind in _STARTED and count and start + each * count <= size:
            return
    raise ConfigError(
        f"{what} begins like a program, but is damaged or cut off. The watchdog could not take the "
        "power off."
    )


def _interpreter(words: list[str], what: str) -> None:
    """Refuse a script whose interpreter, or what `env` is to find for it, is not there."""
    plain = [w for w in words[1:] if not w.startswith("-") and "=" not in w]
    asked = [words[0], *plain[:1]] if words and Path(words[0]).name == "env" else words[:1]
    missing = [w for w in asked if shutil.which(w) is None]
    if missing or not asked:
        raise ConfigError(
            f"{what} is a script for {missing[0] if missing else 'nothing'}, which cannot be run. "
            "The watchdog could not take the power off."
        )
