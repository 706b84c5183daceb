"""Bags of every generation, written by the library that writes them, of a plant's motion."""

from __future__ import annotations

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

#: Time of the first message [ns]: an epoch time, which no float holds to the microsecond.
START = 1_700_000_000_123_456_789
KINDS = ("mcap", "db3", "bag")
_POINT = "trajectory_msgs/JointTrajectoryPoint"
STATE = (
    f"std_msgs/Header header\nstring[] joint_names\n{_POINT} desired\n{_POINT} actual\n"
    f"{_POINT} error"
)
CONTROL = "control_msgs/msg/JointTrajectoryControllerState"


class BagFile:
    """A bag that is written; `path` is what a user would name."""

    def __init__(self, folder, kind, name="run"):
        self.first = kind == "bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.first else Stores.ROS2_JAZZY)
        self.store.register(get_types_from_msg(STATE, CONTROL))
        self.path = folder / (f"{name}.bag" if self.first else name)
        plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
        self.writer = (
            Writer1(self.path)
            if self.first
            else Writer2(self.path, version=9, storage_plugin=plugin)
        )
        self.topics = {}

    def __enter__(self):
        self.writer.open()
        return self

    def __exit__(self, *_):
        self.writer.close()

    def type(self, name):
        return self.store.types[name]

    def put(self, topic, kind, stamp, message):
        """Write a message at a time [ns]."""
        if topic not in self.topics:
            self.topics[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        pack = self.store.serialize_ros1 if self.first else self.store.serialize_cdr
        self.writer.write(self.topics[topic], int(stamp), pack(message, kind))

    def header(self, stamp, frame=""):
        time = self.type("builtin_interfaces/msg/Time")(int(stamp // 10**9), int(stamp % 10**9))
        more = {"seq": 0} if self.first else {}
        return self.type("std_msgs/msg/Header")(stamp=time, frame_id=frame, **more)

    def joints(self, topic, t, names, q, qd=None, tau=None, stamped=True, late=0):
        """Joint states at times t [s]; received `late` [ns] after their stamps."""
        kind = "sensor_msgs/msg/JointState"
        empty = np.zeros(0)
        for k, ns in enumerate(nanoseconds(t)):
            message = self.type(kind)(
                header=self.header(ns if stamped else 0),
                name=list(names),
                position=empty if q is None else q[k],
                velocity=empty if qd is None else qd[k],
                effort=empty if tau is None else tau[k],
            )
            self.put(topic, kind, ns + late, message)

    def controller(self, topic, t, names, q, qd, tau):
        """State of a trajectory controller."""
        point = self.type("trajectory_msgs/msg/JointTrajectoryPoint")
        time = self.type("builtin_interfaces/msg/Duration")(0, 0)
        empty = np.zeros(0)
        none = point(empty, empty, empty, empty, time)
        for k, ns in enumerate(nanoseconds(t)):
            seen = point(q[k], qd[k], empty, tau[k], time)
            message = self.type(CONTROL)(self.header(ns), list(names), none, seen, none)
            self.put(topic, CONTROL, ns, message)

    def numbers(self, topic, t, values):
        """Numbers without names and stamps."""
        kind = "std_msgs/msg/Float64MultiArray"
        layout = self.type("std_msgs/msg/MultiArrayLayout")([], 0)
        for ns, row in zip(nanoseconds(t), values, strict=True):
            self.put(topic, kind, ns, self.type(kind)(layout, np.asarray(row)))

    def force(self, topic, t, wrench, frame):
        kind, vector = "geometry_msgs/msg/WrenchStamped", self.type("geometry_msgs/msg/Vector3")
        for ns, row in zip(nanoseconds(t), wrench, strict=True):
            both = self.type("geometry_msgs/msg/Wrench")(vector(*row[:3]), vector(*row[3:]))
            self.put(topic, kind, ns, self.type(kind)(self.header(ns, frame), both))

    def description(self, text, topic="/robot_description"):
        self.put(topic, "std_msgs/msg/String", START, self.type("std_msgs/msg/String")(text))


def nanoseconds(t):
    return START + np.round(np.asarray(t) * 1e9).astype(np.int64)
