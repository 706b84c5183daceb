"""`hil view`: a session in Foxglove, Lichtblick, PlotJuggler or rerun, also while it is recorded.

The live stream follows the file of the session, in a process of its own: the loop does not know
of it, and what a viewer sees is what is on record, to the byte.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import json
import logging
import os
import socket
import struct
import subprocess
import threading
import time
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any, Protocol

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from hil import outputs, terminal
from hil.errors import ConfigError, DataError
from hil.record.container import MAGIC, RATIO
from hil.record.layouts import VIEWERS, pages
from hil.record.recovery import in_use
from hil.revision import PROGRAM
from hil.userfile import LARGEST, open_regular, read_text
from hil.web.site import LOOPBACK, Hosts

EXAMPLE = (
    "hil view s.mcap --for foxglove\n  hil view s.mcap --for rerun -o s.py\n"
    "  hil view s.mcap --live"
)
#: Port that viewers propose.
_PORT = 8765
#: Where the pages of viewers are from: those of an installed program, and Foxglove's own.  A
#: program that is no page says nothing.
VIEWERS_AT = ("file://", "https://app.foxglove.dev")
#: Names of the protocol, by which viewers ask for it; bytes that a viewer may say at once, and
#: channels for which it may ask.
_PROTOCOLS, _ASKED, _WISHES = ("foxglove.sdk.v1", "foxglove.websocket.v1"), 2**20, 4096
#: Head of a message to a viewer: kind, number of the viewer's wish, time [ns].
_DATA = struct.Struct("<BIQ")
#: How often a file that is written is looked at; how long nothing may wait for a viewer before it
#: has the rest, and how long it may take to get that [s].
_LOOKED, _LINGER, _PATIENT = 0.02, 0.5, 8.0
#: How long a session that was promised may take to begin, a next part may take, and a file that
#: nobody writes may still grow [s].
_PATIENCE, _NEXT, _QUIET = 60.0, 0.3, 1.0
#: How long a session that is over waits for its first viewer, and who connects may take to say
#: that it is one [s].
_OPENED, _OPENS = 600.0, 2.0
#: Messages that wait for a slow viewer before the oldest are dropped: about a second of a rig.
_BACKLOG = 16_384
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQII")
#: All chunks together may unpack to so many bytes, and to a ratio of the file.
_ROOM = 2**26
#: What reading a damaged record raises.
_UNREADABLE = (struct.error, zstandard.ZstdError, McapError, ValueError, OverflowError, MemoryError)
#: No session is silent for so long within; a time beyond is a damaged one, and not waited for [s].
_SILENT = 60.0


def configure(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("session", metavar="S.mcap", help="session; one that is recorded now, too")
    parser.add_argument(
        "--for",
        dest="viewer",
        choices=tuple(VIEWERS),
        help="write the layout with which this viewer shows the session",
    )
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="the layout; default: beside the session"
    )
    add_live(parser, "stream the session to viewers by the Foxglove WebSocket protocol")
    parser.add_argument(
        "--origin",
        action="append",
        default=[],
        metavar="URL",
        help="with --live: pages of this site may look, too (https://viewer.example)",
    )
    parser.add_argument("--expected", action="store_true", help=argparse.SUPPRESS)


def add_live(parser: argparse.ArgumentParser, what: str) -> None:
    """Declare --live."""
    parser.add_argument(
        "--live",
        nargs="?",
        type=int,
        const=_PORT,
        metavar="PORT",
        help=f"{what}, to this machine alone, on ws://127.0.0.1:PORT (default {_PORT})",
    )


def run(args: argparse.Namespace) -> int:
    """Write the layout, or stream until the session is over."""
    if (args.viewer is None) == (args.live is None):
        raise ConfigError(
            f"name a viewer (--for {', '.join(VIEWERS)}), or stream the session (--live)"
        )
    path = Path(args.session)
    if args.live is not None:
        if args.output:
            raise ConfigError("--output goes with --for; --live writes no file")
        return _stream(path, args.live, args.expected, args.origin)
    if args.origin:
        raise ConfigError("--origin goes with --live: nobody connects to a layout")
    viewer = VIEWERS[args.viewer]
    target = (
        Path(args.output) if args.output else path.with_suffix(f".{args.viewer}{viewer.ending}")
    )
    outputs.check(
        target,
        viewer.ending,
        [path],
        lambda place: viewer.sign in read_text(place),
        f"a layout of {viewer.title}",
    )
    text = viewer.write(pages(path))
    with outputs.writing(target):
        target.write_text(text, encoding="utf-8")
    terminal.out(f"written: {target}, for {viewer.title}")
    terminal.out(f"next: {viewer.opens.format(session=path, file=target)}")
    return 0


# ------------------------------------------------------------ a file that grows


class Tail:
    """Records of a session file as they are written.

    Parameters
    ----------
    path : Path
        The file; it is there.

    Attributes
    ----------
    name : str
        Of the file.
    ended : bool
        Whether the writer has closed it.
    """

    def __init__(self, path: Path) -> None:
        self._file, self.name = path.open("rb", buffering=0), str(path)
        self._rest, self._begun = b"", False
        self._unpack = zstandard.ZstdDecompressor()
        self._size, self._claimed = 0, 0
        self.ended = False

    def new(self) -> Iterator[tuple[int, bytes]]:
        """Opcode and content of every record that came since, those in chunks one by one.

        Raises
        ------
        DataError
            If a chunk is damaged, or claims more than a file of this size may hold.
        """
        fresh = self._file.read()
        self._size += len(fresh)
        data = self._rest + fresh
        at = 0
        if not self._begun and len(data) >= len(MAGIC):
            self._begun, at = True, len(MAGIC)
        for opcode, start, end in _records(data, at) if self._begun else ():
            at = end
            if opcode == Opcode.CHUNK:
                inner = self._opened(data[start:end])
                yield from ((code, inner[a:b]) for code, a, b in _records(inner, 0))
            elif opcode == Opcode.FOOTER:
                self.ended = True
            else:
                yield opcode, data[start:end]
        self._rest = data[at:]

    def _opened(self, chunk: bytes) -> bytes:
        """Records of a chunk, whose checksum is right."""
        try:
            _, _, size, checksum, n = _CHUNK.unpack_from(chunk)
            kind = chunk[_CHUNK.size : _CHUNK.size + n]
            inner = chunk[_CHUNK.size + n + 8 :]
            if kind and not kind.isalnum():
                raise ValueError("its compression has no name")
            if kind == b"zstd":
                size = max(size, zstandard.frame_content_size(inner))
                self._claimed += size
                if self._claimed > _ROOM + RATIO * self._size:
                    raise ValueError("it claims more than a file of this size may hold")
                inner = self._unpack.decompress(inner, max_output_size=size)
            if checksum and zlib.crc32(inner) != checksum:
                raise ValueError("its checksum is wrong")
        except _UNREADABLE as error:
            raise damaged(self.name, f"a chunk cannot be read ({error})") from error
        if kind not in (b"", b"zstd"):
            raise DataError(f"{self.name}: chunks packed by {kind!r} are not streamed")
        return inner

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()


def damaged(path: str | Path, why: str) -> DataError:
    """Error about a session that is not streamed further."""
    return DataError(
        f"session {path} is damaged: {why}. What came before has been streamed; "
        f"'hil info {path} --recover NEW.mcap' writes what can be read"
    )


def _records(data: bytes, at: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, start and end of the content of every whole record from byte `at` on."""
    while at + 9 <= len(data):
        start = at + 9
        end = start + int.from_bytes(data[at + 1 : start], "little")
        if end > len(data):
            return
        yield data[at], start, end
        at = end


class Sink(Protocol):
    """Takes what comes from a session."""

    def channel(self, number: int, channel: Channel, schema: Schema | None) -> None:
        """Take a channel that messages will name by its number."""
        ...

    def message(self, number: int, t_ns: int, data: bytes) -> None:
        """Take a message of a channel."""
        ...


def follow(
    path: Path, sink: Sink, expected: bool = False, begin: Callable[[], None] = lambda: None
) -> None:
    """Give a sink all of a session until it is over.

    Of one that is being recorded it gets what comes from now on, part after part; another is
    played as fast as it was recorded.

    Parameters
    ----------
    path : Path
        The session.
    sink : Sink
        Takes it.
    expected : bool
        The recording begins now: nothing of it is left out.
    begin : callable, optional
        Called before the first message of a session that is over: returns when it is to play.

    Raises
    ------
    DataError
        If a record of it is damaged; what came before was given.
    """
    now = expected or in_use(path)
    tail, feed = Tail(path), _Feed(sink, now, begin)
    try:
        if now and not expected:
            feed.all_of(tail, silent=True)
        quiet, number = 0.0, 1
        while True:
            before = feed.count
            feed.all_of(tail)
            quiet = 0.0 if feed.count > before else quiet + _LOOKED
            if (tail.ended or quiet > _QUIET) and not in_use(path):
                number += 1
                part = _next_part(path, number) if now else None
                if part is None:
                    break
                tail.close()
                path, tail, quiet = part, Tail(part), 0.0
            time.sleep(_LOOKED)
    finally:
        tail.close()


def _next_part(path: Path, number: int) -> Path | None:
    """File in which a session goes on; None where it is over."""
    stem = path.stem.rpartition(".part")[0] or path.stem
    found = path.with_name(f"{stem}.part{number}{path.suffix}")
    until = time.monotonic() + _NEXT
    while time.monotonic() < until:
        if found.exists() and in_use(found):
            return found
        time.sleep(_LOOKED)
    return None


class _Feed:
    """Hands records to a sink: at once where they are recorded now, else at their pace."""

    def __init__(self, sink: Sink, now: bool, begin: Callable[[], None]) -> None:
        self._sink, self._now, self._begin = sink, now, begin
        self._schemas, self._known = dict[int, Schema](), set[int]()
        self._origin: float | None = None
        self.count = 0

    def all_of(self, tail: Tail, silent: bool = False) -> None:
        """Take what has come to a file; of messages nothing where it is to be silent."""
        for opcode, data in tail.new():
            if opcode == Opcode.MESSAGE and not self.count and not self._now:
                self._begin()
            try:
                self._take(opcode, data, silent)
            except _UNREADABLE as error:
                why = f"what follows message {self.count} cannot be read"
                raise damaged(tail.name, f"{why} ({type(error).__name__})") from error

    def _take(self, opcode: int, data: bytes, silent: bool) -> None:
        if opcode == Opcode.MESSAGE:
            self._message(data, silent)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(data)))
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(data)))
            self._sink.channel(channel.id, channel, self._schemas.get(channel.schema_id))
            self._known.add(channel.id)
        elif not opcode:
            raise ValueError("a record of no kind")

    def _message(self, data: bytes, silent: bool) -> None:
        number, _, t_ns, _ = _MESSAGE.unpack_from(data)
        if number not in self._known:
            raise ValueError("a message of no channel")
        self.count += 1
        if not silent:
            self._wait(t_ns * 1e-9)
            self._sink.message(number, t_ns, data[_MESSAGE.size :])

    def _wait(self, t: float) -> None:
        if self._now:
            return
        if self._origin is None:
            self._origin = time.monotonic() - t
        ahead = self._origin + t - time.monotonic()
        if ahead > _SILENT:
            self._origin, ahead = time.monotonic() - t, 0.0
        if ahead > _LOOKED:
            time.sleep(ahead)


# ------------------------------------------------------------ the Foxglove protocol


class FoxgloveSink:
    """Viewers that are connected by the Foxglove WebSocket protocol.

    Parameters
    ----------
    name : str
        What they show as the source.
    port : int
        Where they connect to, on this machine.
    origins : sequence of str
        Pages that may look beside `VIEWERS_AT`, and those of this machine.
    """

    def __init__(self, name: str, port: int, origins: Sequence[str] = ()) -> None:
        from websockets.sync.server import serve
        from websockets.typing import Subprotocol

        silent = logging.Logger("live")  # a page that is refused, or leaves, is no error
        silent.addHandler(logging.NullHandler())
        about = {"op": "serverInfo", "name": name, "capabilities": [], "supportedEncodings": []}
        self._about = json.dumps(about | {"metadata": {}, "sessionId": str(time.time_ns())})
        self._origins = (*VIEWERS_AT, *origins)
        self._lock, self._refused = threading.Lock(), False
        self._viewers: list[_Viewer] = []
        self._ids: dict[str, int] = {}
        self._topics: dict[int, int] = {}
        self._told: list[str] = []
        #: Whether a viewer has asked for something.
        self.looked = threading.Event()
        self._server = serve(
            self._visited,
            LOOPBACK,
            port,
            process_request=self._guard,
            subprotocols=[Subprotocol(p) for p in _PROTOCOLS],
            compression=None,
            max_size=_ASKED,
            open_timeout=_OPENS,
            close_timeout=_PATIENT,
            logger=silent,
        )
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def _guard(self, link: Any, request: Any) -> Any:
        """Answer of refusal to a page from elsewhere; None lets it in."""
        named, origins = (request.headers.get_all(k) for k in ("Host", "Origin"))
        if [h in Hosts() for h in named] != [True]:
            return link.respond(403, "This stream has another address.\n")
        if all(_is_here(o) or o in self._origins for o in origins):
            return None
        if not self._refused:
            self._refused = True
            terminal.out(f"refused: a page of {', '.join(origins)}; --origin lets it look")
        return link.respond(403, "Pages from elsewhere may not look at this stream.\n")

    def _visited(self, link: Any) -> None:
        """Serve a viewer until it leaves."""
        with self._lock:
            viewer = _Viewer(link, [self._about, *self._told])
            self._viewers.append(viewer)
        viewer.start()
        try:
            for said in link:
                if viewer.asked(said):
                    self.looked.set()
        except _closed():
            return  # it broke off
        finally:
            viewer.end()
            with self._lock:
                self._viewers.remove(viewer)

    def channel(self, number: int, channel: Channel, schema: Schema | None) -> None:
        """See `Sink`; a topic stays one channel when a session goes on in another file."""
        if channel.topic not in self._ids:
            own = len(self._ids) + 1
            told = {"id": own, "topic": channel.topic, "encoding": channel.message_encoding}
            told |= {"schemaName": "", "schema": ""}
            if schema is not None:
                told |= {"schemaName": schema.name, "schema": schema.data.decode()}
                told |= {"schemaEncoding": schema.encoding} if schema.encoding else {}
            text = json.dumps({"op": "advertise", "channels": [told]})
            with self._lock:
                self._ids[channel.topic] = own
                self._told.append(text)
                for viewer in self._viewers:
                    viewer.tell(text)
        self._topics[number] = self._ids[channel.topic]

    def message(self, number: int, t_ns: int, data: bytes) -> None:
        """See `Sink`."""
        with self._lock:
            for viewer in self._viewers:
                viewer.give(self._topics[number], t_ns, data)

    def flush(self) -> None:
        """Let the viewers have what waits, for at most `_PATIENT` seconds; then they are left."""
        with self._lock:
            viewers = list(self._viewers)
        until = time.monotonic() + _PATIENT
        for viewer in viewers:
            viewer.end()
        for viewer in viewers:
            viewer.join(max(until - time.monotonic(), 0.0))

    def close(self) -> None:
        """Disconnect the viewers."""
        with self._lock:
            viewers = list(self._viewers)
        for viewer in viewers:
            viewer.drop()
        self._server.shutdown()


def _closed() -> type[Exception]:
    """What a connection raises that is no more."""
    from websockets.exceptions import ConnectionClosed

    return ConnectionClosed


def _is_here(origin: str) -> bool:
    """Whether a page is of this machine."""
    scheme, _, host = origin.partition("://")
    return scheme in ("http", "https") and host in Hosts()


class _Viewer(threading.Thread):
    """A viewer that is connected: what it is told, in full, and what it has asked for.

    Parameters
    ----------
    link : websockets.sync.server.ServerConnection
        Its connection.
    told : sequence of str
        What it is to know first.
    """

    def __init__(self, link: Any, told: Sequence[str]) -> None:
        super().__init__(daemon=True)
        self._link, self._ended = link, False
        self._told, self._waiting = deque(told), deque[bytes](maxlen=_BACKLOG)
        self._asked: dict[int, int] = {}
        self._news = threading.Condition()

    def tell(self, text: str) -> None:
        """Have it know something."""
        with self._news:
            self._told.append(text)
            self._news.notify()

    def give(self, channel: int, t_ns: int, data: bytes) -> None:
        """Have it get a message, if it has asked for the channel; of too many the last ones."""
        with self._news:
            for number, wanted in self._asked.items():
                if wanted == channel:
                    self._waiting.append(_DATA.pack(1, number, t_ns) + data)
                    self._news.notify()

    def asked(self, said: str | bytes) -> bool:
        """Whether it asks for channels; what it says otherwise is not heard."""
        try:
            given = json.loads(said)
            new = {int(s["id"]): int(s["channelId"]) for s in given.get("subscriptions", ())}
            old = [int(n) for n in given.get("subscriptionIds", ())]
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            return False
        with self._news:
            if len(self._asked) + len(new) <= _WISHES:
                self._asked |= {n: c for n, c in new.items() if 0 <= n < 2**32}
            for number in old:
                self._asked.pop(number, None)
        return bool(new)

    def end(self) -> None:
        """Have it leave when it has what waits."""
        with self._news:
            self._ended = True
            self._news.notify()

    def drop(self) -> None:
        """Have it leave, with a word where it listens."""
        with self._news:
            self._told.clear()
            self._waiting.clear()
        self.end()
        self.join(_LINGER)
        with contextlib.suppress(OSError):  # it has left
            self._link.socket.shutdown(socket.SHUT_RDWR)

    def run(self) -> None:
        """Send, until it has left."""
        try:
            while True:
                with self._news:
                    self._news.wait_for(lambda: self._told or self._waiting or self._ended)
                    if not self._told and not self._waiting:
                        break
                    next_one = (self._told or self._waiting).popleft()
                self._link.send(next_one)
            self._link.close()
        except _closed():
            return


def check_live(port: int) -> None:
    """Refuse a stream that cannot be.

    Raises
    ------
    ConfigError
        If the package is missing or the port is taken.
    """
    if importlib.util.find_spec("websockets") is None:
        raise ConfigError("--live needs websockets: pip install 'hil-teleop[live]'")
    if not 1 <= port <= 65_535:
        raise ConfigError(f"--live {port}: a number from 1 to 65535 is needed")
    try:
        socket.create_server((LOOPBACK, port)).close()
    except OSError as error:
        raise ConfigError(f"--live {port}: {error.strerror}; choose another port") from error


def _checked(origins: Sequence[str]) -> Sequence[str]:
    """Sites whose pages may look.

    Raises
    ------
    ConfigError
        If one is no site as browsers name it.
    """
    for origin in origins:
        scheme, _, host = origin.partition("://")
        if scheme not in ("http", "https") or not host or "/" in host:
            raise ConfigError(f"--origin {origin}: expected a site such as https://viewer.example")
    return [origin.lower() for origin in origins]


def _stream(path: Path, port: int, expected: bool, origins: Sequence[str]) -> int:
    """Stream a session until it is over or Ctrl-C."""
    check_live(port)
    origins = _checked(origins)
    until = time.monotonic() + (_PATIENCE if expected else 0.0)
    while not path.exists() and time.monotonic() < until:
        time.sleep(_LOOKED)
    try:
        opened = open_regular(path, LARGEST)
    except OSError as error:
        raise DataError(f"session {path}: {error.strerror}") from error
    with opened as file:
        if file.read(len(MAGIC)) not in (b"", MAGIC):
            raise DataError(f"{path} is no session: it does not begin as one")
    _step_aside()
    sink = FoxgloveSink(f"hil {path.name}", port, origins)

    def begin() -> None:
        if sink.looked.is_set():
            return
        terminal.out("It begins when a viewer shows something of it.")
        if not sink.looked.wait(_OPENED):
            raise DataError(f"no viewer came to session {path} within {_OPENED / 60:g} min")
        time.sleep(_LINGER)  # a viewer asks for one panel after the other

    terminal.out(f"streaming {path} on ws://127.0.0.1:{port}: open this connection in Foxglove or")
    terminal.out("Lichtblick; Ctrl-C ends it")
    try:
        try:
            follow(path, sink, expected, begin)
        except DataError:
            sink.flush()
            raise
        sink.flush()
    finally:
        sink.close()
    if not sink.looked.is_set():
        terminal.out("It is over; no viewer has looked at it.")
    return 0


def _step_aside() -> None:
    """Leave the processor of a loop, the last one, to it."""
    os.nice(5)
    if hasattr(os, "sched_getaffinity") and len(allowed := os.sched_getaffinity(0)) > 1:
        os.sched_setaffinity(0, allowed - {max(allowed)})


class Streamer:
    """The live stream of a session that this process is about to record.

    Parameters
    ----------
    port : int
        Where viewers connect to.

    Attributes
    ----------
    address : str
        The same as they ask for it.
    """

    def __init__(self, port: int) -> None:
        check_live(port)
        self._port, self.address = port, f"ws://127.0.0.1:{port}"
        self._process: subprocess.Popen[bytes] | None = None

    def begin(self, path: Path) -> None:
        """Start it beside; the file comes."""
        words = [*PROGRAM, "view", str(path), "--live", str(self._port)]
        self._process = subprocess.Popen(
            [*words, "--expected"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C ends the session, and with it the stream
        )

    def end(self) -> None:
        """Let it send the rest."""
        if self._process is None:
            return
        try:
            self._process.wait(_QUIET + _PATIENT + 4 * _LINGER)
        except subprocess.TimeoutExpired:
            self._process.terminate()
            self._process.wait()
