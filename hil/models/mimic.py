"""Mimic joints of a URDF: joints that follow another one, q_k = multiplier q_j + offset."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

FloatArray = NDArray[np.float64]


def followed(urdf: str, joints: Sequence[str]) -> tuple[list[str], FloatArray, FloatArray]:
    """Independent joints and the map from them to all joints, q_all = A q + b.

    Parameters
    ----------
    urdf : str
        URDF text.
    joints : sequence of str
        All moving joints, in the rigid-body library's order.

    Returns
    -------
    own : list of str
        The d joints that follow no other one.
    matrix : ndarray (len(joints), d)
        A; one 1 a row but for joints that follow.
    offset : ndarray (len(joints),)
        b [rad or m].

    Raises
    ------
    ConfigError
        If a joint follows one that does not exist, or itself by way of others.
    """
    mimics = {
        str(joint.get("name")): element
        for joint in ET.fromstring(urdf).iter("joint")
        if (element := joint.find("mimic")) is not None and joint.get("name") in joints
    }
    own = [name for name in joints if name not in mimics]
    matrix, offset = np.zeros((len(joints), len(own))), np.zeros(len(joints))
    for k, name in enumerate(joints):
        leader, factor, shift, seen = name, 1.0, 0.0, {name}
        while leader in mimics:
            # q_name = factor q_leader + shift,  q_leader = multiplier q_next + offset
            element = mimics[leader]
            shift += factor * float(element.get("offset", "0"))
            factor *= float(element.get("multiplier", "1"))
            leader = element.get("joint", "")
            if leader not in joints or leader in seen:
                raise ConfigError(
                    f"URDF joint {name!r} mimics {leader!r}, expected another moving joint "
                    f"({', '.join(own)}); name one of them in its <mimic>"
                )
            seen.add(leader)
        matrix[k, own.index(leader)], offset[k] = factor, shift
    return own, matrix, offset
