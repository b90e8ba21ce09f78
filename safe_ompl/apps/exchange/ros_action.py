"""The action `control_msgs/action/FollowJointTrajectory` of a node of ROS 2 around a `TrajectoryGuard`."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np

from safe_ompl.apps.exchange.execution import Execution, GoalError, Outcome, TrajectoryGuard
from safe_ompl.apps.exchange.messages import nanoseconds, stamp
from safe_ompl.common import InputError


def trajectory_action() -> Any:
    """Return the class of the action; raise InputError where there is none."""
    try:
        return import_module("control_msgs.action").FollowJointTrajectory
    except ImportError as error:
        what = f"needs control_msgs of ROS 2 ({error}): source yours, with ros-DISTRO-control-msgs"
        raise InputError(what) from None


class TrajectoryServer:
    """Serves the action under a name: goals go to the guard, what it reports becomes their result."""

    def __init__(self, node: Any, guard: TrajectoryGuard, name: str) -> None:
        self._node, self._guard, self._kind = node, guard, trajectory_action()
        self._handle: Any = None  # of the goal that is driven
        action = import_module("rclpy.action")
        self._future = import_module("rclpy.task").Future
        self.server = action.ActionServer(
            node,
            self._kind,
            name,
            self._execute,
            cancel_callback=lambda handle: self._cancel(handle, action.CancelResponse),
        )

    async def _execute(self, handle: Any) -> Any:
        """Let the guard drive a goal, and return its result; ticks go on meanwhile."""
        robot, options = self._guard.controller.cell.robot, self._guard.controller.options
        finished = self._future()
        try:
            execution = Execution.of(handle.request, robot, options.tolerance)
            execution.report = finished.set_result
            self._handle = handle
            self._guard.take(execution)
            outcome = await finished
        except GoalError as error:
            outcome = Outcome(error.code, str(error))
        if self._handle is handle:
            self._handle = None
        if outcome.cancelled and handle.is_cancel_requested:
            handle.canceled()
        elif outcome.code == 0:
            handle.succeed()
        else:
            self._node.get_logger().warning(f"aborted: {outcome.reason}")
            handle.abort()
        return self._kind.Result(error_code=int(outcome.code), error_string=outcome.reason)

    def _cancel(self, handle: Any, response: Any) -> Any:
        if handle is self._handle or (self._handle and handle.goal_id == self._handle.goal_id):
            self._guard.cancel()
        return response.ACCEPT

    def tell(self, time: float) -> None:
        """Publish where the robot should be and where it is, at a time [s]."""
        place, joints = self._guard.progress(), self._guard.controller.joints
        if self._handle is None or not self._handle.is_active or place is None or joints is None:
            return
        robot = self._guard.controller.cell.robot
        feedback = self._kind.Feedback(joint_names=list(robot.joint_names))
        _set(feedback.header.stamp, time)
        after, q, qd = place
        rows = ((q, qd), (joints.q, joints.qd), (robot.difference(joints.q, q), qd - joints.qd))
        parts = (feedback.desired, feedback.actual, feedback.error)
        for part, (positions, velocities) in zip(parts, rows, strict=True):
            part.positions, part.velocities = positions.tolist(), np.nan_to_num(velocities).tolist()
            _set(part.time_from_start, max(after, 0.0))
        self._handle.publish_feedback(feedback)


def _set(message: Any, time: float) -> None:
    """Let a Time or Duration be a number of seconds."""
    for field, value in stamp(nanoseconds(time)).items():
        setattr(message, field, value)
