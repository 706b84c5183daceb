"""Robots given by a URDF, through Pinocchio.

Mimic joints of a URDF: joints that follow another one, q_k = multiplier q_j + offset.
"""

from __future__ import annotations

import contextlib
import os
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError, DataError
from hil.models import bodies
from hil.record.urdf_checks import checked_urdf, gravity_of

FloatArray = NDArray[np.float64]
_BODY = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_BODY_UNITS = ("kg", "kg m", "kg m", "kg m") + ("kg m^2",) * 6


@contextlib.contextmanager
def _mute() -> Iterator[None]:
    """Keep what a library prints of a bad file, names and all, from the standard error."""
    sys.stderr.flush()
    kept = os.dup(2)
    try:
        with open(os.devnull, "wb") as nothing:
            os.dup2(nothing.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


#: Elements of a joint of which its motion does not depend.
_NO_MOTION = ("limit", "dynamics", "safety_controller", "calibration")


def _bodies_text(root: ET.Element) -> str:
    """The description without limits, of which the library wants all or refuses the robot."""
    for joint in root.findall("joint"):
        for element in [e for tag in _NO_MOTION for e in joint.findall(tag)]:
            joint.remove(element)
        if joint.get("type") in ("revolute", "prismatic"):
            ET.SubElement(joint, "limit", effort="0", velocity="0")
    return ET.tostring(root, encoding="unicode")


class UrdfRobot:
    """Serial or tree robot with one-degree-of-freedom joints.

    Joints that mimic another one are no joints of their own: with q_all = A q + b all bodies
    count, and efforts come back by virtual work, tau = A' tau_all.

    Parameters
    ----------
    urdf : str
        URDF text.
    tip : str
        Frame of the external force; default the frame ``tip``, else the last frame.

    Raises
    ------
    ConfigError
        If the URDF does not parse, holds what no robot has (`hil.record.urdf_checks`), has a
        joint with more than one degree of freedom or one that mimics nothing, or lacks the named
        tip.
    """

    has_armature = True

    def __init__(self, urdf: str, tip: str = "") -> None:
        try:
            root = checked_urdf(urdf)
        except DataError as error:
            raise ConfigError(str(error)) from error
        import pinocchio as pin

        self._pin = pin
        try:
            with _mute():
                self._model = pin.buildModelFromXML(_bodies_text(root))
        except (ValueError, RuntimeError) as error:
            raise ConfigError(f"the URDF does not parse: {error}") from error
        model = self._model
        model.gravity.linear = np.array(gravity_of(root))
        bad = [n for n, j in zip(model.names, model.joints, strict=True) if j.nv > 1]
        if bad:
            raise ConfigError(f"URDF joints with several degrees of freedom: {', '.join(bad)}")
        self._data = model.createData()
        moving = list(model.names)[1:]
        own, self._all, self._shift = followed(urdf, moving)
        self.joints = tuple(own)
        kinds = {n: j.shortname() for n, j in zip(model.names, model.joints, strict=True)}
        self.units = tuple(
            "m" if "P" in kinds[n].removeprefix("JointModel")[:1] else "rad" for n in own
        )
        self.names = tuple(f"{joint}.{name}" for joint in moving for name in _BODY)
        self.param_units = tuple(_BODY_UNITS * len(moving))
        self.prior = np.concatenate([i.toDynamicParameters() for i in list(model.inertias)[1:]])
        self._tip = self._frame(tip)
        #: Number of the body behind each joint, from 0 on.
        self._moved = [moving.index(name) for name in own]
        self._continuous = [j.nq == 2 for j in list(model.joints)[1:]]
        self._same = self._all.shape[0] == self._all.shape[1]
        self._tree = self._numbers()

    def _numbers(self) -> tuple[Any, ...]:
        """Parents, poses, axes and gravity of the tree, for `bodies.regressor`."""
        pin, model, local = self._pin, self._model, self._pin.ReferenceFrame.LOCAL
        pin.computeJointJacobians(model, self._data, pin.neutral(model))
        count = range(1, model.njoints)
        # each joint moves its own column alone; seen from its own frame that is its axis
        # (Pinocchio gives (6,) for a robot of one joint)
        own = [
            np.reshape(pin.getJointJacobian(model, self._data, k, local), (6, -1)) for k in count
        ]
        axis = np.array([own[k - 1][:, model.idx_vs[k]] for k in count])
        parent = np.array([model.parents[k] - 1 for k in count], dtype=np.int64)
        turn = np.array([model.jointPlacements[k].rotation for k in count])
        place = np.array([model.jointPlacements[k].translation for k in count])
        return parent, turn, place, axis, np.array(model.gravity.linear)

    @property
    def tree(self) -> bodies.Tree:
        """Its bodies, one behind each moving joint."""
        moving = tuple(list(self._model.names)[1:])
        parent, turn, place, axis, gravity = self._tree
        own = np.eye(10 * len(moving))
        return bodies.Tree(moving, parent, turn, place, axis, gravity, self._all, self._shift, own)

    def _frame(self, tip: str) -> int:
        frames = [f.name for f in self._model.frames]
        if tip and tip not in frames:
            raise ConfigError(f"URDF has no frame {tip!r}. Available: {', '.join(frames)}")
        name = tip or ("tip" if "tip" in frames else frames[-1])
        return len(frames) - 1 - frames[::-1].index(name)

    def _config(self, q: FloatArray) -> FloatArray:
        """All joints' angles as Pinocchio wants them (continuous ones as cosine and sine)."""
        q = q @ self._all.T + self._shift
        if not any(self._continuous):
            return q
        columns: list[FloatArray] = []
        for j, continuous in enumerate(self._continuous):
            columns += [np.cos(q[:, j]), np.sin(q[:, j])] if continuous else [q[:, j]]
        return np.stack(columns, axis=1)

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Joint torque regressor (n, d, 10 bodies), Pinocchio's parameter order."""
        back = self._all.T
        # tau = A' Y(A q + b, A qd, A qdd) pi
        states = (q @ back + self._shift, qd @ back, qdd @ back)
        every: FloatArray = bodies.regressor(*(*self._tree, *states))
        return every if self._same else back @ every

    def balance(
        self, q: FloatArray, qd: FloatArray, pi: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Effort without acceleration (n, d) and mass matrix (n, d, d) for parameters (n, p)."""
        back = self._all.T
        states = (q @ back + self._shift, qd @ back)
        rest, mass = bodies.balance(*(*self._tree, *states, pi))
        return (rest, mass) if self._same else (rest @ self._all, back @ mass @ self._all)

    def _at_tip(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Place (n, 3), axes (n, 3, 3) and Jacobian (n, 6, d) of the tip, in base axes."""
        at = self._model.frames[self._tip].placement
        known = (*self._tree[:4], q @ self._all.T + self._shift, self._held)
        held = np.array(at.translation), np.array(at.rotation)
        place, axes, jac = bodies.frame_motion(*known, *held)  # type: ignore[call-arg]
        return place, axes, jac if self._same else jac @ self._all

    def tip(self, q: FloatArray) -> FloatArray:
        """Tip position in base axes (n, 3) [m]."""
        return self._at_tip(q)[0]

    def places(self, q: FloatArray) -> FloatArray:
        """Base, joints and tip for angles (d,), shape (joints + 2, 3) [m]."""
        self._pin.framesForwardKinematics(self._model, self._data, self._config(q[None])[0])
        joints = [p.translation.copy() for p in list(self._data.oMi)[1:]]
        return np.stack([np.zeros(3), *joints, self._data.oMf[self._tip].translation.copy()])

    def tip_axes(self, q: FloatArray) -> FloatArray | None:
        """Axes of the tip's frame as columns in base axes (n, 3, 3)."""
        return self._at_tip(q)[1]

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Tip Jacobian in base axes (n, 6, d): linear rows first."""
        return self._at_tip(q)[2]

    def external(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """tau_ext = J^T w, shape (n, d)."""
        effort: FloatArray = np.einsum("nkd,nk->nd", self.jacobian(q), wrench)
        return effort

    def tip_mass(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray | None:
        """Effort J^T (p'' + g e_z) of one kilogram at the tip, shape (n, d)."""
        effort: FloatArray = self.tip_load(q, qd, qdd)[:, :, 0]
        return effort

    def tip_load(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Effort of one kilogram at the tip and of its moments, shape (n, d, 4)."""
        if not self._model.frames[self._tip].parentJoint:
            return np.zeros((len(q), q.shape[1], 4))
        return self._carried(self._held, q, qd, qdd)[:, :, :4]

    @property
    def _held(self) -> int:
        """Number of the body that the tip is fixed to, from 0 on; -1 for the base."""
        return int(self._model.frames[self._tip].parentJoint) - 1

    @property
    def links(self) -> tuple[int, ...]:
        """Joints that move a link of their own, from 1 on: the tip's, then from the base on."""
        holder = self._held
        while holder >= 0 and holder not in self._moved:
            holder = int(self._tree[0][holder])
        order = sorted(range(len(self.joints)), key=lambda k: self._moved[k] != holder)
        return tuple(k + 1 for k in order)

    def body_load(self, q: FloatArray, qd: FloatArray, qdd: FloatArray, link: int) -> FloatArray:
        """Effort of a body on the link behind joint number `link`, shape (n, d, 10)."""
        return self._carried(self._moved[link - 1], q, qd, qdd)

    def _carried(self, body: int, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Effort (n, d, 10) of unit parameters on a body: about the tip if it holds it."""
        back = self._all.T
        states = (q @ back + self._shift, qd @ back, qdd @ back)
        own: FloatArray = bodies.regressor(*(*self._tree, *states), body)  # type: ignore[call-arg]
        own = own if self._same else back @ own
        if body != self._held:
            return own
        at = np.asarray(self._model.frames[self._tip].placement.translation)
        return np.asarray(own @ bodies.about(at))


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
