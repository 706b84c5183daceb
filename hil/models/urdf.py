"""Robots given by a URDF, through Pinocchio."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hil.errors import ConfigError

FloatArray = NDArray[np.float64]
_BODY = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
_BODY_UNITS = ("kg", "kg m", "kg m", "kg m") + ("kg m^2",) * 6


class UrdfRobot:
    """Serial or tree robot with one-degree-of-freedom joints.

    Parameters
    ----------
    urdf : str
        URDF text.
    tip : str
        Frame of the external force; default the frame ``tip``, else the last frame.

    Raises
    ------
    ConfigError
        If the URDF does not parse, has a joint with more than one degree of freedom, or
        lacks the named tip.
    """

    has_armature = True

    def __init__(self, urdf: str, tip: str = "") -> None:
        import pinocchio as pin

        self._pin = pin
        try:
            self._model = pin.buildModelFromXML(urdf)
        except (ValueError, RuntimeError) as error:
            raise ConfigError(f"the URDF does not parse: {error}") from error
        model = self._model
        bad = [n for n, j in zip(model.names, model.joints, strict=True) if j.nv > 1]
        if bad:
            raise ConfigError(f"URDF joints with several degrees of freedom: {', '.join(bad)}")
        self._data = model.createData()
        moving = list(model.names)[1:]
        self.joints = tuple(moving)
        self.units = tuple(
            "m" if "P" in j.shortname().removeprefix("JointModel")[:1] else "rad"
            for j in list(model.joints)[1:]
        )
        self.names = tuple(f"{joint}.{name}" for joint in moving for name in _BODY)
        self.param_units = tuple(_BODY_UNITS * len(moving))
        self.prior = np.concatenate([i.toDynamicParameters() for i in list(model.inertias)[1:]])
        self._tip = self._frame(tip)
        self._continuous = [j.nq == 2 for j in list(model.joints)[1:]]

    def _frame(self, tip: str) -> int:
        frames = [f.name for f in self._model.frames]
        if tip and tip not in frames:
            raise ConfigError(f"URDF has no frame {tip!r}. Available: {', '.join(frames)}")
        name = tip or ("tip" if "tip" in frames else frames[-1])
        return len(frames) - 1 - frames[::-1].index(name)

    def _config(self, q: FloatArray) -> FloatArray:
        """Joint angles as Pinocchio wants them (continuous joints as cosine and sine)."""
        if not any(self._continuous):
            return q
        columns: list[FloatArray] = []
        for j, continuous in enumerate(self._continuous):
            columns += [np.cos(q[:, j]), np.sin(q[:, j])] if continuous else [q[:, j]]
        return np.stack(columns, axis=1)

    def regressor(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray:
        """Joint torque regressor (n, d, 10 bodies), Pinocchio's parameter order."""
        n, d = q.shape
        out = np.empty((n, d, 10 * d))
        pin, model, data = self._pin, self._model, self._data
        for k, row in enumerate(self._config(q)):
            out[k] = pin.computeJointTorqueRegressor(model, data, row, qd[k], qdd[k])
        return out

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Tip Jacobian in base axes (n, 6, d): linear rows first."""
        pin, frame = self._pin, self._pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        out = np.empty((len(q), 6, q.shape[1]))
        for k, row in enumerate(self._config(q)):
            out[k] = pin.computeFrameJacobian(self._model, self._data, row, self._tip, frame)
        return out

    def external(self, q: FloatArray, wrench: FloatArray) -> FloatArray:
        """tau_ext = J^T w, shape (n, d)."""
        effort: FloatArray = np.einsum("nkd,nk->nd", self.jacobian(q), wrench)
        return effort

    def tip_mass(self, q: FloatArray, qd: FloatArray, qdd: FloatArray) -> FloatArray | None:
        """Effort J^T (p'' + g e_z) of one kilogram at the tip, shape (n, d)."""
        pin, frame = self._pin, self._pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        acceleration = np.empty((len(q), 3))
        for k, row in enumerate(self._config(q)):
            pin.forwardKinematics(self._model, self._data, row, qd[k], qdd[k])
            acceleration[k] = pin.getFrameClassicalAcceleration(
                self._model, self._data, self._tip, frame
            ).linear
        acceleration -= self._model.gravity.linear
        effort: FloatArray = np.einsum("nkd,nk->nd", self.jacobian(q)[:, :3], acceleration)
        return effort
