"""The page that `hil bench --report` writes, and what every benchmark gives back."""

from __future__ import annotations

from pathlib import Path

from hil.errors import ConfigError

#: Text for the terminal, and data for JSON.
Found = tuple[str, dict[str, object]]


def check(path: str | None) -> None:
    """Refuse a page that is not Markdown by its name.

    Raises
    ------
    ConfigError
        Names the path.
    """
    if path and Path(path).suffix != ".md":
        raise ConfigError(f"--report {path}: a file that ends in .md is needed")


def write(path: str | None, text: str) -> None:
    """Write the page, if one is asked for."""
    if path:
        Path(path).write_text(text, encoding="utf-8")
