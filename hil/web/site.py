"""A small site for one user: a page, its files, and JSON requests that need a secret.

The page is given to who knows the token of the printed address; every request must carry it in a
header, which no other site can send.  Nothing is loaded from outside.
"""

from __future__ import annotations

import contextlib
import errno
import filecmp
import hmac
import ipaddress
import json
import os
import re
import signal
import socket
import sys
import tempfile
import threading
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from hil.errors import ConfigError

#: Bytes of a request: a verb and a few names, or a text; and of a file that is dropped.
LARGEST_REQUEST, LARGEST_FILE = 65_536, 2**30
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css", "svg": "image/svg+xml"}
#: Files of all pages.
_SHARED = ("base.css", "plot.js", "icon.svg")
#: A name of a file as a page may give it: no folder, nothing hidden.
_FILE_NAME = re.compile(r"[^/\\\x00-\x1f.][^/\\\x00-\x1f]{0,199}")
#: Answers a request: what was asked, as an object (empty for a question without a body).
Answer = Callable[[Mapping[str, Any]], Any]


#: Address of this machine alone, and those that stand for all of its addresses.
LOOPBACK, _ALL = "127.0.0.1", ("0.0.0.0", "::")


class Hosts:
    """Names by which a page may be asked.

    A site elsewhere can have its own name stand for an address of this machine, and so have a
    browser ask the page as if it were its own.  Such a name is not in here; an address in numbers
    is nobody's name.

    Parameters
    ----------
    host : str
        Address on which the page listens; one that stands for all lets in every address in
        numbers, and the name of this machine.
    """

    def __init__(self, host: str = LOOPBACK) -> None:
        self._all = host in _ALL
        mine = (socket.gethostname(), socket.getfqdn()) if self._all else (host,)
        self._names = {LOOPBACK, "::1", "localhost", *(name.lower() for name in mine)}

    def __contains__(self, header: str) -> bool:
        """Whether the field ``Host`` of a request names this page."""
        try:
            name = urlsplit(f"//{header}").hostname or ""
        except ValueError:
            return False
        return name in self._names or (self._all and _is_numbers(name))


def _is_numbers(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def site(
    package: str,
    own: tuple[str, ...],
    questions: Mapping[str, Answer],
    requests: Mapping[str, Answer],
    token: str,
    hosts: Hosts,
    folder: Path | None = None,
) -> Any:
    """ASGI application of a page.

    Parameters
    ----------
    package : str
        Package whose folder ``static`` holds ``index.html`` and the page's files.
    own : tuple of str
        Names of those files.
    questions, requests : mapping of str to callable
        Answers of ``GET /api/NAME`` (its query as the object) and ``POST /api/NAME``.
    token : str
        Secret of the printed address.
    hosts : Hosts
        Names by which the server may be asked.
    folder : Path, optional
        Where ``POST /api/file?name=NAME`` puts a file; without, no file is taken.

    Raises
    ------
    ConfigError
        If Starlette is not installed.
    """
    try:
        from starlette.applications import Starlette
        from starlette.middleware import Middleware
        from starlette.requests import ClientDisconnect, Request
        from starlette.responses import JSONResponse, Response
        from starlette.routing import Route
    except ImportError as error:
        raise ConfigError(
            "the pages need Starlette and uvicorn; install them: pip install 'hil-teleop[ui]'"
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
            return answer(b"This page opens with the address that was printed.", "text/plain", 403)
        return answer(_file(package, "index.html"), "text/html")

    async def static(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in (*own, *_SHARED):
            return answer(b"no such file", "text/plain", 404)
        content = _file("hil.web" if name in _SHARED else package, name)
        return answer(content, _TYPES[name.rpartition(".")[2]])

    async def elsewhere(request: Request, error: Exception) -> Response:
        status = int(getattr(error, "status_code", 404))
        return answer(b"There is nothing here.", "text/plain", status)

    def handler(found: Answer) -> Callable[[Request], Awaitable[Any]]:
        async def wrapped(request: Request) -> Any:
            if not same(request.headers.get("x-hil-token", "")):
                return JSONResponse({"error": "another token; reload the printed address"}, 403)
            try:
                if request.method == "GET":
                    return JSONResponse(found(dict(request.query_params)))
                body = b""
                async for part in request.stream():
                    body += part
                    if len(body) > LARGEST_REQUEST:
                        return JSONResponse({"error": "the request is too large"}, 413)
                return JSONResponse(found(_asked(body)))
            except (ValueError, ConfigError) as error:
                return JSONResponse({"error": str(error)}, 400)
            except ClientDisconnect:
                return Response(status_code=400)  # nobody is there to read it

        return wrapped

    async def dropped(request: Request) -> Any:
        if not same(request.headers.get("x-hil-token", "")):
            return JSONResponse({"error": "another token; reload the printed address"}, 403)
        try:
            name = request.query_params.get("name", "")
            return JSONResponse({"path": await _store(request.stream(), folder or Path(), name)})
        except ConfigError as error:
            return JSONResponse({"error": str(error)}, 400)
        except ClientDisconnect:
            return Response(status_code=400)

    def named(app: Any) -> Any:
        async def wrapped(scope: Any, receive: Any, send: Any) -> None:
            ours = scope["type"] != "http" or Request(scope).headers.get("host", "") in hosts
            answering = (
                app if ours else answer(b"This page has another address.", "text/plain", 400)
            )
            await answering(scope, receive, send)

        return wrapped

    return Starlette(
        routes=[
            Route("/", page),
            Route("/static/{name}", static),
            *([Route("/api/file", dropped, methods=["POST"])] if folder else []),
            *(Route(f"/api/{name}", handler(f)) for name, f in questions.items()),
            *(Route(f"/api/{name}", handler(f), methods=["POST"]) for name, f in requests.items()),
        ],
        middleware=[Middleware(named)],
        exception_handlers={404: elsewhere, 405: elsewhere},
    )


def _asked(body: bytes) -> dict[str, Any]:
    """The object of a request.

    Raises
    ------
    ValueError, ConfigError
        If it is none, or holds what is no text.
    """
    try:
        given = json.loads(body)
    except RecursionError:
        raise ConfigError("the request is nested too deeply") from None
    if not isinstance(given, dict):
        raise ConfigError("a request is an object")
    try:
        json.dumps(given, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise ConfigError(
            "a text of the request holds half a character (a single surrogate); expected Unicode"
        ) from None
    return given


async def _store(parts: AsyncIterator[bytes], folder: Path, name: str) -> str:
    """Put a file that was dropped into a folder; the path.  A file that is there stays.

    Raises
    ------
    ConfigError
        If the name is none, another file has it, it is too large, or cannot be written.
    """
    if not _FILE_NAME.fullmatch(name):
        raise ConfigError(f"{name!r} is no name of a file")
    place = folder / name
    handle, temporary = tempfile.mkstemp(dir=folder, prefix=".dropped-")
    try:
        size = 0
        with os.fdopen(handle, "wb") as file:
            async for part in parts:
                size += len(part)
                if size > LARGEST_FILE:
                    raise ConfigError(
                        f"{name} is larger than {LARGEST_FILE // 2**20} MB; give its path instead"
                    )
                file.write(part)
        if not place.exists():
            Path(temporary).replace(place)
        elif not filecmp.cmp(temporary, place, shallow=False):
            raise ConfigError(
                f"another file {name} is in {folder}; rename the one that you dropped"
            )
    except OSError as error:
        raise ConfigError(f"cannot write {place}: {error.strerror}") from error
    finally:
        Path(temporary).unlink(missing_ok=True)
    return name


def serve_until_interrupt(
    app: Any, host: str, port: int, told: Callable[[str, str], None], token: str
) -> None:
    """Serve an application until Ctrl-C.

    Parameters
    ----------
    app : ASGI application
        From `site`.
    host : str
        Address on which it listens; `LOOPBACK` is this machine alone.
    port : int
        0 takes a free one.
    told : callable
        Takes the address with the token, and that for other machines; empty: for none.
    token : str
        Secret.

    Raises
    ------
    ConfigError
        If the address or the port cannot be taken.
    """
    import uvicorn

    if not 0 <= port <= 65_535:
        raise ConfigError(f"--port {port}: a number from 0 to 65535 is needed")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.getaddrinfo(host, port, family)
        listening = socket.create_server((host, port), family=family)
    except (socket.gaierror, UnicodeError) as error:
        raise ConfigError(f"--host {host}: no such address; give one of this machine") from error
    except OSError as error:
        if error.errno == errno.EADDRNOTAVAIL:
            raise ConfigError(
                f"--host {host}: no address of this machine; 0.0.0.0 stands for all of them"
            ) from error
        raise ConfigError(
            f"--port {port}: {error.strerror}; choose another one, or none"
        ) from error
    taken = listening.getsockname()[1]
    here, there = (LOOPBACK, _seen_from_outside(family)) if host in _ALL else (host, host)
    at = [f"http://{f'[{h}]' if ':' in h else h}:{taken}/?token={token}" for h in (here, there)]
    told(at[0], "" if _is_loopback(there) else at[1])
    config = uvicorn.Config(app, log_level="warning", lifespan="off")
    with _terminated():
        uvicorn.Server(config).run(sockets=[listening])


def _is_loopback(host: str) -> bool:
    return host == "localhost" or (_is_numbers(host) and ipaddress.ip_address(host).is_loopback)


def _seen_from_outside(family: socket.AddressFamily) -> str:
    """Address of this machine on the network to which it sends; its name where it has none."""
    # an address for documentation (RFC 5737, RFC 3849): a route is asked for, nothing is sent
    elsewhere = "2001:db8::1" if family == socket.AF_INET6 else "192.0.2.1"
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((elsewhere, 9))
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])


@contextlib.contextmanager
def _terminated() -> Iterator[None]:
    """SIGTERM unwinds as an exit: what the pages began (a session, a worker) is ended properly.

    The server gives the signal again when it has closed, and by itself that ends the process.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _file(package: str, name: str) -> bytes:
    return (files(package) / "static" / name).read_bytes()
