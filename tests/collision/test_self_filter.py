"""The robot's own points go from a cloud, and no others."""

import numpy as np
import pytest
from limbs import Limbs

from safe_ompl import Box, CollisionChecker, InputError, Obstacle, PointCloud, Pose, Scene
from safe_ompl.collision import robot_points, without_robot

Q = np.array([0.3, -0.5, 0.2, -2.0, 0.1, 1.8, 0.7])
MARGIN = 0.02


@pytest.fixture(scope="module")
def skin(panda, body_points):
    """Return corners of the robot's hulls in the world."""
    return np.concatenate([corners[::5] for corners in body_points(panda).at(Q)])


@pytest.fixture(scope="module")
def scan(skin):
    """Points on the robot, then points anywhere."""
    own = skin + np.random.default_rng(0).normal(0, 0.002, skin.shape)
    anywhere = np.random.default_rng(1).uniform([-0.6, -0.6, 0], [0.9, 0.6, 1.2], (400, 3))
    return np.concatenate([own, anywhere]), len(own)


def test_which_points_are_the_robot_s_is_what_distances_say(panda, scan):
    points, own = scan
    mine = robot_points(points, panda, Q, MARGIN)
    assert mine[:own].all()
    for k in range(own, len(points), 7):
        ball = Obstacle("p", PointCloud(1e-4, points=points[[k]]))
        distance = Limbs(panda, ball, still=True).at(Q).min() + 1e-4
        if abs(distance - MARGIN) > 1e-4:
            assert mine[k] == (distance < MARGIN)


def test_a_robot_that_saw_itself_is_free(panda, scan, caplog):
    points, own = scan
    pose = Pose.from_rpy((0.4, -0.2, 0.1), (0.1, 0.2, 0.3))
    cloud = PointCloud(0.01, points=(points - pose.se3.translation) @ pose.se3.rotation)
    table = Obstacle("table", Box((1, 1, 0.02)), pose=Pose((0, 0, -0.5)))
    scene = Scene((table, Obstacle("scan", cloud, pose, 0.5)), 0.2)
    assert CollisionChecker(panda, scene).in_collision(Q)
    with caplog.at_level("INFO"):
        cleared = without_robot(scene, panda, Q, 0.05)
    assert not CollisionChecker(panda, cleared).in_collision(Q)
    kept = len(cleared["scan"].shape.centres)
    assert 100 < kept <= len(points) - own
    assert f"scan: {len(points) - kept} of {len(points)} points belong to the robot" in caplog.text
    assert (cleared["scan"].weight, cleared["scan"].pose, cleared.spacing) == (0.5, pose, 0.2)
    assert cleared["table"] is table


def test_a_cloud_that_is_all_robot_goes_and_one_without_robot_stays_itself(panda, skin):
    robot, other = (Obstacle(name, PointCloud(0.01, points=p)) for name, p in (("a", skin), ("b", [[5, 5, 5]])))
    cleared = without_robot(Scene((robot, other)), panda, Q, MARGIN)
    assert cleared.names == ("b",)
    assert cleared["b"] is other


def test_what_cannot_be_is_refused(panda):
    with pytest.raises(InputError, match="margin: must be a finite number >= 0, got -1"):
        without_robot(Scene((Obstacle("s", PointCloud(0.01, points=[[5, 5, 5]])),)), panda, Q, -1)
    with pytest.raises(InputError, match=r"q: must have shape \(7\), got \(2,\)"):
        robot_points([[0, 0, 0]], panda, [0, 1], 0.0)
