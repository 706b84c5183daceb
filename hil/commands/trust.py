"""`hil trust`: agree to what a model or a rig file would run, as it is now.

What a file would run is listed without running it, by `hil info` as well.
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil import trusted_code
from hil.errors import ConfigError
from hil.rig.config import SafetyConfig
from hil.rig.cut import proven
from hil.rigs import packaged
from hil.toml import parse
from hil.trusted_code import Executable
from hil.userfile import LARGEST_TEXT, parse_toml, read_bytes, read_text

EXAMPLE = "hil trust my-model.toml my-rig.toml"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("files", nargs="+", metavar="FILE.toml", help="model and rig files")
    what = parser.add_mutually_exclusive_group()
    what.add_argument(
        "--show", action="store_true", help="list what they would run, change nothing"
    )
    what.add_argument("--forget", action="store_true", help="take the agreement back")
    parser.add_argument("--json", action="store_true", help="the list as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """List what the files would run, and remember that the user agrees to it."""
    found = [(path, what) for path in args.files for what in executables(Path(path))]
    for _, what in found if not args.show else ():
        (trusted_code.withdraw if args.forget else trusted_code.give)(what)
    if args.json:
        rows = [{"file": path, **entry(what)} for path, what in found]
        sys.stdout.write(json.dumps({"schema": "hil.trust/1", "executables": rows}) + "\n")
        return 0
    for path, what in found:
        sys.stdout.write(f"{path}: {list_line(what)}\n")
    for path in args.files:
        if path not in {p for p, _ in found}:
            sys.stdout.write(f"{path}: runs nothing\n")
    return 0


def entry(what: Executable) -> dict[str, object]:
    """One row of a JSON list."""
    found = {"kind": what.kind, "runs": what.text, "imports": list(what.parts)}
    return {**found, "sha256": what.digest, "agreed": what.trusted}


def list_line(what: Executable) -> str:
    """One line of a list."""
    agreed = "agreed to" if what.trusted else "NOT agreed to; to agree: hil trust"
    brings = f", which imports {', '.join(what.parts)}" if what.parts else ""
    return f"{what.kind} {what.text}{brings} ({agreed})"


def executables(path: Path) -> list[Executable]:
    """What a model or rig file would run.

    Raises
    ------
    ConfigError
        If it is neither, or what it names is not there.
    """
    path = packaged(path)
    try:
        table = parse_toml(read_text(path))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path} cannot be read as a model or rig file: {error}") from error
    try:
        if str(table.get("schema")).startswith("hil.model/"):
            return [_plugin((path.parent / name).resolve()) for name in plugins(table)]
        if str(table.get("schema")).startswith("hil.rig/"):
            words = proven(_safety(table))
            return [trusted_code.cut_program(words)] if words else []
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    raise ConfigError(
        f"{path} is neither a model nor a rig file: it must start with schema = "
        '"hil.model/1" or schema = "hil.rig/1"'
    )


def named_in_session(attachments: Mapping[str, bytes]) -> list[str]:
    """What the model and the rig file within a session name; nothing of it is looked up or run."""
    found = []
    for name, content in attachments.items():
        if name not in ("model.toml", "rig.toml"):
            continue
        try:
            table = parse_toml(content.decode())
            texts = [f"plugin {p if p.isprintable() else repr(p)}" for p in plugins(table)]
            words = _safety(table).cut
        except (ConfigError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            found.append(f"{name} cannot be read: {error}")
            continue
        texts += [f"cut program {trusted_code.quoted_command(words)}"] if words else []
        found += [f"{name} names {text}" for text in texts]
    return found


def plugins(table: Mapping[str, Any]) -> list[str]:
    """Python files that a model names."""
    names = table.get("plugins", [])
    if not isinstance(names, list) or any(not isinstance(n, str) or "\0" in n for n in names):
        raise ConfigError(f"plugins = {names!r}: expected a list of texts")
    return names


def _plugin(path: Path) -> Executable:
    try:
        return trusted_code.plugin(path, read_bytes(path, LARGEST_TEXT))
    except OSError as error:
        raise ConfigError(f"plugin {path}: no such Python file ({error})") from error


def _safety(table: Mapping[str, Any]) -> SafetyConfig:
    safety = table.get("safety", {})
    return parse(SafetyConfig, safety if isinstance(safety, Mapping) else {}, "safety")
