"""The node of ROS 2 with real middleware on this machine: robot and sensors here, the node in a process of its own.

Without ROS the tests are skipped, except where SAFE_OMPL_ROS=1 says that it must be there.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 50))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
if os.environ.get("SAFE_OMPL_ROS") != "1":
    pytest.importorskip("rclpy")
    pytest.importorskip("rosbags")
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import Bool
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from safe_ompl.apps import main
from safe_ompl.geometry import STANDING
from safe_ompl.live.ros import messages, read_log

pytestmark = pytest.mark.end_to_end
NAMES = [f"panda_joint{k}" for k in range(1, 8)]
START = [1.45, 0.1, 0.0, -1.7, 0.0, 3.37, 0.785]
GOAL = [-1.25, 0.4, 0.0, -2.1, 0.0, 2.5, 0.785]
PATIENCE = 60.0  # [s] a busy machine is slow
FIRST = 600.0  # [s] and all kernels may have to be compiled
SIM = ["--clock-error", "0.05", "--tick", "0.1", "--latency", "0.1", "--ros-args", "-p", "use_sim_time:=true"]


class World:
    """The clock, a robot that does what it is told, and the tracker of a person."""

    def __init__(self, names=NAMES, start=START):
        self.node = node = rclpy.create_node("world")
        self.names, self.q, self.qd, self.told, self.said = names, np.array(start), np.zeros(len(start)), [], []
        self.person = np.array([2.5, 0.0, -0.75])
        self.commands: list[JointTrajectory] = []
        self.steps: list[tuple[str, str]] = []
        node.create_subscription(JointTrajectory, "command", self.command, 10)
        node.create_subscription(DiagnosticArray, "/diagnostics", self.diagnostics, 10)
        self.clock = node.create_publisher(Clock, "/clock", 1)
        self.joints = node.create_publisher(JointState, "joint_states", 1)
        self.works = node.create_publisher(Bool, "run", 1)
        self.goal = node.create_publisher(JointState, "goal", 1)
        self.people = node.create_publisher(MarkerArray, "people", 1)
        self.cloud = node.create_publisher(PointCloud2, "cloud", 1)
        node.create_timer(0.01, self.step)
        node.create_timer(0.04, self.see)
        self.thread = threading.Thread(target=rclpy.spin, args=(node,), daemon=True)
        self.thread.start()

    @property
    def now(self):
        """Simulated time [s]."""
        return time.time() % 1e6 + 1000.0

    def stamp(self, late=0.0):
        seconds = self.now - late
        return messages.nanoseconds(seconds) // 10**9, messages.nanoseconds(seconds) % 10**9

    def step(self):
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = self.stamp()
        self.clock.publish(clock)
        self.move(self.now)
        message = JointState(name=self.names[::-1], position=self.q[::-1].tolist(), velocity=self.qd[::-1].tolist())
        message.header.stamp.sec, message.header.stamp.nanosec = self.stamp()
        self.joints.publish(message)

    def see(self):
        """Publish all key points of the operator."""
        places = {name: self.person + 1.75 * place * [-1, -1, 1] for name, place in STANDING.items()}
        self.people.publish(MarkerArray(markers=[self.marker(name, place) for name, place in places.items()]))

    def marker(self, text, place, late=0.0, frame="world"):
        """Return a marker of a key point."""
        found = Marker(ns="operator", text=text)
        found.header.stamp.sec, found.header.stamp.nanosec = self.stamp(late)
        found.header.frame_id = frame
        at = found.pose.position
        at.x, at.y, at.z = map(float, place)
        return found

    def command(self, message):
        self.commands.append(message)
        begin = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        after = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in message.points]
        rows = [np.array([getattr(p, key) for p in message.points]) for key in ("positions", "velocities")]
        self.told = [*self.told[-20:], (begin + np.array(after), *rows)]

    def move(self, now):
        """Be where the newest command that has begun has the robot."""
        begun = [command for command in self.told if command[0][0] <= now]
        if begun:
            times, q, qd = begun[-1]
            self.q = np.array([np.interp(now, times, column) for column in q.T])
            self.qd = np.array([np.interp(now, times, column) for column in qd.T])

    def diagnostics(self, message):
        self.said = [*self.said[-500:], message.status[0].message]
        values = {pair.key: pair.value for pair in message.status[0].values}
        self.steps += [(values["step"], values["holds"])] if "step" in values else []

    def run(self, wanted):
        """Say whether the program is to be driven."""
        self.wait(self.works.get_subscription_count)
        self.works.publish(Bool(data=wanted))

    def go(self, goal):
        """Send a goal."""
        self.said = []
        self.wait(lambda: self.goal.get_subscription_count())
        self.goal.publish(JointState(name=NAMES, position=list(goal)))

    def wait(self, condition, what="", seconds=PATIENCE):
        """Wait until something holds."""
        end = time.monotonic() + seconds
        while not condition():
            assert time.monotonic() < end, f"{what}; said last: {self.said[-3:]}"
            time.sleep(0.02)

    def hears(self, text, seconds=PATIENCE):
        """Wait until the diagnostics say something."""
        self.said = []
        self.wait(lambda: any(text in said for said in self.said), text, seconds)

    def arrives(self, goal):
        """Wait until the robot has arrived."""
        self.wait(lambda: "done: at the goal" in self.said[-1:], f"not at {goal}")
        np.testing.assert_allclose(self.q, goal, atol=1e-6)


def start_node(*words, log=subprocess.DEVNULL, command="ros"):
    """Start `safe-ompl ros`, or another command, in a process of its own."""
    return subprocess.Popen([sys.executable, "-m", "safe_ompl", command, *words], stderr=log, text=True)


def ended(node):
    """Press Ctrl-C, and return the exit status of a node."""
    node.send_signal(signal.SIGINT)
    try:
        return node.wait(PATIENCE)
    finally:
        node.kill()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("ros")


@contextmanager
def driven(folder, *words, command="ros", make=World, **start):
    """Yield a world with a node that drives the robot."""
    rclpy.init()
    world = make(**start)
    with (folder / "node.log").open("w") as log:
        node = start_node(*words, *SIM, log=log, command=command)
        try:
            world.wait(lambda: "ready" in (folder / "node.log").read_text(), "ready", FIRST)
            yield world
        finally:
            code = ended(node)
            rclpy.try_shutdown()
            world.thread.join()
    assert code == 0, (folder / "node.log").read_text()


def test_a_program_is_run_and_goes_on_where_it_stopped(tmp_path):  # before the world of all others begins
    start = {"names": [*NAMES, "panda_finger_joint1"], "start": [0.0, -0.6, 0.0, -2.2, 0.0, 1.7, 0.785, 0.04]}
    with driven(tmp_path, "panda_pick_place", "--people", "none", **start) as world:
        world.hears("standing: the program was not started yet")
        world.run(True)
        world.wait(lambda: ("6", "cube") in world.steps and np.abs(world.qd).max() > 0.1, "no cube is carried")
        world.run(False)
        world.hears("standing: stopped")
        world.wait(lambda: not world.qd.any(), "it does not stop")
        assert abs(world.q[-1] - 0.0245) < 1e-6
        world.run(True)
        world.arrives([*start["start"][:6], 0.785, 0.04])
        steps = [int(step) for step, _ in world.steps]
        assert steps == sorted(steps)
        assert world.steps[-1] == ("11", "")


@pytest.fixture(scope="module")
def world(folder):
    """Robot and sensors, and a node that drives the robot and writes `drive.mcap`."""
    with driven(folder, "panda_shelf", "--mcap", str(folder / "drive.mcap")) as world:
        yield world
    header, ticks = read_log(folder / "drive.mcap")
    assert header["joint_names"] == NAMES
    assert {"moving", "done"} <= {tick["state"] for tick in ticks}
    assert main(["tube", str(folder / "drive.mcap")]) == 0


def test_it_drives_to_a_goal(world):
    world.go(GOAL)
    world.arrives(GOAL)
    assert len(world.commands) > 10
    for message in world.commands:
        assert message.joint_names == NAMES
        assert np.abs(message.points[-1].velocities).max() < 1e-9  # it ends in a stop
        assert len(message.points) == 1 or len(message.points[0].accelerations) == 7
    stamps = [message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec for message in world.commands]
    assert (np.diff(stamps) >= 0).all()


def test_bad_messages_are_reported_and_the_robot_arrives(world, folder):
    def log():
        return (folder / "node.log").read_text()

    def reported(line, publish):
        """Publish until the node has taken one, and said so: of sensors it takes the newest message alone."""
        before = log().count(line)
        world.wait(lambda: publish() or log().count(line) > before, line)

    def people(**change):
        return lambda: world.people.publish(MarkerArray(markers=[world.marker("head", (3.0, 0.0, 0.0), **change)]))

    def joints():
        message = JointState(name=NAMES, position=[float("nan")] * 7)
        message.header.stamp.sec, message.header.stamp.nanosec = world.stamp()
        world.joints.publish(message)

    world.go(START)
    world.hears("moving")
    over = JointState(name=NAMES, position=[99.0] * 7)
    for line, publish in {
        "people: stamp: 'operator' was measured 5.": people(late=-5.0),
        "people: frame_id: unknown frame 'camera'; known: ": people(frame="camera"),
        "joint_states: position: must be finite": joints,
        "goal: position: is out of the limits of 'panda_joint1': 99": lambda: world.goal.publish(over),
        "cloud: fields: the message has no field x": lambda: world.cloud.publish(PointCloud2(height=1, width=1)),
    }.items():
        reported(line, publish)
    rest = b"\x00\x01\x00\x00" + bytes([200, 255, 255, 127]) * 3
    for kind, publisher in {"people: ": world.people, "joint_states: ": world.joints, "goal: ": world.goal}.items():
        reported(kind, lambda publisher=publisher: publisher.publish(rest))
    world.arrives(START)
    assert "Traceback" not in log()


def test_two_nodes_keep_the_robot_still(world):
    other = start_node("panda_shelf", *SIM)
    try:
        world.hears("2 nodes publish /command")
        time.sleep(3.0)  # each of them looks once in a second
        here = world.q
        world.go(GOAL)
        time.sleep(2.0)
        np.testing.assert_array_equal(world.q, here)
    finally:
        assert ended(other) == 0
    world.arrives(GOAL)


def test_behind_a_shield_the_robot_follows_what_is_proposed(world, folder):
    names = [f"{name}:=/{name}" for name in ("joint_states", "people")]
    words = [word for name in ("__ns:=/shielded", *names) for word in ("-r", name)]
    proposals = world.node.create_publisher(JointTrajectory, "/shielded/proposal", 1)
    commands = world.node.create_subscription(JointTrajectory, "/shielded/command", world.command, 10)
    with (folder / "shield.log").open("w") as log:
        node = start_node("panda_shelf", "--shield", *SIM, *words, log=log)
        try:
            world.wait(lambda: "ready" in (folder / "shield.log").read_text(), "ready", FIRST)
            world.hears("standing: nothing was proposed")
            turning = JointTrajectory(joint_names=NAMES, points=[JointTrajectoryPoint(velocities=[-0.3] + 6 * [0.0])])
            before, goal = world.q, world.q + np.array([-0.3, 0.1, 0.0, 0.1, 0.0, 0.0, 0.0])
            world.wait(lambda: proposals.publish(turning) or world.q[0] < before[0] - 0.05, "no motion")
            world.wait(lambda: not world.qd.any(), "no stop after the last velocity")
            points = [JointTrajectoryPoint(positions=q.tolist()) for q in (world.q, goal)]
            points[1].time_from_start.sec = 2
            proposals.publish(JointTrajectory(joint_names=NAMES, points=points))
            world.wait(lambda: np.abs(world.q - goal).max() < 1e-6, "not at the end of what was proposed")
            proposals.publish(JointTrajectory(joint_names=NAMES[:3], points=points))
            line = "proposal: position: must be as many as the 3 names, got 7"
            world.wait(lambda: line in (folder / "shield.log").read_text(), line)
        finally:
            code = ended(node)
            world.node.destroy_subscription(commands)
    assert code == 0, (folder / "shield.log").read_text()


# ---------------------------------------------------------------------------------------------------- encodings


def test_the_node_says_what_is_missing(capsys, monkeypatch):
    assert main(["ros", "panda_shelf", "--people", "a b"]) == 2
    assert "'a b' must be letters, digits and _" in capsys.readouterr().err
    monkeypatch.setitem(sys.modules, "rclpy", None)
    monkeypatch.setattr("safe_ompl.apps.cli.output.need_extra", lambda extra: None)
    assert main(["ros", "panda_shelf"]) == 2
    assert "needs ROS 2 (" in capsys.readouterr().err


def test_the_example_beside_a_person_who_walks_on_the_clock_of_the_machine(folder):
    own = {**os.environ, "ROS_DOMAIN_ID": str(51 + os.getpid() % 50)}
    words = ["panda_shelf", "--tick", "0.1", "--latency", "0.1"]
    example = Path(__file__).parents[3] / "examples" / "ros" / "world.py"
    with (folder / "example.log").open("w") as log:
        node = subprocess.Popen([sys.executable, "-m", "safe_ompl", "ros", *words], env=own, stderr=log)
        world = subprocess.Popen([sys.executable, str(example)], env=own, stdout=subprocess.PIPE, text=True)
        try:
            stop = threading.Timer(3 * PATIENCE, world.kill)
            stop.start()
            said = []
            while (line := world.stdout.readline()) and not any("done" in text for text in said):
                said.append(line.strip())
            stop.cancel()
        finally:
            world.kill()
            world.wait()
            assert ended(node) == 0
    assert "done: at the goal" in said, (said, (folder / "example.log").read_text())
    assert "moving" in said
