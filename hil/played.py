"""What a session holds for a replay: rig, measurements, commands, on rows all channels share."""

from __future__ import annotations

import dataclasses
import json
import tomllib
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hil.config import RigConfig
from hil.errors import DataError
from hil.record.container import Container
from hil.record.decode import decode_joint_state, decode_numbers
from hil.runtime.frame import TIMING
from hil.session import WORDS
from hil.signals.device import FloatArray, IntArray
from hil.signals.state import OperatingState
from hil.tomltable import parse

_ENABLED = int(OperatingState.ENABLED)


@dataclass
class Played:
    """What a session holds for a replay, on the rows that all its channels share."""

    config: RigConfig
    ticks: IntArray
    times: FloatArray
    u: FloatArray
    sent: FloatArray
    codes: FloatArray
    timing: dict[str, FloatArray]
    states: dict[int, FloatArray]
    commands: dict[int, list[str]]


def played(box: Container, folder: Path) -> Played:
    """Everything that a replay needs."""
    if "rig.toml" not in box.attachments:
        raise DataError(f"session {box.path} has no rig file; only sessions of 'hil run' replay")
    config = parse(RigConfig, tomllib.loads(box.attachments["rig.toml"].decode()), "rig")
    if "trajectory.toml" in box.attachments:
        (folder / "trajectory.toml").write_bytes(box.attachments["trajectory.toml"])
        law = config.controller
        played = {**law.parameters, "trajectory": str(folder / "trajectory.toml")}
        config = dataclasses.replace(config, controller=dataclasses.replace(law, parameters=played))
    needed = [f"/{a}/{c}" for a in config.controller.arms
              for c in ("measured_js", "setpoint_jf", "measured_cf")]  # fmt: skip
    needed += ["/rig/raw", "/loop/timing"]
    for name in needed:
        if name not in box.topics or not len(box.topics[name]):
            raise DataError(f"session {box.path} holds nothing on {name}; it cannot be replayed")
    n = min(len(box.topics[name]) for name in needed)
    if any(box.topics[name].sequence[:n] != box.topics[needed[0]].sequence[:n] for name in needed):
        raise DataError(f"session {box.path}: its channels do not hold the same ticks")
    return _arrays(box, config, n)


def _arrays(box: Container, config: RigConfig, n: int) -> Played:
    arms = config.controller.arms
    u, sent, codes = np.zeros((n, len(arms), 12)), np.zeros((n, len(arms), 3)), []
    raw = decode_numbers(box.topics["/rig/raw"])[:n].reshape(n, len(arms), len(WORDS))
    for a, arm in enumerate(arms):
        _, js = decode_joint_state(box.topics[f"/{arm}/measured_js"])
        _, jf = decode_joint_state(box.topics[f"/{arm}/setpoint_jf"])
        for part, at in (("position", 0), ("velocity", 3)):
            u[:, a, at : at + 3] = _given(js[part], box, arm)[:n]
        u[:, a, 6:] = decode_numbers(box.topics[f"/{arm}/measured_cf"])[:n]
        sent[:, a] = _given(jf["effort"], box, arm)[:n]
        codes.append(raw[:, a, 3:6])
    columns = decode_numbers(box.topics["/loop/timing"])[:n]
    timing = {name: columns[:, k] for k, name in enumerate(TIMING[: columns.shape[1]])}
    timing.setdefault("state", np.full(n, float(_ENABLED)))
    states = {}
    if "/controller/state" in box.topics and len(box.topics["/controller/state"]):
        topic = box.topics["/controller/state"]
        states = dict(zip(topic.sequence, decode_numbers(topic), strict=True))
    ticks = box.topics["/loop/timing"].ticks[:n]
    times = box.topics["/loop/timing"].stamps[:n].astype(np.float64)
    return Played(
        config, ticks, times, u, sent, np.stack(codes, axis=1), timing, states, _commands(box)
    )


def _given(values: FloatArray | None, box: Container, arm: str) -> FloatArray:
    if values is None:
        raise DataError(f"session {box.path}: arm {arm!r} misses a part of its state")
    return values


def _commands(box: Container) -> dict[int, list[str]]:
    """Tick -> commands that the loop obeyed before it."""
    found: dict[int, list[str]] = defaultdict(list)
    for raw in box.topics["/events"].data if "/events" in box.topics else ():
        event = json.loads(raw)
        if event["name"] == "command":
            found[event["tick"]].append(event["data"]["text"])
    return found
