"""Plain checks of claimed limits of the tool along motions: for the verifier of certificates."""

from __future__ import annotations

from collections.abc import Callable
from math import acos, sqrt

import numpy as np
import pinocchio as pin

from safe_ompl.certificates.claims import Tool
from safe_ompl.common import FloatArray
from safe_ompl.robot import Robot

_SMALLEST = 1e-5  # [rad or m] intervals in which the tool moves less are not divided any more
_LEAST_STEP = 1e-7  # [rad or m] intervals in which no joint moves more, neither
_ROUNDING = 1e-7  # [rad or m], that of the arc cosine included


class PlainTool:
    """Angle and position of the tip, and how far they can change.

    Parameters
    ----------
    robot : Robot
        The robot.
    claim : Tool
        Its limits.
    """

    def __init__(self, robot: Robot, claim: Tool) -> None:
        self._robot, self._claim = robot, claim
        self._model = robot.shared.model
        self._data = self._model.createData()
        carrier = int(self._model.frames[robot.tip_frame].parentJoint)
        moving = set(self._model.supports[carrier])
        self._moves = np.array([joint in moving for joint in range(1, self._model.njoints)])

    def exceeded(
        self, start: FloatArray, delta: FloatArray, tube: FloatArray | float = 0.0
    ) -> tuple[float, str] | None:
        """Return where on an edge, and which limit is not proven to be kept; else None."""
        return self.exceeded_along(lambda t: start + t * delta, np.abs(delta), tube)

    def exceeded_along(
        self, place: Callable[[float], FloatArray], steps: FloatArray, tube: FloatArray | float = 0.0
    ) -> tuple[float, str] | None:
        """Return the same of a motion q(t), t from 0 to 1, along which joints move no faster than `steps: (n,)`.

        Joints may be off by the widths of a tube besides.
        """
        waiting = [(0.5, 0.5)]
        while waiting:
            centre, half = waiting.pop()
            for name, excess, change in self._excesses(place(centre), half * steps + tube):
                if excess + change <= _ROUNDING:
                    continue
                if excess > _ROUNDING or change < _SMALLEST or half * steps.max() < _LEAST_STEP:
                    return centre, name
                waiting += [(centre + half / 2, half / 2), (centre - half / 2, half / 2)]
                break
        return None

    def _excesses(self, q: FloatArray, steps: FloatArray) -> list[tuple[str, float, float]]:
        """Return for each limit its name, by how much it is exceeded at `q`, and how much that can change."""
        robot, claim = self._robot, self._claim
        pin.framesForwardKinematics(self._model, self._data, robot.pinocchio_configuration(q))
        tip = self._data.oMf[robot.tip_frame]
        reach = robot.coupling.reach(steps) * self._moves
        found = []
        if claim.orientation is not None:
            axis, direction = claim.orientation.axis, claim.orientation.direction
            cosine = (tip.rotation @ axis) @ direction / sqrt((axis @ axis) * (direction @ direction))
            angle = acos(min(1.0, max(-1.0, float(cosine))))
            turned = self._turned(tip.rotation @ axis / sqrt(axis @ axis), reach)
            found.append(("orientation", angle - claim.orientation.angle, turned))
        if claim.position is not None:
            bounds = claim.position.items()
            here = dict(zip("xyz", tip.translation, strict=True))
            outside = max(max(low - here[key], here[key] - high) for key, (low, high) in bounds)
            found.append(("position", float(outside), self._moved(tip.translation, reach)))
        return found

    def _turned(self, tool: FloatArray, reach: FloatArray) -> float:
        """Return how far [rad] an axis can turn while the model's joints move by `reach`: on cones about theirs."""
        axes = self._robot.shared.chain.axes
        turned = 0.0
        for i in np.flatnonzero(reach * ~self._robot.joint_prismatic):
            across = np.cross(self._data.oMi[int(i) + 1].rotation @ axes[i], tool)
            turned += float(reach[i]) * sqrt(float(across @ across))
        return turned

    def _moved(self, point: FloatArray, reach: FloatArray) -> float:
        """Return how far [m] the tip can move while the model's joints move by up to `reach`."""
        moved = 0.0
        axes = self._robot.shared.chain.axes
        for i in np.flatnonzero(reach):
            joint = self._data.oMi[int(i) + 1]
            arm = np.cross(joint.rotation @ axes[i], point - joint.translation)
            moved += float(reach[i]) * (1.0 if self._robot.joint_prismatic[i] else sqrt(float(arm @ arm)))
        return moved
