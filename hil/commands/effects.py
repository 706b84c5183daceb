"""`hil effects`: the catalogue."""

from __future__ import annotations

import argparse

from hil import terminal
from hil.errors import ConfigError, unknown
from hil.models import catalogue
from hil.models.effect import Effect
from hil.models.parts import Param

EXAMPLE = "hil effects stribeck"


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare options."""
    parser.add_argument("name", nargs="?", help="one effect in full")
    parser.add_argument(
        "--plugin",
        action="append",
        default=[],
        metavar="FILE.py",
        help="file with effects of your own; repeatable",
    )
    parser.add_argument("--json", action="store_true", help="results as JSON on stdout")


def run(args: argparse.Namespace) -> int:
    """Print the catalogue or one effect."""
    from pathlib import Path

    catalogue.load_installed()
    for plugin in args.plugin:
        catalogue.load_plugin(Path(plugin))
    chosen = [_named(args)] if args.name else list(catalogue.table().values())
    if args.json:
        terminal.emit({"schema": "hil.effects/1", "effects": [as_dict(e) for e in chosen]})
    elif args.name:
        terminal.out(describe(chosen[0]))
    else:
        rows = [
            [e.name, e.family, e.doc.equation]
            for e in sorted(chosen, key=lambda e: (e.family, e.name))
        ]
        width = max(len(r[0]) for r in rows)
        terminal.out("\n".join(f"  {r[0].ljust(width)}  {r[1].ljust(12)}  {r[2]}" for r in rows))
    return 0


def _named(args: argparse.Namespace) -> Effect:
    if args.name in catalogue.table():
        return catalogue.get(args.name)
    raise ConfigError(
        f"{unknown('effect', args.name, catalogue.table())} An effect of your own: "
        f"hil effects {args.name} --plugin FILE.py"
    )


def as_dict(e: Effect) -> dict[str, object]:
    """One effect as JSON."""
    params = [
        {"name": p.name, "unit": p.unit, "text": p.text, "shape": p in e.shape}
        for p in (*e.params, *e.shape)
    ]
    doc = e.doc
    return {
        "name": e.name,
        "family": e.family,
        "equation": doc.equation,
        "signature": doc.signature,
        "confused_with": list(doc.confused_with),
        "shown_by": doc.shown_by,
        "source": doc.source,
        "explains": list(e.scope.explains),
        "parameters": params,
        "caveat": doc.caveat,
    }


def describe(e: Effect) -> str:
    """One effect for a terminal."""
    lines = [
        f"{e.name} ({e.family}): {(e.__doc__ or '').strip().splitlines()[0]}",
        "",
        f"  {e.doc.equation}",
        "",
    ]
    wide = max((len(_unit(p.unit)) for p in (*e.params, *e.shape)), default=0) + 2
    for p in (*e.params, *e.shape):
        kind = "shape" if p in e.shape else "linear"
        lines.append(f"  {p.name:6s} {kind:7s} {f'[{_unit(p.unit)}]':{wide}s}  {p.text}")
    lines += [
        "",
        f"  shows itself by    {e.doc.signature}",
        f"  mistaken for       {', '.join(e.doc.confused_with) or 'nothing'}",
        f"  motion to show it  {e.doc.shown_by}",
        f"  source             {e.doc.source}",
        *([f"  read with care     {e.doc.caveat}"] if e.doc.caveat else []),
    ]
    return "\n".join(lines)


def _unit(unit: str) -> str:
    """A unit on a turning joint, and on a sliding one where it differs."""
    turning, sliding = (Param("", unit, "").unit_at((axis,), 0, 0) for axis in ("rad", "m"))
    return turning if turning == sliding else f"{turning}, or {sliding}"
