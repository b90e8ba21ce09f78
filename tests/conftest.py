"""Robots and an independent collision check for the tests; robots are frozen, so all tests share them."""

import gc
import signal
from functools import cache
from math import ceil
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from crank import CRANK
from hypothesis import settings
from ompl import util as ou

from bench._plain import PlainGeometry
from safe_ompl import Box, Capsule, Cylinder, Obstacle, Pose, RateLimits, Robot, Scenario, Scene, Sphere
from safe_ompl.common import warn_once
from safe_ompl.geometry import bounding_hull

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as shells start what runs in the background
    signal.signal(signal.SIGINT, signal.default_int_handler)

DATA = Path(__file__).parent / "data"

END_TO_END = tuple((Path(__file__).parent / "end_to_end.txt").read_text(encoding="utf-8").splitlines()[1:])


def pytest_collection_finish():
    """Spare the collector all that has been imported: many tests ask for a collection."""
    gc.freeze()


def pytest_sessionfinish():
    gc.unfreeze()


def pytest_collection_modifyitems(items):
    """Mark the tests that only the whole suite runs."""
    for item in items:
        place = item.path.relative_to(Path(__file__).parent).as_posix()
        if f"{place}::{item.name}".startswith(END_TO_END):
            item.add_marker(pytest.mark.end_to_end)


settings.register_profile("reproducible", derandomize=True, deadline=None, print_blob=True)
settings.load_profile("reproducible")


@cache
def _robot(name):
    if name == "twin_arm":  # prismatic, continuous and revolute joints, and a branch
        return Robot.from_urdf(DATA / "twin_arm.urdf")
    if name == "slider":  # its right arm alone: two of four joints slide
        return Robot.from_urdf(DATA / "twin_arm.urdf", tip="right_hand", name="slider")
    if name == "gripper":  # two links and two fingers: grip_mirror = 1.5·grip + 0.001
        return Robot.from_urdf(DATA / "gripper_arm.urdf", tip="finger_1")
    if name == "parallel":  # two links and a hand that turns back by twice the angle of the elbow, less 0.3
        return Robot.from_urdf(DATA / "parallel_arm.urdf")
    if name == "placed":
        return Robot.from_example("panda", base=Pose.from_rpy((0.5, -0.3, 0.8), (0.2, -0.1, 1.2)))
    if name == "loaded":
        return _robot("panda").with_attached("rod", Capsule(0.03, 0.3), pose=(0.0, 0.0, 0.2), danger=True)
    if name == "mobile":
        return Robot.from_example("ur5", mobile_base=((-1.0, 1.0), (-0.5, 2.0)))
    if name == "cell":  # two arms face to face, within reach of each other
        left = Robot.from_example("panda", base={"position": [0.0, 0.45, 0.0], "yaw": -1.5})
        right = Robot.from_example("ur5", base={"position": [0.0, -0.45, 0.0], "yaw": 1.5})
        return Robot.combined("cell", {"left": left, "right": right})
    return Robot.from_example(name)


@pytest.fixture(scope="session")
def data_folder():
    """Return the folder of test data."""
    return DATA


@pytest.fixture
def edited(data_folder, tmp_path):
    """Return a function that writes a changed copy of a URDF of the test data, and returns its path."""

    def edit(name, old, new):
        text = (data_folder / name).read_text()
        assert old in text
        path = tmp_path / name
        path.write_text(text.replace(old, new))
        return path

    return edit


@pytest.fixture(scope="session")
def robot_named():
    """Return a function from a name to a shared robot: one of `_robot`, or an example robot."""
    return _robot


@pytest.fixture(scope="session")
def panda():
    return _robot("panda")


@pytest.fixture(scope="session")
def shelf():
    """Return the scenario of a Panda between a shelf, a table and a person."""
    return Scenario.load("panda_shelf")


@pytest.fixture(scope="session")
def panda_limits(panda):
    return RateLimits.of(panda, acceleration=[15, 7.5, 10, 12.5, 15, 20, 20])


@pytest.fixture(scope="session")
def ur5():
    return _robot("ur5")


@pytest.fixture(scope="session")
def kinova():
    """Six joints, three of them continuous."""
    return _robot("kinova")


@pytest.fixture(scope="session")
def twin_arm():
    """Two arms on a lift: prismatic, continuous and revolute joints, and a branch."""
    return _robot("twin_arm")


@pytest.fixture(scope="session")
def crank(tmp_path_factory):
    """One joint about z that turns a ball of 0.05 m at a distance of 0.5 m."""
    urdf = tmp_path_factory.mktemp("crank") / "crank.urdf"
    urdf.write_text(CRANK)
    return Robot.from_urdf(urdf)


@pytest.fixture(autouse=True)
def quiet_ompl():
    """Keep OMPL's own messages out of the output."""
    handler, level = ou.getOutputHandler(), ou.getLogLevel()
    ou.noOutputHandler()
    yield
    ou.setLogLevel(level)  # the command line lowers it
    ou.useOutputHandler(handler)


@pytest.fixture(autouse=True)
def nothing_said():
    """Let each test hear what is said once a process."""
    warn_once.cache_clear()


class Ticks:
    """A clock that goes on by a millisecond whenever it is looked at; `at` says what happens at the k-th look."""

    def __init__(self):
        self.looks = 0
        self.at = {}

    def __call__(self):
        self.looks += 1
        self.at.pop(self.looks, lambda: None)()
        return 1e-3 * self.looks


@pytest.fixture
def ticks(monkeypatch):
    """Give setups a clock that counts, so that limits of time do not depend on the machine."""
    clock = Ticks()
    for module in ("planners.registry", "safe_setup", "run"):
        monkeypatch.setattr(f"safe_ompl.planning.{module}.perf_counter", clock)
    return clock


@pytest.fixture
def rng():
    return np.random.default_rng(0)


@pytest.fixture(scope="session")
def clutter():
    """Boxes, a ball, a cylinder and a capsule around the robot, turned in all directions; a table under it."""
    return Scene(
        (
            Obstacle("table", Box((1.6, 1.6, 0.04)), Pose((0.0, 0.0, -0.06))),
            Obstacle("plank", Box((0.05, 0.6, 0.3)), Pose((0.55, 0.1, 0.45), (0.6, 0.0, 0.0, 0.8))),
            Obstacle("ball", Sphere(0.12), Pose((-0.45, 0.35, 0.6))),
            Obstacle("post", Cylinder(0.05, 1.0), Pose((-0.3, -0.5, 0.5))),
            Obstacle("beam", Capsule(0.04, 0.7), Pose((0.2, 0.55, 0.75), (0.48, 0.36, 0.0, 0.8))),
        )
    )


class PlainCheck(PlainGeometry):
    """Robot against scene by coal's pairwise distances alone: no broad phase, no margins, nothing left out."""

    def __init__(self, robot, scene):
        super().__init__(robot, scene)
        self.pairs = [(link, obstacle or other) for link, obstacle, other in self.pairs]

    def nearest(self, q):
        """Return the smallest signed distance [m] at `q`."""
        return float(self.distances(q).min(initial=np.inf))

    def first_contact(self, start, end, step):
        """Return the first fraction of the edge at which something touches, looking every `step` [rad], or None."""
        delta = self.robot.difference(start, end)
        for t in np.linspace(0.0, 1.0, 1 + max(1, ceil(np.linalg.norm(delta) / step))):
            if self.touches(start + t * delta):
                return float(t)
        return None


@pytest.fixture(scope="session")
def plain_check():
    """Return the class of an independent collision check; see `PlainCheck`."""
    return PlainCheck


class BodyPoints:
    """Points of the bodies of a robot, among them the extreme ones, at any configuration."""

    def __init__(self, robot):
        self.robot = robot
        parts = list(robot.shared.collision_model.geometryObjects)
        self.hulls = [bounding_hull(part.geometry).moved(part.placement) for part in parts]
        self.joints = [part.parentJoint for part in parts]
        self._points = [_with_balls(hull) for hull in self.hulls]
        self._model = robot.shared.model
        self._data = self._model.createData()

    def at(self, q):
        """For each body its points (P, 3) [m] in the world at `q`."""
        pin.forwardKinematics(self._model, self._data, self.robot.pinocchio_configuration(q))
        poses = [self._data.oMi[joint] for joint in self.joints]
        return [points @ pose.rotation.T + pose.translation for points, pose in zip(self._points, poses, strict=True)]


def _with_balls(hull):
    """Points on the balls that a hull is grown by, or its corners where it is not."""
    if not hull.radius:
        return hull.points
    directions = np.random.default_rng(0).normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return (hull.points[:, None] + hull.radius * directions).reshape(-1, 3)


@pytest.fixture(scope="session")
def body_points():
    """Return the class that places a robot's bodies; see `BodyPoints`."""
    return cache(BodyPoints)
