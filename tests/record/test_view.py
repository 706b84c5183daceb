"""Layouts of viewers, against an independent reader of the session; the live stream of a file."""

import json
import os
import re
import resource
import socket
import struct
import subprocess
import sys
import threading
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from types import SimpleNamespace

import pytest
import zstandard
from mcap import records
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import hil
from hil.cli import main
from hil.commands.view import FoxgloveSink, Streamer, follow
from hil.errors import DataError
from hil.record.container import MAGIC
from hil.record.layouts import VIEWERS, pages
from hil.record.mcap_write import SessionWriter
from hil.record.schema import Channel
from hil.ui.desk import SessionProgram

ROOT = Path(__file__).parents[2]
SMALL = Path(__file__).with_name("small.mcap")


@pytest.fixture(scope="module")
def messages():
    """First message of every topic, and its schema, as an independent reader decodes them."""
    found, ros = {}, DecoderFactory()
    with SMALL.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            if channel.topic not in found:
                decode = ros.decoder_for(channel.message_encoding, schema) or json.loads
                found[channel.topic] = schema.name, decode(message.data)
    return found


def text_of(viewer):
    return VIEWERS[viewer].write(pages(SMALL))


def number(message, steps):
    """What stands at a place of a message."""
    for step in steps:
        name, _, index = step.partition("[")
        message = getattr(message, name)
        message = message[int(index.rstrip("]"))] if index else message
    return message


def test_every_path_of_foxglove_is_a_number_of_the_session(messages):
    layout = json.loads(text_of("foxglove"))
    plots = [c for n, c in layout["configById"].items() if n.startswith("Plot!")]
    paths = [p["value"] for c in plots for p in c["paths"]]
    assert len(paths) > 40
    for path in paths:
        topic, *steps = path.split(".")
        assert isinstance(number(messages[topic][1], steps), float), path
    assert layout["configById"]["RawMessages!events"]["topicPath"] in messages


def test_all_panels_of_foxglove_have_a_place(messages):
    layout = json.loads(text_of("foxglove"))
    tabs = layout["configById"][layout["layout"]]["tabs"]
    used = re.findall(r'"((?:Plot|RawMessages)![^"]+)"', json.dumps(tabs))
    assert sorted([*used, layout["layout"]]) == sorted(layout["configById"])


def test_every_panel_of_foxglove_and_lichtblick_has_a_title_with_its_unit(messages):
    """Each program has its own key for it; a panel without one is called "Plot"."""
    layout = json.loads(text_of("foxglove"))
    panels = {n: c for n, c in layout["configById"].items() if not n.startswith("Tab!")}
    for key in ("foxglovePanelTitle", "lichtblickPanelTitle"):
        titles = [c[key] for c in panels.values()]
        assert "/leader/measured_js position [rad]" in titles and "Events" in titles
        assert len(titles) == len(set(titles)) == len(panels)


def test_no_release_of_plotjuggler_3_asks_about_the_layout():
    assert ET.fromstring(text_of("plotjuggler")).get("version") == "2.3.8"


def series(topic, schema, message):
    """Names that PlotJuggler gives to the numbers of a message: of joints by their names."""
    if schema.endswith("/JointState"):
        for part in ("position", "velocity", "effort"):
            for joint, _ in zip(message.name, getattr(message, part), strict=False):
                yield f"{topic}/{joint}/{part}"
        return
    for name in message.__slots__:
        value = getattr(message, name)
        if isinstance(value, float):
            yield f"{topic}/{name}"
        elif hasattr(value, "__slots__"):
            yield from series(f"{topic}/{name}", "", value)


def test_every_curve_of_plotjuggler_is_a_series_of_the_session(messages):
    known = {
        name
        for topic, (schema, message) in messages.items()
        if not isinstance(message, dict)
        for name in series(topic, schema, message)
    }
    tree = ET.fromstring(text_of("plotjuggler"))
    named = [curve.get("name") for curve in tree.iter("curve")]
    assert len(named) > 40
    assert set(named) <= known, set(named) - known


def test_every_entity_of_rerun_is_one_that_rerun_makes_of_the_session(messages):
    table = re.search(r'json.loads\("""\n(.*)\n"""\)', text_of("rerun"), re.S)
    for _, panels in json.loads(table[1]):
        for _, entity, component, curves in panels:
            if component:
                schema, message = messages[entity]
                assert component == f"{schema.replace('/', '.')}:message"
                for _, selector in curves:
                    assert isinstance(number(message, selector.split(".")[1:]), float)
            else:  # a joint state's parts have entities of their own
                topic, _, part = entity.rpartition("/")
                assert [label for label, _ in curves] == messages[topic][1].name
                assert len(number(messages[topic][1], [part])) == len(curves)


@pytest.mark.parametrize("viewer", VIEWERS)
def test_the_committed_layouts_are_those_of_the_rig_that_comes_with_the_package(viewer):
    committed = ROOT / "docs" / "layouts" / f"teleop.{viewer}{VIEWERS[viewer].ending}"
    assert committed.read_text(encoding="utf-8") == text_of(viewer)


def test_a_session_of_one_slider_has_its_units_and_no_velocities(tmp_path):
    path = tmp_path / "one.mcap"
    own = Channel("/one/measured_js", "joint_state", ("slide",), ("position",))
    with SessionWriter(path, [own], {"robot/one": {"unit": "m"}}) as writer:
        writer.write("/one/measured_js", 1, 1_000_000, [0.1])
    (page,) = pages(path)
    assert page.panels[0].heading == "/one/measured_js position [m]"


def test_a_session_without_numbers_is_refused(tmp_path):
    path = tmp_path / "none.mcap"
    with SessionWriter(path, [], {}) as writer:
        writer.event(1, 1, "noise", {})
    with pytest.raises(DataError, match="holds no channel that a layout shows"):
        pages(path)


def test_the_command_writes_beside_the_session_and_over_no_other_file(tmp_path, capsys):
    session = tmp_path / "s.mcap"
    session.write_bytes(SMALL.read_bytes())
    assert main(["view", str(session), "--for", "foxglove"]) == 0
    assert "import" in capsys.readouterr().out
    assert json.loads((tmp_path / "s.foxglove.json").read_text())["configById"]
    assert main(["view", str(session), "--for", "foxglove"]) == 0  # its own is replaced
    other = tmp_path / "other.json"
    other.write_text("{}")
    assert main(["view", str(session), "--for", "foxglove", "-o", str(other)]) == 2
    assert other.read_text() == "{}"
    assert main(["view", str(session)]) == 2
    assert "--for" in capsys.readouterr().err


class Kept:
    """Keeps what a stream gives."""

    def __init__(self):
        self.topics, self.messages = {}, []

    def channel(self, number, channel, schema):
        self.topics[number] = channel.topic, schema.name

    def message(self, number, t_ns, data):
        self.messages.append((self.topics[number][0], t_ns, data))


def recorded(path):
    """All messages of a session, by the official reader."""
    with Path(path).open("rb") as file:
        rows = make_reader(file).iter_messages(log_time_order=False)
        return [(channel.topic, m.log_time, m.data) for _, channel, m in rows]


def test_a_session_that_is_over_is_streamed_to_the_byte():
    kept = Kept()
    follow(SMALL, kept)
    assert kept.messages == recorded(SMALL)


def chunks(data):
    """Place and size of the content of every chunk of a session."""
    at = len(MAGIC)
    while at + 9 <= len(data) - len(MAGIC):
        size = int.from_bytes(data[at + 1 : at + 9], "little")
        if data[at] == Opcode.CHUNK:
            yield at + 9, size
        at += 9 + size


def chunk(content, checksum=0):
    """A session of one chunk, whose content is packed."""
    packed = zstandard.ZstdCompressor().compress(content)
    head = struct.pack("<QQQII", 0, 0, len(content), checksum, 4) + b"zstd"
    body = head + struct.pack("<Q", len(packed)) + packed
    return MAGIC + struct.pack("<BQ", Opcode.CHUNK, len(body)) + body


def record(opcode, body):
    return struct.pack("<BQ", opcode, len(body)) + body


NO_CHANNEL = record(Opcode.MESSAGE, struct.pack("<HIQQ", 7, 0, 0, 0))


@pytest.mark.parametrize(
    "data",
    [
        chunk(NO_CHANNEL),
        chunk(NO_CHANNEL, checksum=1),
        chunk(record(Opcode.MESSAGE, b"short")),
        chunk(record(Opcode.CHANNEL, b"\1\0\0\0\x02\0\0\0\xff\xfe")),
        chunk(record(Opcode.SCHEMA, b"\1\0\xff\xff\xff\xff")),
        chunk(bytes(10_000)),
        MAGIC + record(Opcode.CHUNK, b"short"),
        MAGIC + record(Opcode.CHUNK, bytes(28) + b"\xff\xff\xff\xff" + bytes(9)),
        chunk(bytes(2**27)),
    ],
    ids=["none", "sum", "short", "channel", "schema", "zeros", "head", "kind", "bomb"],
)
def test_a_damaged_record_ends_the_stream_in_one_sentence(tmp_path, data):
    (tmp_path / "s.mcap").write_bytes(data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(DataError, match=r"s\.mcap is damaged: .*--recover"):
        follow(tmp_path / "s.mcap", Kept())
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 2**17  # [KiB]


def test_a_flipped_bit_ends_the_stream_where_it_is(tmp_path):
    whole = SMALL.read_bytes()
    at, size = list(chunks(whole))[-1]
    for place in (at + 30, at + 34, at + size // 2, at + size - 1):
        data = bytearray(whole)
        data[place] ^= 0x10
        (tmp_path / "s.mcap").write_bytes(data)
        kept = Kept()
        with pytest.raises(DataError, match=r"what can be read|are not streamed"):
            follow(tmp_path / "s.mcap", kept)
        assert kept.messages == recorded(SMALL)[: len(kept.messages)]


def test_a_damaged_time_is_not_waited_for(tmp_path):
    lines = [struct.pack("<HIQQ", 1, 0, t, 0) for t in (0, 2**63, 1)]
    channel = struct.pack("<HH", 1, 0) + (struct.pack("<I", 1) + b"x") * 2 + struct.pack("<I", 0)
    inner = record(Opcode.CHANNEL, channel) + b"".join(record(Opcode.MESSAGE, m) for m in lines)
    (tmp_path / "s.mcap").write_bytes(chunk(inner))
    given = []
    sink = SimpleNamespace(channel=lambda *a: None, message=lambda n, t, d: given.append(t))
    follow(tmp_path / "s.mcap", sink)
    assert given == [0, 2**63, 1]


def test_children_import_nothing_of_the_working_directory(tmp_path, monkeypatch):
    """`python -m` and a spawned process look there first."""
    started = []

    class Process:
        stdout = ()

        def __init__(self, words, **_):
            started.append(words)

    monkeypatch.setattr("subprocess.Popen", Process)
    Streamer(free_port()).begin(tmp_path / "s.mcap")
    SessionProgram([]).join()
    monkeypatch.undo()
    monkeypatch.chdir(tmp_path)
    assert len(started) == 2
    (tmp_path / "hil.py").write_text("open('ran', 'w')")
    path = str(Path(hil.__file__).parents[1])
    for words in started:
        own = [*words[: words.index("hil") + 1], "--version"]
        done = subprocess.run(own, env=os.environ | {"PYTHONPATH": path}, capture_output=True)
        assert done.returncode == 0 and not (tmp_path / "ran").exists()


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


def test_a_session_is_streamed_while_it_is_written_and_goes_on_in_its_next_part(tmp_path):
    first, second = tmp_path / "s.mcap", tmp_path / "s.part2.mcap"
    own = Channel("/one/measured_js", "joint_state", ("j",), ("position",))
    kept = Kept()

    def write(path, ticks):
        with SessionWriter(path, [own], {}) as writer:
            for tick in ticks:
                writer.write("/one/measured_js", tick, tick * 1_000_000, [float(tick)])
                if tick % 50 == 0:
                    writer.flush()
                    seen.wait(0.05)
                if tick == 1:
                    begun.set()

    begun, seen = threading.Event(), threading.Event()
    writing = threading.Thread(
        target=lambda: (write(first, range(1, 101)), write(second, range(101, 151))), daemon=True
    )
    writing.start()
    begun.wait(5.0)
    follow(first, kept, expected=True)
    writing.join()
    assert kept.messages == recorded(first) + recorded(second)


def test_a_viewer_gets_the_messages_of_the_session(tmp_path):
    client = pytest.importorskip("websockets.sync.client")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    sink = FoxgloveSink("test", port)
    known = set(recorded(SMALL))
    topics = {topic for topic, *_ in known}
    names, got, ready, whole = {}, set(), threading.Event(), threading.Event()
    asked, heard = [0.0], set()

    def view():
        address = f"ws://127.0.0.1:{port}"
        with client.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as link:
            ready.set()
            for said in link:
                fresh = []
                if isinstance(said, bytes):
                    number, t_ns = struct.unpack_from("<IQ", said, 1)
                    got.add((names[number], t_ns, said[13:]))
                    heard.add(number)
                    if len(got) >= len(known):
                        whole.set()
                else:
                    told = {c["id"]: c["topic"] for c in json.loads(said).get("channels", ())}
                    names.update(told)
                    fresh = list(told)
                # again where nothing has come: the server may tell of a channel before it knows it
                # itself; not at each word of it, for what is there already is answered by one, too
                if not fresh and time.monotonic() > asked[0] + 0.2:
                    asked[0], fresh = time.monotonic(), [n for n in names if n not in heard]
                for n in fresh:
                    wanted = [{"id": n, "channelId": n}]
                    link.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    viewer = threading.Thread(target=view, daemon=True)
    viewer.start()
    assert ready.wait(5.0)
    for _ in range(20):  # a viewer subscribes in its own time: what came before is not sent to it
        follow(SMALL, sink)
        if whole.wait(1.0):
            break
    sink.close()
    viewer.join(5.0)
    assert got == known
    assert set(names.values()) == topics


def test_a_slow_viewer_gets_what_waits_at_the_end_of_a_session():
    client = pytest.importorskip("websockets.sync.client")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    sink, count, got, ready = FoxgloveSink("test", port), 3000, [], threading.Event()
    sink.channel(1, records.Channel(1, "/x", "json", {}, 0), None)
    ended = threading.Event()

    def view():
        address, link_of = f"ws://127.0.0.1:{port}", client.connect
        with link_of(address, subprotocols=["foxglove.sdk.v1"], max_queue=4) as link:
            for said in link:
                if isinstance(said, bytes):
                    ready.set()
                    got.append(int(said[13:]))
                    # it reads no further before the session is over
                    assert ended.wait(20.0)
                elif channels := json.loads(said).get("channels"):
                    n = channels[0]["id"]
                    wanted = [{"id": n, "channelId": n}]
                    link.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    viewer = threading.Thread(target=view, daemon=True)
    viewer.start()
    for _ in range(200):
        sink.message(1, 0, b"-1")
        if ready.wait(0.05):
            break
    assert ready.is_set()
    for k in range(count):  # 12 MB: more than the network holds
        sink.message(1, k, str(k).encode().rjust(4096))
    ended.set()
    sink.flush()
    sink.close()
    viewer.join(20.0)
    assert [k for k in got if k >= 0] == list(range(count))


@pytest.fixture
def stream():
    """A stream without a session, and its port."""
    sink = FoxgloveSink("test", port := free_port(), ["http://lab.example:8080"])
    yield sink, port
    sink.close()


@pytest.mark.parametrize(
    ("asked", "let_in"),
    [
        ({}, True),
        ({"origin": "file://"}, True),
        ({"origin": "https://app.foxglove.dev"}, True),
        ({"origin": "http://localhost:8080"}, True),
        ({"origin": "http://127.0.0.1"}, True),
        ({"origin": "http://lab.example:8080"}, True),
        ({"subprotocols": ["foxglove.websocket.v1"]}, True),
        ({"origin": "http://evil.example"}, False),
        ({"origin": "http://lab.example"}, False),
        ({"origin": "http://localhost.evil.example"}, False),
        ({"origin": "http://localhost@evil.example"}, False),
        ({"origin": "https://app.foxglove.dev.evil.example"}, False),
        ({"origin": "null"}, False),
        ({"origin": ""}, False),
        ({"additional_headers": {"Host": "evil.example"}}, False),
        ({"additional_headers": {"Host": "localhost.evil.example:8765"}}, False),
    ],
)
def test_pages_from_elsewhere_do_not_look(stream, asked, let_in, capsys):
    """Neither by their origin, nor by a name of their own for this machine."""
    client = pytest.importorskip("websockets.sync.client")
    refused = pytest.importorskip("websockets.exceptions").InvalidStatus
    address = f"ws://127.0.0.1:{stream[1]}"
    asked = {"subprotocols": ["foxglove.sdk.v1"]} | asked
    if let_in:
        with client.connect(address, **asked) as link:
            assert json.loads(link.recv(5.0))["op"] == "serverInfo"
        return
    for _ in range(2):
        with pytest.raises(refused) as found:
            client.connect(address, **asked)
        assert found.value.response.status_code == 403
    told = capsys.readouterr().out
    if asked.get("origin"):
        assert told.count("refused: a page of ") == 1 and asked["origin"] in told


@pytest.mark.parametrize("said", ["", "{", "[]", "5", '{"subscriptions": 3}', "[" * 10_000, b"x"])
def test_what_is_no_wish_is_not_heard(stream, said):
    client = pytest.importorskip("websockets.sync.client")
    sink, port = stream
    sink.channel(1, records.Channel(1, "/x", "json", {}, 0), None)
    address = f"ws://127.0.0.1:{port}"
    with client.connect(address, subprotocols=["foxglove.sdk.v1"]) as link:
        link.send(said)
        link.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 9, "channelId": 1}]}))
        assert sink.looked.wait(5.0)
        sink.message(1, 5, b"{}")
        got = [link.recv(5.0) for _ in range(3)]
        assert got[2] == struct.pack("<BIQ", 1, 9, 5) + b"{}"
        link.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [9]}))
        link.close()


def test_who_reads_nothing_does_not_keep_the_stream(stream):
    """Neither a viewer that hangs, nor a connection that never says what it is."""
    pytest.importorskip("websockets")
    sink, port = stream
    sink.channel(1, records.Channel(1, "/x", "json", {}, 0), None)
    wish = json.dumps({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": 1}]}).encode()
    head = (
        f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
    )
    place = ("127.0.0.1", port)
    with socket.create_connection(place) as viewer, socket.create_connection(place):
        viewer.sendall(head.encode())
        assert b"101" in viewer.recv(12)
        viewer.sendall(bytes([0x81, 0x80 | len(wish), 0, 0, 0, 0]) + wish)
        assert sink.looked.wait(5.0)
        for k in range(5000):  # 20 MB: more than the network holds
            sink.message(1, k, bytes(4096))
        since = time.monotonic()
        sink.close()
        assert time.monotonic() - since < 5.0


def streamed(*words):
    """Program that streams a session, and its address."""
    own = [sys.executable, "-c", "from hil.cli import main; raise SystemExit(main())"]
    port = free_port()
    program = subprocess.Popen(
        [*own, "view", str(SMALL), "--live", str(port), *words], stdout=subprocess.PIPE, text=True
    )
    return program, f"ws://127.0.0.1:{port}"


@pytest.mark.slow
def test_a_session_that_is_over_waits_for_its_viewer():
    client = pytest.importorskip("websockets.sync.client")
    program, address = streamed()
    while "It begins when a viewer" not in (line := program.stdout.readline()):
        assert line
    with pytest.raises(subprocess.TimeoutExpired):
        program.wait(1.0)
    wanted = {t for t, *_ in recorded(SMALL)}
    got, names = [], {}
    with client.connect(address, subprotocols=["foxglove.sdk.v1"], max_size=None) as link:
        for said in link:
            if isinstance(said, bytes):
                got.append((names[struct.unpack_from("<I", said, 1)[0]], said[13:]))
            elif channels := json.loads(said).get("channels"):
                names |= {c["id"]: c["topic"] for c in channels}
                wishes = [{"id": c["id"], "channelId": c["id"]} for c in channels]
                link.send(json.dumps({"op": "subscribe", "subscriptions": wishes}))
    assert program.communicate(timeout=10)[0] == "" and program.returncode == 0
    assert set(names.values()) == wanted and got == [(t, d) for t, _, d in recorded(SMALL)]


def test_a_stream_that_nobody_looked_at_says_so(tmp_path, capsys, monkeypatch):
    pytest.importorskip("websockets")
    monkeypatch.setattr("hil.commands.view._step_aside", lambda: None)
    monkeypatch.setattr("hil.commands.view._OPENED", 0.1)
    assert main(["view", str(SMALL), "--live", str(free_port())]) == 2
    assert "no viewer came to session" in capsys.readouterr().err
    assert main(["view", str(SMALL), "--live", str(free_port()), "--expected"]) == 0
    assert "no viewer has looked" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--live", "0"], "from 1 to 65535"),
        (["--live", "-o", "x.json"], "--live writes no file"),
        (["--for", "foxglove", "--origin", "http://a.example"], "--origin goes with --live"),
        (["--live", "--origin", "a.example"], "expected a site such as"),
        (["--live", "--origin", "http://a.example/page"], "expected a site such as"),
    ],
)
def test_a_stream_that_cannot_be_is_refused(words, said, capsys, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    assert main(["view", str(SMALL), *words]) == 2
    assert said in capsys.readouterr().err


def test_without_the_package_the_refusal_says_what_to_install(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert main(["run", "teleop", "-o", str(tmp_path / "s.mcap"), "--live", "--plain"]) == 2
    assert "pip install 'hil-teleop[live]'" in capsys.readouterr().err
