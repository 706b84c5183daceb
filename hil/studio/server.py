"""The studio's page and requests, for one user on this machine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hil.studio.worker import Worker
from hil.web.site import site


def application(worker: Worker, token: str, hosts: list[str]) -> Any:
    """ASGI application of the studio; see `hil.web.site.site`.

    Parameters
    ----------
    worker : Worker
        Computes.
    token, hosts : str, list of str
        As `hil.web.site.site`.
    """

    def ask(given: Mapping[str, Any]) -> dict[str, int]:
        words = dict(given)
        return {"number": worker.ask(str(words.pop("verb", "")), words)}

    def cancel(_: Mapping[str, Any]) -> Any:
        worker.cancel()
        return worker.status()

    questions = {"status": lambda _: worker.status(), "state": lambda _: worker.state}
    requests = {"ask": ask, "cancel": cancel}
    return site("hil.studio", ("studio.js",), questions, requests, token, hosts)
