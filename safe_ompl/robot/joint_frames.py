"""Where the joints of a robot are: Pinocchio's forward kinematics, read as arrays."""

from __future__ import annotations

import threading

import pinocchio as pin
from numpy.lib.stride_tricks import as_strided

from safe_ompl.arrays import FloatArray


class JointFrames(threading.local):
    """Pinocchio's working memory, one for each thread, with views on the joint poses it holds."""

    def __init__(self, model: pin.Model) -> None:
        self._model = model
        self.data = model.createData()
        # All poses lie in one block of memory: one strided view costs a thirtieth of reading them one by one.
        first, second = (self.data.oMi[joint].rotation for joint in (0, 1))
        stride = second.ctypes.data - first.ctypes.data
        origin = self.data.oMi[0].translation
        self._rotation = as_strided(first, (model.njoints, 3, 3), (stride, *first.strides))
        self._translation = as_strided(origin, (model.njoints, 3), (stride, *origin.strides))
        self.batch: tuple[FloatArray, FloatArray, FloatArray] | None = None  # configurations, and their poses

    def forward(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return views of the rotations (J, 3, 3) and origins (J, 3) of the joint frames at `q: (nq,)`."""
        pin.forwardKinematics(self._model, self.data, q)
        return self.poses

    @property
    def poses(self) -> tuple[FloatArray, FloatArray]:
        """The views on the poses found last."""
        return self._rotation, self._translation
