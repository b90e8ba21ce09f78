"""Retreats from ends that are near obstacles, and what they do for simplified paths."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from ompl import util as ou

from safe_ompl import Box, CollisionChecker, Cylinder, DangerField, Obstacle, Pose, Robot, SafeSetup, Scene
from safe_ompl.paths.cost import ObstacleCost
from safe_ompl.paths.edges import RETREAT_STEP, retreat, within_limits

PLANAR2 = Path(__file__).parents[3] / "scenarios" / "robots" / "planar2.urdf"
GRASP = np.array([0.6, 0.5, 0.0, -1.8, 0.0, 2.3, 0.8])
START = GRASP * [-1, 1, 1, 1, 1, 1, 1] - [0, 0.3, 0, 0, 0, 0, 0]


@pytest.fixture(scope="module")
def setup(panda):
    """Return a problem with a can between the fingers, its axis across the hand."""
    tip = panda.tip_pose(GRASP)
    across = tip.rotation @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    pose = Pose(tuple(tip.translation + 0.01 * tip.rotation[:, 2]), tuple(pin.Quaternion(across).normalized().coeffs()))
    handler = ou.getOutputHandler()
    ou.noOutputHandler()
    setup = SafeSetup(panda, Scene((Obstacle("can", Cylinder(0.025, 0.12), pose, weight=1.0),), spacing=0.04))
    setup.setConfigurations(START, GRASP)
    yield setup
    ou.useOutputHandler(handler)


def clearances(setup, way):
    return np.array([setup.checker.clearance(q).distance for q in way])


@pytest.fixture
def nearness(setup):
    return ObstacleCost(setup.checker, 0.05).afresh(1.3 * setup.checker.clearance(GRASP).distance)


def test_the_way_out_of_a_grasp(setup, panda, nearness):
    way = retreat(GRASP, nearness, setup.field, within_limits(panda), lambda: False)
    np.testing.assert_array_equal(way[0], GRASP)
    assert len(way) > 1
    assert np.linalg.norm(np.diff(way, axis=0), axis=1).max() <= RETREAT_STEP * (1 + 1e-6)
    clearance, danger = clearances(setup, way), setup.field.values(way)
    assert (np.diff(clearance) > 0).all()
    assert clearance[-1] > 1.3 * clearance[0]
    assert (np.diff(danger) < 0).all()


def test_far_from_obstacles_there_is_nothing_to_leave(setup, panda, nearness):
    np.testing.assert_array_equal(retreat(START, nearness, setup.field, within_limits(panda), lambda: False), [START])


def test_where_no_way_leads_out_there_is_none(setup, nearness):
    assert len(retreat(GRASP, nearness, setup.field, lambda Q: np.broadcast_to(GRASP, np.shape(Q)), lambda: False)) == 1


def test_on_a_danger_point_only_obstacles_count(panda, nearness):
    hand = panda.keypoints(GRASP)[panda.segments[-1]].mean(axis=0)
    field = DangerField(panda, hand[None])
    assert field.value(GRASP) > 1e6
    assert len(retreat(GRASP, nearness, field, within_limits(panda), lambda: False)) > 1


@pytest.mark.parametrize("seed", range(3))
def test_simplified_paths_are_as_clear_and_as_safe_as_their_ends(setup, seed):
    raw = setup.plan("RRTConnect", time=10.0, seed=seed).path
    before = setup.report(raw)
    after = setup.report(setup.simplifier.simplify(raw, lambda: False, proven=True))
    end = setup.checker.clearance(GRASP).distance
    assert before.clearance.min < 0.98 * end, "or the test shows nothing"
    assert after.clearance.min > 0.99 * end
    assert after.danger.max <= 1.001 * setup.field.value(GRASP)


def test_where_no_joint_changes_what_is_near_there_is_no_way_out():
    """A stretched planar arm below a plate, which stays as near as it is, points at what is in danger."""
    robot = Robot.from_urdf(PLANAR2, tip="tip")
    plate = Obstacle("plate", Box((2.0, 2.0, 0.02)), Pose((0.0, 0.0, 0.06)))
    checker = CollisionChecker(robot, Scene((plate,)))
    nearness = ObstacleCost(checker, 0.1)
    stretched, field = np.zeros(2), DangerField(robot, [[1.3, 0.0, 0.0]])
    assert nearness.near(stretched[None])
    assert not field.gradient(stretched).any()
    np.testing.assert_array_equal(retreat(stretched, nearness, field, within_limits(robot), lambda: False), [stretched])


def test_a_path_back_to_where_it_began_does_not_depart(setup):
    raw = setup.plan("RRTConnect", time=10.0, seed=0).path
    round_trip = np.concatenate([raw[::-1], raw[1:]])
    found = setup.simplifier.simplify(round_trip, lambda: False)
    np.testing.assert_array_equal(np.unique(found, axis=0), [GRASP])
