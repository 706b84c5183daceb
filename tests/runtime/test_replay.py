"""Replay: the recorded inputs give the recorded commands, or the first tick that differs."""

import json

import numpy as np
import pytest
from mcap.writer import Writer
from test_run_session import RIGS, record

from hil.cli import main
from hil.errors import DataError
from hil.record.container import read
from hil.rig.config import load_rig
from hil.rig.operator import Shop
from hil.runtime.replay import replay
from hil.runtime.runner import Operator, run_session


@pytest.mark.parametrize("rig", ["teleop.toml", "identify.toml", "mechanical-operator.toml"])
def test_lockstep_sessions_are_reproduced_to_the_last_bit(rig, tmp_path):
    done = replay(record(tmp_path / "s.mcap", rig, seconds=1.0))
    assert (done.compared, done.differ, done.first) == (1000, 0, None)


@pytest.mark.real_time
def test_a_session_in_real_time_is_reproduced_whatever_it_missed(tmp_path):
    path = record(tmp_path / "s.mcap", seconds=0.5, clock="real")
    assert replay(path).differ == 0


def test_commands_of_the_operator_are_replayed_too(tmp_path):
    said = []
    schedule = [
        (0.1, "pause"),
        (0.15, "resume"),
        (0.2, "set force_scale 0.4"),
        (0.25, "set stiffness 9 8 4"),
        (0.3, "home"),
        (0.6, "stop"),
    ]
    path = tmp_path / "s.mcap"
    done = run_session(
        load_rig(RIGS / "teleop.toml"),
        1.0,
        3,
        output=path,
        operator=Operator(schedule, said.append),
    )
    assert done.ticks < 620 and done.state == "DISABLED"
    assert said == [
        "tick 101: pause: done, PAUSED",
        "tick 151: resume: done, ENABLED",
        "tick 201: set force_scale 0.4: done, ENABLED",
        "tick 251: set stiffness 9 8 4: done, ENABLED",
        "tick 301: home: done, ENABLED",
        "tick 601: stop: done, DISABLED",
    ]
    found = replay(path)
    assert found.differ == 0 and found.compared == found.ticks


BAD = [
    ("dance", "unknown command 'dance'"),
    ("set colour 3", "unknown parameter 'colour'. Available: damping"),
    ("set force_scale", "a name and a number are needed; usage: set PARAMETER NUMBER"),
    ("set force_scale much", "is no number"),
    ("set force_scale 1e9", "force_scale = 1e+09 is out of range: 0..2"),
    ("set force_scale nan", "out of range"),
    ("set stiffness 3", "takes 3 numbers, got 1"),
    ("set space 1", "unknown parameter 'space'"),
    ("pause now", "one word too many"),
]
#: Right in itself, but not here.
RUNNING = ("start", "goes on with resume")


def test_bad_lines_of_the_operator_are_answered_and_change_nothing(tmp_path):
    said = []
    lines = [*BAD, RUNNING]
    operator = Operator((), said.append, lines=lambda take: [take(text) for text, _ in lines])
    run_session(
        load_rig(RIGS / "teleop.toml"), 0.1, 3, output=tmp_path / "s.mcap", operator=operator
    )
    assert "force_scale 0..2" in said[0] and len(said) == len(lines) + 1
    for (_, part), answer in zip(lines, said[1:], strict=True):
        assert part in answer
    assert replay(tmp_path / "s.mcap").differ == 0


@pytest.mark.parametrize(("text", "part"), [*BAD, ("9 pause", ""), ("nan pause", "")])
def test_a_bad_schedule_is_refused_before_anything_is_opened(text, part, tmp_path, capsys):
    at = text if text[0].isdigit() or part == "" else f"0.1 {text}"
    words = ["run", str(RIGS / "teleop.toml"), "--seconds", "1", "--at", at]
    assert main([*words, "-o", str(tmp_path / "s.mcap")]) == 2
    assert part in capsys.readouterr().err and not (tmp_path / "s.mcap").exists()


@pytest.mark.parametrize("text", ["home", "resume", "pause"])
def test_only_start_gives_power_to_a_rig_that_waits(text, tmp_path):
    said = []
    operator = Operator([(0.05, text)], said.append, wait=True)
    done = run_session(
        load_rig(RIGS / "teleop.toml"), 0.2, 3, output=tmp_path / "s.mcap", operator=operator
    )
    assert done.state == "DISABLED" and said == [f"tick 51: {text}: DISABLED, as before"]
    assert replay(tmp_path / "s.mcap").differ == 0


@pytest.mark.parametrize("rig", ["teleop.toml", "identify.toml"])
@pytest.mark.parametrize("edge", ["low", "high"])
def test_no_single_parameter_within_its_range_faults_a_session(rig, edge, tmp_path):
    config = load_rig(RIGS / rig)
    for name, allowed in Shop(None, config).settable().items():
        values = " ".join([repr(getattr(allowed, edge))] * allowed.entries)
        done = run_session(
            config,
            0.6,
            3,
            output=tmp_path / "s.mcap",
            operator=Operator([(0.1, f"set {name} {values}")]),
        )
        assert done.state in ("ENABLED", "PAUSED"), name


def test_a_session_may_wait_for_its_operator(tmp_path):
    path = tmp_path / "s.mcap"
    operator = Operator([(0.2, "start")], wait=True)
    run_session(load_rig(RIGS / "teleop.toml"), 0.5, 3, output=path, operator=operator)
    from hil.record.mcap_read import load

    codes = load(path, "follower").tau
    assert not codes[:190].any() and codes[220:].any()
    assert replay(path).differ == 0


def test_another_parameter_differs_and_says_where(tmp_path):
    path = record(tmp_path / "s.mcap", seconds=0.5)
    found = replay(path, {"force_scale": 0.1})
    assert found.first is not None and found.first.arm == "leader" and found.first.tick < 10
    assert max(found.rms["leader"]) > 0 == max(found.rms["follower"])


def test_rows_that_the_ring_dropped_are_jumped_over(tmp_path):
    config = load_rig(RIGS / "teleop.toml", {"loop": {"ring_rows": 8}})
    path = tmp_path / "s.mcap"
    run_session(config, 0.5, 3, output=path, operator=Operator())
    found = replay(path)
    assert found.ticks == 400 and found.differ == 0
    assert 0 < found.compared < 400 and "dropped" in found.notes[0]


def test_a_changed_record_is_found(tmp_path, monkeypatch):
    from hil.record import mcap_write

    plain = mcap_write.SessionWriter.write_rows

    def bent(self, topics, stamps, data):
        data = data.copy()
        for topic, columns in topics:
            if topic == "/follower/setpoint_jf":
                cell = stamps[:, 0] == 200, columns.start + 1
                data[cell] = np.nextafter(data[cell], 1.0)
        plain(self, topics, stamps, data)

    monkeypatch.setattr(mcap_write.SessionWriter, "write_rows", bent)
    found = replay(record(tmp_path / "s.mcap"))
    assert found.differ == 1
    assert (found.first.tick, found.first.arm, found.first.what) == (200, "follower", "effort2")


def test_the_command_tells_it_in_words_and_in_json(tmp_path, capsys):
    path = str(record(tmp_path / "s.mcap"))
    assert main(["replay", path]) == 0
    assert "reproduced exactly" in capsys.readouterr().out
    assert main(["replay", path, "--set", "force_scale=0.2", "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["sessions"]
    assert told["identical"] is False and told["first"]["tick"] > 0
    assert "out of range" not in " ".join(told["notes"])
    assert main(["replay", path, "--set", "force_scale=99", "--json"]) == 0
    (told,) = json.loads(capsys.readouterr().out)["sessions"]
    beyond = "force_scale = 99 is out of range: 0..2; a session that runs refuses it"
    assert beyond in told["notes"]
    assert main(["replay", path, "--set", "force_scale"]) == 2
    assert main(["replay", path, "--set", "forcescale=1"]) == 2


def test_a_table_cannot_be_replayed(tmp_path):
    from test_loop_safety import MIDDLE

    from hil.record.export import write_recordings
    from hil.record.recording import Recording

    t = np.arange(100) * 1e-3
    q = np.tile(MIDDLE, (100, 1))
    path = tmp_path / "t.mcap"
    write_recordings(path, [Recording("s", "arm", ("a", "b", "c"), t, q, 0 * q)])
    with pytest.raises(DataError, match="only sessions of 'hil run' replay"):
        replay(path)


def _bad_events(box):
    return {**box.metadata}, {"/events": [b"[1]"]}, "TypeError"


def _torn_events(box):
    return {**box.metadata}, {"/events": [b'{"name": "comm\xe9']}, "UnicodeDecodeError"


def _short_wrench(box):
    force = box.topics["/leader/measured_cf"]
    return {**box.metadata}, {force.name: [d[:40] for d in force.data]}, "ends before its numbers"


def _bad_scales(box):
    scales = {"scales": "[[1, 2, 0]]"}
    return {**box.metadata, "calibration/drives": scales}, {}, "three scales above zero"


def _no_scales(box):
    return {**box.metadata, "calibration/drives": {"scales": "["}}, {}, "JSONDecodeError"


@pytest.mark.parametrize(
    "change", [_bad_events, _torn_events, _short_wrench, _bad_scales, _no_scales]
)
def test_a_session_that_anybody_wrote_is_replayed_or_refused(tmp_path, change, capsys):
    run_session(load_rig("teleop"), 0.02, clock="lockstep", output=tmp_path / "s.mcap")
    box = read(tmp_path / "s.mcap")
    metadata, payloads, why = change(box)
    with (tmp_path / "t.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "hil")
        for name, record in metadata.items():
            writer.add_metadata(name, dict(record))
        for name, data in box.attachments.items():
            writer.add_attachment(0, 0, name, "", data)
        for t in box.topics.values():
            schema = writer.register_schema(t.schema, t.schema_encoding, t.schema_text)
            channel = writer.register_channel(t.name, t.encoding, schema)
            for k, data in enumerate(payloads.get(t.name, t.data)):
                writer.add_message(channel, t.times[k], data, t.times[k], t.sequence[k])
        writer.finish()
    assert main(["replay", str(tmp_path / "t.mcap")]) == 2
    assert why in capsys.readouterr().err


def test_a_value_of_the_command_line_rules_for_the_whole_replay(tmp_path):
    path = tmp_path / "s.mcap"
    schedule = [(0.2, "set force_scale 0.2"), (0.3, "set leader_damping 0.01")]
    run_session(load_rig("teleop"), 0.5, 3, output=path, operator=Operator(schedule))
    found = replay(path, {"force_scale": 0.6})
    assert any("'set force_scale 0.2' of tick 201 was left out" in n for n in found.notes)
    assert not any("leader_damping" in n for n in found.notes)
    # the 200 ticks before the command, and those after it too
    assert found.differ > 300


def test_commands_while_nothing_is_recorded_have_their_time_and_are_replayed(tmp_path):
    path = tmp_path / "s.mcap"
    schedule = [
        (0.5, "record off"),
        (0.7, "note here"),
        (0.8, "set force_scale 0.3"),
        (1.0, "record on"),
    ]
    run_session(load_rig("teleop"), 1.5, 3, output=path, operator=Operator(schedule))
    box = read(path)
    events = box.topics["/events"]
    told = [json.loads(raw) for raw in events.data]
    at = {e["tick"]: s for e, s in zip(told, box.seconds(events), strict=True)}
    for tick in (501, 701, 801, 1001):
        assert at[tick] == pytest.approx(tick * 1e-3, abs=1e-9)
    found = replay(path)
    assert found.differ == 0
    (why,) = [n for n in found.notes if "rows follow" in n]
    assert "the operator did not record (record off)" in why and "the ring" not in why


def test_home_leaves_no_pause_of_the_safety(tmp_path):
    over = {"arms": {"leader": {"force_yellow": 0.4, "force_red": 0.5}}}
    said, path = [], tmp_path / "s.mcap"
    operator = Operator([(3.0, "home")], said.append)
    done = run_session(load_rig("teleop", over), 3.2, 0, output=path, operator=operator)
    assert done.paused and "force" in done.reason
    assert any("home: PAUSED, as before: resume first" in text for text in said), said
    assert replay(path).differ == 0


def test_home_goes_on_after_a_pause_of_the_operator(tmp_path):
    said, path = [], tmp_path / "s.mcap"
    operator = Operator([(0.1, "pause"), (0.2, "home")], said.append)
    done = run_session(load_rig("teleop"), 0.4, 3, output=path, operator=operator)
    assert done.state == "ENABLED" and "tick 201: home: done, ENABLED" in said
    assert replay(path).differ == 0
