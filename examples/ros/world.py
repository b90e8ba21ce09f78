"""A simulated robot, a person who walks up and down, and goals, for `safe-ompl ros panda_shelf`; needs ROS 2.

Start the node, then `python examples/ros/world.py`: the robot goes there and back, and the node's states are printed.
"""

import time

import numpy as np

try:
    import rclpy
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import JointState
    from trajectory_msgs.msg import JointTrajectory
    from visualization_msgs.msg import Marker, MarkerArray
except ModuleNotFoundError as error:
    what = "source ROS 2, or on Linux with Python 3.11: pip install 'safe-ompl[ros]'"
    raise SystemExit(f"{error.name} is missing (rclpy and messages): {what}") from None

from safe_ompl.geometry import STANDING

NAMES = [f"panda_joint{k}" for k in range(1, 8)]
GOALS = [[1.45, 0.1, 0.0, -1.7, 0.0, 3.37, 0.785], [-1.25, 0.4, 0.0, -2.1, 0.0, 2.5, 0.785]]
rclpy.init()
node = rclpy.create_node("world")
joints = node.create_publisher(JointState, "joint_states", 1)
people = node.create_publisher(MarkerArray, "people", 1)
goal = node.create_publisher(JointState, "goal", 1)
told, said = [], [""]


def seconds(stamp):
    """Return a time or duration of ROS in seconds."""
    return stamp.sec + 1e-9 * stamp.nanosec


def publish_joints():
    """Be where the newest command that has begun has the robot."""
    now = node.get_clock().now()
    begun = [message for message in told if seconds(message.header.stamp) <= 1e-9 * now.nanoseconds]
    state = JointState(name=NAMES, position=GOALS[0], velocity=[0.0] * 7)
    if begun:
        after = 1e-9 * now.nanoseconds - seconds(begun[-1].header.stamp)
        times = [seconds(point.time_from_start) for point in begun[-1].points]
        for key, rows in (("position", "positions"), ("velocity", "velocities")):
            table = np.array([getattr(point, rows) for point in begun[-1].points])
            setattr(state, key, [float(np.interp(after, times, column)) for column in table.T])
    state.header.stamp = now.to_msg()
    joints.publish(state)


def publish_person():
    """Walk up and down, 1.2 to 2.2 m from the robot."""
    message, away = MarkerArray(), 1.7 + 0.5 * np.sin(0.5 * time.time())
    for k, (name, place) in enumerate(STANDING.items()):
        marker = Marker(ns="operator", id=k, text=name)
        marker.header.stamp, marker.header.frame_id = node.get_clock().now().to_msg(), "world"
        x, y, z = 1.75 * np.array(place) * [-1, -1, 1] + [away, 0.0, -0.75]
        marker.pose.position.x, marker.pose.position.y, marker.pose.position.z = float(x), float(y), float(z)
        message.markers.append(marker)
    people.publish(message)


def listen(message):
    """Print what the node says, and send the next goal where the robot has none."""
    text = message.status[0].message
    if text == said[-1]:
        return
    print(text, flush=True)
    said.append(text)
    if text.startswith(("done", "standing: no goal")):
        arrived = sum(line.startswith("done") for line in said)
        goal.publish(JointState(name=NAMES, position=GOALS[(arrived + 1) % 2]))


def obey(message):
    """Keep the newest commands."""
    told[:] = [*told[-20:], message]


node.create_subscription(JointTrajectory, "command", obey, 10)
node.create_subscription(DiagnosticArray, "/diagnostics", listen, 10)
node.create_timer(0.01, publish_joints)
node.create_timer(0.04, publish_person)
rclpy.spin(node)
