"""The program that takes the power off the motors: proven before it is needed.

What can be known without running it: that it is there, may be run, and is a program or a script
whose interpreter is there.  That it switches the right thing off is shown by `hil selftest`, which
runs it.
"""

from __future__ import annotations

import os
import shutil
import struct
import sys
from pathlib import Path
from typing import BinaryIO

from hil.errors import ConfigError
from hil.rig.config import SafetyConfig
from hil.trusted_code import found_by_env, interpreted, quoted_command
from hil.userfile import open_regular

#: Times without a tick that a watchdog can tell from ordinary delays, and that make sense [s].
_SHORTEST, _LONGEST = 0.02, 10.0
#: Largest program that is taken for one, most that its words may have together [byte].
_LARGEST, _LONGEST_WORDS = 2**28, 2**14
#: How a compiled program begins: Linux and BSD, macOS (three kinds).
_ELF = b"\x7fELF"
_MACH = (b"\xcf\xfa\xed\xfe", b"\xca\xfe\xba\xbe", b"\xfe\xed\xfa\xcf")
#: Kinds of an ELF file that are run, kinds of its segments: what is loaded, who loads it.
_RUN, _LOAD, _LOADER = (2, 3), 1, 3
#: Most segments of a program.
_SEGMENTS = 1000


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
    if not _SHORTEST <= safety.watchdog <= _LONGEST:
        raise ConfigError(
            f"[safety]: watchdog = {safety.watchdog:g} s; {_SHORTEST} to {_LONGEST:g} s is needed: "
            "an ordinary process is kept waiting for milliseconds, and no arm may run on for long"
        )
    _words(words)
    program = str(_program(words[0], f"[safety] cut: {words[0]!r}"))
    _given((program, *words[1:]))
    return (program, *words[1:])


def _given(words: tuple[str, ...]) -> None:
    """Refuse a command whose interpreter is given a script that is not there."""
    inner = found_by_env(words)
    what = f"[safety] cut: {quoted_command(words)!r}"
    if inner is not words and (not inner or shutil.which(inner[0]) is None):
        raise ConfigError(
            f"{what} is to run {inner[0] if inner else 'nothing'}, which is not found. "
            "The watchdog could not take the power off."
        )
    script = interpreted(words)
    if script and not os.path.isfile(script):
        raise ConfigError(
            f"{what} is to run the script {script!r}, which does not exist; give its whole path. "
            "The watchdog could not take the power off."
        )


def _words(words: tuple[str, ...]) -> None:
    """Refuse what no program can be given: a zero byte, or more than the system passes on."""
    long = sum(len(word.encode()) for word in words)
    held = next((word for word in words if "\0" in word), "")
    if held or long > _LONGEST_WORDS:
        why = f"{held!r} holds a zero byte, which no program can be given"
        if not held:
            why = f"its words have {long} bytes, at most {_LONGEST_WORDS}; put them into a script"
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
        with open_regular(path, _LARGEST) as file:
            head = file.readline(256)
            broken = _broken(file) if head.startswith(_ELF) else ""
    except OSError as error:
        raise ConfigError(
            f"{what} cannot be read ({error.strerror}), so it cannot be known what would run. "
            "The watchdog could not take the power off."
        ) from error
    if head.startswith(b"#!"):
        _interpreter(head[2:].decode("utf-8", "replace").rstrip("\n"), what)
    elif broken:
        raise ConfigError(
            f"{what} is a damaged program ({broken}), which cannot be run; install it again. "
            "The watchdog could not take the power off."
        )
    elif not head.startswith(_MACH if sys.platform == "darwin" else _ELF):
        raise ConfigError(
            f"{what} is neither a program nor a script: its first line must be #! and its "
            "interpreter, e.g. #!/bin/sh. The watchdog could not take the power off."
        )
    return Path(found).absolute()


def _broken(file: BinaryIO) -> str:
    """Why an ELF file cannot be run here; empty where nothing speaks against it."""
    size = os.fstat(file.fileno()).st_size
    file.seek(0)
    head = file.read(64)
    if len(head) < 64 or head[4] not in (1, 2) or head[5] != 1 + (sys.byteorder == "big"):
        return "its header is not whole, or of another kind of machine"
    wide, order = head[4] == 2, "<" if sys.byteorder == "little" else ">"
    (kind,) = struct.unpack_from(f"{order}H", head, 16)
    (start,) = struct.unpack_from(order + "IQ"[wide], head, 32 if wide else 28)
    each, count = struct.unpack_from(f"{order}HH", head, 54 if wide else 42)
    if kind not in _RUN or not 0 < count <= _SEGMENTS or each != (56 if wide else 32):
        return "its header is not that of a program"
    if start + count * each > size:
        return "it is cut off"
    file.seek(start)
    table, loads = file.read(count * each), 0
    for at in range(0, len(table), each):
        (segment,) = struct.unpack_from(f"{order}I", table, at)
        if segment not in (_LOAD, _LOADER):
            continue
        at += 8 if wide else 4
        offset, length = struct.unpack_from(f"{order}Q16xQ" if wide else f"{order}I8xI", table, at)
        if offset + length > size:
            return "it is cut off"
        loads += segment == _LOAD
        file.seek(offset)
        loader = file.read(min(length, 4096)).rstrip(b"\0") if segment == _LOADER else b"/"
        if not os.path.exists(loader):
            return f"it needs {os.fsdecode(loader)!r}, which does not exist"
    return "" if loads else "nothing of it would be loaded"


def _interpreter(line: str, what: str) -> None:
    """Refuse a script whose interpreter, or what `env` is to find for it, is not there.

    The system takes the line as it is: it ends in LF, a CR belongs to the last word, and a name
    without a folder is not looked for in PATH.
    """
    if "\r" in line:
        raise ConfigError(
            f"{what} is a script whose first line ends in CR LF, so its interpreter is not found; "
            "save it with LF line ends. The watchdog could not take the power off."
        )
    words = [w for w in line.replace("\t", " ").split(" ") if w]
    if words and not os.path.isabs(words[0]):
        raise ConfigError(
            f"{what} is a script for {words[0]!r}, which is looked for in the working directory "
            f"alone; give its whole path, e.g. #!/usr/bin/env {words[0]}. "
            "The watchdog could not take the power off."
        )
    plain = [w for w in words[1:] if not w.startswith("-") and "=" not in w]
    asked = [words[0], *plain[:1]] if words and Path(words[0]).name == "env" else words[:1]
    missing = [w for w in asked if shutil.which(w) is None]
    if missing or not asked:
        raise ConfigError(
            f"{what} is a script for {missing[0] if missing else 'nothing'}, which cannot be run. "
            "The watchdog could not take the power off."
        )
