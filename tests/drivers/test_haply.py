"""Haply Inverse3 over its WebSocket: conformance, the documented JSON, faults, a real socket."""

import json
import socket
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hil.drivers import haply
from hil.drivers.haply import BOX, InverseConfig
from hil.errors import ConfigError, DeviceError
from hil.record.container import read
from hil.record.schema import read_fields
from hil.rig.config import RecordConfig, load_rig
from hil.rigs import rig_path
from hil.runtime.runner import run_session
from hil.signals.bus import Bus
from hil.signals.device import Status
from hil.sim_devices.joints.haply import SimInverse, main, serve_clients, single_device
from hil.testing import Tolerance, check_driver

sys.path.insert(0, str(Path(__file__).parent))
from haply_far import PERIOD_NS, InverseFar

ALL = {"states", "position", "effort", "zero on exit", "unplug", "time-out", "bad frames"}
#: The inventory that the vendor's page "Simulation channel" shows, shortened by what is not read.
INVENTORY = b"""{"inverse3": [{"device_id": "04BA", "config": {"type": "inverse3",
 "gravity_compensation": {"enabled": true, "scaling_factor": 1}, "handedness": "right",
 "torque_scaling": {"enabled": true}}, "state": {
 "angular_position": {"a0": -69.31704, "a1": 137.62952, "a2": 19.832787},
 "angular_velocity": {"a0": 0, "a1": 0, "a2": 0},
 "cursor_position": {"x": 0.07842738, "y": -0.14836666, "z": 0.14297646},
 "cursor_velocity": {"x": -0.011969013, "y": 0.0012009288, "z": -0.043197}, "mode": "idle"},
 "status": {"calibrated": false, "in_use": false, "power_supply": true, "ready": true,
 "started": true}}], "verse_grip": [{"device_id": "61548", "state": {"hall": 0}}]}"""


def test_conformance():
    far = InverseFar()
    checked = check_driver(far.open, far, tolerance=Tolerance(position=2e-6, velocity=1e-4))
    assert set(checked.done) == ALL
    assert checked.skipped == []


@pytest.mark.parametrize(
    ("space", "version", "values", "expected"),
    [
        # the page "Control commands" of 3.5, and the tutorials of 3.1
        (
            "cursor",
            "3.5",
            (0, 0, 1.5),
            {"set_cursor_force": {"vector": {"x": 0, "y": 0, "z": 1.5}}},
        ),
        ("cursor", "3.1", (0, 0, 0), {"set_cursor_force": {"values": {"x": 0, "y": 0, "z": 0}}}),
        (
            "joints",
            "3.5",
            (0.25, 0, -1),
            {"set_angular_torques": {"torques": {"a0": 0.25, "a1": 0, "a2": -1}}},
        ),
    ],
)
def test_commands_are_those_of_the_vendors_pages(space, version, values, expected):
    made = json.loads(haply.command_message("049D", space, version) % values)
    assert made == {"inverse3": [{"device_id": "049D", "commands": expected}]}


def test_the_documented_inventory_is_read():
    (row,) = haply.devices(INVENTORY)
    cursor, joints = haply.COMMAND_SPACES["cursor"], haply.COMMAND_SPACES["joints"]
    assert haply.numbers_of(row, cursor.position, cursor.axes) == (
        0.07842738,
        -0.14836666,
        0.14297646,
    )
    assert haply.numbers_of(row, joints.position, joints.axes) == (-69.31704, 137.62952, 19.832787)
    assert haply.lacks(row) == "" and haply.scaled(row) == ""
    assert haply.service_settings(row["config"]) == (
        " (gravity compensation on, torque scaling on, right-handed)"
    )


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=4),
    lambda kids: (
        st.lists(kids, max_size=3)
        | st.dictionaries(
            st.sampled_from(["inverse3", "state", "status", "cursor_position", "x", "y", "z"]), kids
        )
    ),
    max_leaves=20,
)


@given(st.binary(max_size=60) | JSON.map(lambda j: json.dumps(j).encode()))
def test_no_message_breaks_the_codec(message):
    for row in haply.devices(message) or []:
        found = haply.numbers_of(row, "cursor_position", ("x", "y", "z"))
        assert found is None or np.isfinite(found).all()
        assert isinstance(haply.lacks(row), str)


def enabled(far):
    device = far.open()
    q, qd, sent, zero = (np.zeros(3) for _ in range(4))
    t_ns = far.now_ns

    def tick(effort=zero):
        nonlocal t_ns
        t_ns += PERIOD_NS
        status = device.measured_js(t_ns, q, qd)
        return max(status, device.servo_jf(effort.copy(), sent))

    for _ in range(3):
        tick()
    device.enable()
    return device, tick


def test_forces_reach_the_right_axes_with_their_signs():
    far = InverseFar()
    device, tick = enabled(far)
    for _ in range(3):
        assert tick(np.array([1.5, 0.5, -0.25])) is Status.OK
    said = json.loads(far.service.heard[-1])["inverse3"][0]["commands"]["set_cursor_force"]
    assert said == {"vector": {"x": 1.5, "y": -0.5, "z": -0.25}}
    assert np.allclose(far.effort(), [1.5, 0.5, -0.25])
    device.close()


def test_a_supply_that_is_cut_stops_the_arm_and_is_told():
    far = InverseFar()
    device, tick = enabled(far)
    far.device.powered = False
    assert max(tick() for _ in range(3)) is Status.INVALID
    assert "device 0A1B has no power supply" in device._wire.trouble
    device.close()


def test_a_service_that_ends_stops_the_arm_and_is_told():
    far = InverseFar()
    device, tick = enabled(far)
    far.service.drop()
    assert max(tick() for _ in range(3)) is Status.INVALID
    assert "closed the connection" in device._wire.trouble
    device.close()


def test_a_slow_service_gets_no_queue_of_messages():
    far = InverseFar()
    box = far.box()
    far.service.tick = lambda now_ns: None
    for k in range(6):
        box.receive(far.now_ns + (k + 1) * PERIOD_NS)
        box.send(np.zeros(3, np.int64))
    assert box.skipped == 6 - haply.FLYING


def test_the_device_that_is_meant_is_named_where_there_are_two():
    far = InverseFar()
    far.service.devices.append(SimInverse("0C2D", far.arm, [(0, 1), (1, 1), (2, 1)]))
    with pytest.raises(DeviceError, match=r"has 0A1B, 0C2D.*address = 'localhost:10001/0A1B'"):
        far.box(address="localhost")
    far.box(address="localhost/0C2D").close()


def test_positions_that_are_no_metres_are_refused():
    far = InverseFar()
    far.device.stretch = 2.0
    with pytest.raises(DeviceError, match=r"mount.scale .* no metres"):
        far.box()


def test_no_service_and_no_library_are_said_with_what_to_do(monkeypatch):
    far = InverseFar()
    with pytest.raises(DeviceError, match=r"no Inverse Service answers at localhost:7.*Haply Hub"):
        far.box(address="localhost:7")
    monkeypatch.setitem(sys.modules, "websockets.client", None)
    with pytest.raises(ConfigError, match=r"pip install 'hil-teleop\[haply\]'"):
        far.box()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"space": "tool"}, "cursor"),
        ({"format": "2"}, "3.5"),
        ({"space": "joints"}, "torque_unit"),
        ({"lost_ms": 0.0}, "stale_ms <= lost_ms"),
    ],
)
def test_options_out_of_range_are_refused(options, said):
    with pytest.raises(ConfigError, match=said):
        InverseConfig(**options)


def test_joints_are_read_in_radians_and_driven_in_the_unit_that_is_given():
    far = InverseFar(space="joints", torque_unit=0.5)
    far.pose[:] = 0.1, 0.2, 0.3
    box = far.box()
    box.power(True)
    t_ns = far.now_ns
    for k in range(4):
        box.receive(t_ns + (k + 1) * PERIOD_NS)
        box.send(np.round(np.array([0.05, 0.0, 0.0]) / box.scales[:, 2]).astype(np.int64))
    assert np.allclose(box.counts * box.scales[:, 0], [0.1, -0.2, 0.3], atol=1e-6)
    said = json.loads(far.service.heard[-1])["inverse3"][0]["commands"]["set_angular_torques"]
    assert said["torques"] == {"a0": 0.1, "a1": 0.0, "a2": 0.0}
    box.close()


def test_over_a_real_socket(monkeypatch, capsys):
    done = threading.Event()
    with socket.create_server(("localhost", 0)) as listener:
        service, world = single_device()
        thread = threading.Thread(target=serve_clients, args=(service, listener, world, done))
        thread.start()
        monkeypatch.setattr(haply, "PORT", listener.getsockname()[1])
        try:
            (seen,) = BOX.attached(Bus("ws"))
            assert seen.usable and seen.address == f"localhost:{haply.PORT}/0A1B"
            assert main(["--port", str(haply.PORT)]) == 3
            assert "in use" in capsys.readouterr().err
            bus = Bus("ws")
            box = BOX.open_box(
                "inverse",
                bus,
                f"localhost:{listener.getsockname()[1]}",
                InverseConfig(lost_ms=500.0),
                (0, 1, 2),
            )
            box.power(True)
            answers = 0
            for _ in range(200):
                answers += box.receive(bus.now_ns()) is Status.OK
                box.send(np.array([5000, 0, 0]))
                bus.pause(1e-3)
            assert answers > 100 and not box.trouble
            assert box.counts[0] * box.scales[0, 0] > 1e-3  # 0.5 N for a while
            box.close()
            assert not service.devices[0]._arm.codes.any()
        finally:
            done.set()
            thread.join(2.0)


def test_a_session_with_frames_answers_for_the_service(tmp_path):
    config = load_rig(rig_path("inverse3"))
    first, again = tmp_path / "a.mcap", tmp_path / "b.mcap"
    run_session(replace(config, record=RecordConfig(frames=True)), 0.2, 0, output=first)
    replayed = replace(config, backend="replay", record=RecordConfig(replay=str(first)))
    run_session(replayed, 0.2, 0, output=again)
    told = json.loads(read(first).metadata["box/inverse"]["settings"])
    assert told["gravity_compensation"] == {"enabled": True, "scaling_factor": 1.0}
    one, other = (read_fields(str(p), "/rig/raw")[1] for p in (first, again))
    for axis in ("1", "2", "3"):
        assert np.ptp(one[f"arm_count{axis}"]) > 0
        assert np.array_equal(one[f"arm_count{axis}"], other[f"arm_count{axis}"])
