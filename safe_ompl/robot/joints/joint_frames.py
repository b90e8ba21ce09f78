"""Poses of the joints of a robot: Pinocchio's forward kinematics, read as arrays."""

from __future__ import annotations

import logging
import threading

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from safe_ompl.arrays import FloatArray

_log = logging.getLogger(__name__)


class JointFrames(threading.local):
    """Pinocchio's working memory, one for each thread, with views on the joint poses it holds."""

    def __init__(self, model: pin.Model) -> None:
        self._model = model
        self.data = model.createData()
        self._views = _views(model, self.data)
        self.batch: tuple[FloatArray, FloatArray, FloatArray] | None = None  # configurations, and their poses

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the rotations (J, 3, 3) and origins (J, 3) of the joint frames at `q: (nq,)`; views, not to keep."""
        pin.forwardKinematics(self._model, self.data, q)
        return self._views or _read(self.data)

    @property
    def poses(self) -> tuple[FloatArray, FloatArray]:
        """The poses found last."""
        return self._views or _read(self.data)


def _read(data: pin.Data) -> tuple[FloatArray, FloatArray]:
    """Return the poses of all joints, read one by one."""
    poses = list(data.oMi)
    return np.array([pose.rotation for pose in poses]), np.array([pose.translation for pose in poses])


def _views(model: pin.Model, data: pin.Data) -> tuple[FloatArray, FloatArray] | None:
    """Return strided views on the poses of all joints, or None where Pinocchio keeps them in another way than thought.

    All poses lie in one block of memory: one strided view costs a thirtieth of reading them one by one. Nothing
    promises that, so the addresses are looked at first, and then the numbers at some configuration.
    """
    rotations = [pose.rotation for pose in data.oMi]
    translations = [pose.translation for pose in data.oMi]
    views = []
    for parts in (rotations, translations):
        addresses = np.array([part.ctypes.data for part in parts])
        stride = int(addresses[1] - addresses[0])
        if (np.diff(addresses) == stride).all():
            shape = (model.njoints, *parts[0].shape)
            views.append(as_strided(parts[0], shape, (stride, *parts[0].strides)))
    if len(views) == 2 and _right(model, data, views):
        return views[0], views[1]
    _log.warning(
        "Pinocchio %s keeps the poses of joints in another way than thought: they are read one by one, "
        "which is slower",
        pin.__version__,
    )
    return None


def _right(model: pin.Model, data: pin.Data, views: list[FloatArray]) -> bool:
    """Return whether the views show what Pinocchio says, at a configuration like no other."""
    some = pin.integrate(model, pin.neutral(model), np.linspace(0.3, 1.7, model.nv))
    pin.forwardKinematics(model, data, some)
    return all(np.array_equal(view, plain) for view, plain in zip(views, _read(data), strict=True))
