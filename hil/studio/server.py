"""The studio's pages and requests, for one user on this machine.

Loopback only.  The page is given to who knows the token of the printed address; every request must
carry it in a header, which no other site can send.  Nothing is loaded from outside.
"""

from __future__ import annotations

import hmac
import json
from collections.abc import Awaitable, Callable
from importlib.resources import files
from typing import Any

from hil.errors import ConfigError
from hil.studio.worker import Worker

#: A request is a verb and a few names.
LARGEST = 16_384
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
_STATIC = ("studio.js", "plot.js", "studio.css", "icon.svg")


def application(worker: Worker, token: str, hosts: list[str]) -> Any:
    """ASGI application of the studio.

    Parameters
    ----------
    worker : Worker
        Computes.
    token : str
        Secret of the printed address.
    hosts : list of str
        Names by which the server may be asked.

    Raises
    ------
    ConfigError
        If Starlette is not installed.
    """
    try:
        from starlette.applications import Starlette
        from starlette.middleware import Middleware
        from starlette.middleware.trustedhost import TrustedHostMiddleware
        from starlette.requests import Request
        from starlette.responses import JSONResponse, Response
        from starlette.routing import Route
    except ImportError as error:
        raise ConfigError(
            "the studio needs Starlette and uvicorn; install them: pip install 'hil-teleop[ui]'"
        ) from error

    def same(given: str) -> bool:
        return hmac.compare_digest(given.encode(), token.encode())

    def answer(content: bytes, kind: str, status: int = 200) -> Response:
        headers = {
            "Content-Security-Policy": POLICY,
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cache-Control": "no-store",
        }
        return Response(content, status, headers, f"{kind}; charset=utf-8")

    async def page(request: Request) -> Response:
        if not same(request.query_params.get("token", "")):
            text = "The studio opens with the address that 'hil studio' printed."
            return answer(text.encode(), "text/plain", 403)
        return answer(_file("index.html"), "text/html")

    async def static(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in _STATIC:
            return answer(b"no such file", "text/plain", 404)
        return answer(_file(name), _TYPES[name.rpartition(".")[2]])

    Handler = Callable[[Request], Awaitable[Any]]

    def guarded(handler: Handler) -> Handler:
        async def wrapped(request: Request) -> Any:
            if not same(request.headers.get("x-studio-token", "")):
                return JSONResponse({"error": "another token; reload the printed address"}, 403)
            return await handler(request)

        return wrapped

    async def status(request: Request) -> Any:
        return JSONResponse(worker.status())

    async def state(request: Request) -> Any:
        return JSONResponse(worker.state)

    async def ask(request: Request) -> Any:
        body = await request.body()
        if len(body) > LARGEST:
            return JSONResponse({"error": "the request is too large"}, 413)
        try:
            given = json.loads(body)
            if not isinstance(given, dict):
                raise ConfigError("a request is an object")
            verb = str(given.pop("verb", ""))
            return JSONResponse({"number": worker.ask(verb, given)})
        except (ValueError, ConfigError) as error:
            return JSONResponse({"error": str(error)}, 400)

    async def cancel(request: Request) -> Any:
        worker.cancel()
        return JSONResponse(worker.status())

    return Starlette(
        routes=[
            Route("/", page),
            Route("/static/{name}", static),
            Route("/api/status", guarded(status)),
            Route("/api/state", guarded(state)),
            Route("/api/ask", guarded(ask), methods=["POST"]),
            Route("/api/cancel", guarded(cancel), methods=["POST"]),
        ],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=hosts)],
    )


def _file(name: str) -> bytes:
    return (files("hil.studio") / "static" / name).read_bytes()
