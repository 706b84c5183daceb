"""The studio's page and requests, for one user on this machine."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hil.studio.own import TEMPLATE
from hil.studio.worker import Worker
from hil.web.site import site

#: Files of the page.
OWN = ("studio.js", "studio.css", "page.js", "intake.js")


def application(worker: Worker, token: str, hosts: list[str], folder: Path | None = None) -> Any:
    """ASGI application of the studio; see `hil.web.site.site`.

    Parameters
    ----------
    worker : Worker
        Computes.
    token, hosts, folder : str, list of str, Path
        As `hil.web.site.site`.
    """

    def ask(given: Mapping[str, Any]) -> dict[str, int]:
        words = dict(given)
        return {"number": worker.ask(str(words.pop("verb", "")), words)}

    def cancel(_: Mapping[str, Any]) -> Any:
        worker.cancel()
        return worker.status()

    questions = {
        "status": lambda _: worker.status(),
        "state": lambda _: worker.state,
        "files": lambda _: worker.files,
        "template": lambda _: {"text": TEMPLATE, "path": "my_effects.py"},
    }
    requests = {"ask": ask, "cancel": cancel}
    return site("hil.studio", OWN, questions, requests, token, hosts, folder)
