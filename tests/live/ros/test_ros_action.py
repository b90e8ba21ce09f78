"""The action of a guard with real middleware on this machine: a client, a robot and a person here, the node beside.

Without ROS and control_msgs the tests are skipped, except where SAFE_OMPL_ROS=1 says that they must be there.
"""

import os
import sys

import numpy as np
import pytest

os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 50))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
if os.environ.get("SAFE_OMPL_ROS") != "1":
    pytest.importorskip("rclpy")
    pytest.importorskip("rosbags")
    pytest.importorskip("control_msgs")
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory
from rclpy.action import ActionClient
from test_ros_node import GOAL, NAMES, START, World, driven
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from safe_ompl.apps import main
from safe_ompl.live.ros import Code

pytestmark = pytest.mark.end_to_end
VIA = [0.1, -0.6, 0.0, -2.3, 0.0, 2.8, 0.785]


class Client(World):
    """A client of the action beside a robot, whose controller is commanded by the guard."""

    def __init__(self):
        super().__init__()
        self.seen = []
        self.node.create_subscription(JointTrajectory, "/arm/joint_trajectory", self.command, 10)
        self.action = ActionClient(self.node, FollowJointTrajectory, "arm/guard")

    def send(self, *points, seconds=3.0, names=NAMES, **more):
        """Send a goal through points at equal times; return its handle, which is accepted."""
        goal = FollowJointTrajectory.Goal(**more)
        goal.trajectory.joint_names = names
        for k, q in enumerate(points):
            point = JointTrajectoryPoint(positions=list(map(float, q)))
            if k in (0, len(points) - 1):
                point.velocities = [0.0] * len(q)
            else:
                point.velocities = ((np.array(points[k + 1]) - points[k - 1]) / (2 * seconds)).tolist()
            point.time_from_start.sec = int(k * seconds)
            goal.trajectory.points.append(point)
        self.seen = []
        sent = self.action.send_goal_async(goal, feedback_callback=lambda message: self.seen.append(message.feedback))
        self.wait(sent.done, "no answer to a goal")
        assert sent.result().accepted
        return sent.result()

    def result(self, handle):
        """Wait for the end of a goal; return its status and result."""
        got = handle.get_result_async()
        self.wait(got.done, "no result")
        return got.result().status, got.result().result


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    folder = tmp_path_factory.mktemp("guard")
    with driven(folder, "panda_shelf", "--controller", "arm", command="guard", make=Client) as client:
        assert client.action.wait_for_server(60.0)
        yield client
    assert "Traceback" not in (folder / "node.log").read_text()


def test_a_trajectory_is_driven_with_feedback(client):
    status, result = client.result(client.send(START, VIA, GOAL))
    assert (status, result.error_code, result.error_string) == (GoalStatus.STATUS_SUCCEEDED, 0, "")
    np.testing.assert_allclose(client.q, GOAL, atol=1e-4)
    assert client.seen
    assert client.seen[-1].joint_names == NAMES
    places = [f.desired.time_from_start.sec + 1e-9 * f.desired.time_from_start.nanosec for f in client.seen]
    assert (np.diff(places) >= -1e-9).all()
    assert 5.0 < places[-1] <= 6.0 + 1e-6
    for feedback in client.seen:
        away = np.array(feedback.desired.positions) - feedback.actual.positions
        np.testing.assert_allclose(away, feedback.error.positions, atol=1e-12)


def test_cancel_new_goals_and_goals_that_are_not_free(client):
    handle = client.send(client.q, VIA, GOAL)
    client.wait(lambda: client.q[0] < START[0] - 0.4, "no motion")
    asked = handle.cancel_goal_async()
    client.wait(asked.done, "no answer to cancel")
    status, result = client.result(handle)
    assert (status, result.error_string) == (GoalStatus.STATUS_CANCELED, "cancelled")
    assert not client.qd.any()
    first = client.send(client.q, START, seconds=4.0)
    client.wait(lambda: np.abs(client.qd).max() > 0.05, "no motion")
    second = client.send(GOAL, START)
    for handle, said in ((first, "a new trajectory took its place"), (second, "from where 'panda_joint")):
        status, result = client.result(handle)
        assert (status, result.error_code) == (GoalStatus.STATUS_ABORTED, Code.INVALID_GOAL)
        assert said in result.error_string
    down = [client.q[0], 1.7, *client.q[2:]]
    status, result = client.result(client.send(client.q, down))
    assert status == GoalStatus.STATUS_ABORTED
    assert "not proven free of collision at " in result.error_string
    status, _ = client.result(client.send(client.q, START))
    assert status == GoalStatus.STATUS_SUCCEEDED


def test_the_node_says_that_control_msgs_is_missing(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "control_msgs", None)
    monkeypatch.setitem(sys.modules, "control_msgs.action", None)
    assert main(["guard", "panda_shelf", "--controller", "arm"]) == 2
    assert "needs control_msgs of ROS 2 (" in capsys.readouterr().err
