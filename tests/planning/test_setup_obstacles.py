"""Obstacles that are added, removed and moved in a setup: it plans as one made anew for the scene as it is."""

import logging
from dataclasses import replace

import numpy as np
import pytest

from safe_ompl import Box, Obstacle, Pose, Scenario, Sphere
from safe_ompl.common import CollisionError, InputError, StaleSceneError, UnknownNameError
from safe_ompl.planning import SafeSetup, setup_scenario

PLANNERS = ["SafeRRTConnect", "SafePRM", "BubblePlanner", "RRTConnect"]
BALL = Obstacle("ball", Sphere(0.1), Pose((0.3, 0.5, 0.4)), weight=0.5)


@pytest.fixture(scope="module")
def scenario():
    return Scenario.load("ur5_handover")


@pytest.fixture
def setup(scenario):
    return setup_scenario(scenario)


def anew(setup, scenario):
    """Return a setup made for the scene that another one is in."""
    return setup_scenario(replace(scenario, scene=setup.scene), setup.robot)


def change(setup):
    setup.addObstacle(BALL)
    setup.moveObstacle("ball", Pose((0.35, 0.45, 0.5)))
    setup.moveObstacles({"ball": Pose((0.3, 0.5, 0.55))})
    setup.removeObstacle("crate")


@pytest.mark.parametrize("planner", PLANNERS)
def test_it_plans_as_one_made_anew(setup, scenario, planner):
    setup.plan(planner, seed=3)
    change(setup)
    mine, other = (setup.plan(planner, seed=3, time=20.0), anew(setup, scenario).plan(planner, seed=3, time=20.0))
    np.testing.assert_array_equal(mine.path, other.path)
    assert mine.scene.names == setup.scene.names
    assert mine.report.danger.max == other.report.danger.max


def test_what_is_movable_or_has_moved_once_moves_in_place(setup, scenario):
    setup.addObstacle(BALL)
    checkers = []
    for x in (0.3, 0.4, 0.5):
        setup.moveObstacle("ball", Pose((x, 0.5, 0.6)))
        checkers.append(setup.checker)
    assert checkers[0] is checkers[1] is checkers[2]
    assert checkers[0].revision == 2
    assert setup.scene["ball"].pose.position[0] == 0.5
    movable = SafeSetup(setup.robot, scenario.scene.with_obstacles(BALL), movable=["ball"])
    checker = movable.checker
    movable.moveObstacle("ball", Pose((0.3, 0.6, 0.6)))
    assert movable.checker is checker


def test_planning_says_what_stands_in_the_start(setup, scenario):
    place = setup.robot.tip_pose(scenario.start_configuration(setup.robot)).translation
    setup.addObstacle(Obstacle("block", Box((0.1, 0.1, 0.1)), Pose(tuple(place))))
    with pytest.raises(CollisionError, match=r"start is in collision.*'block'"):
        setup.plan()
    with pytest.raises(CollisionError, match=r"start is in collision.*'block'"):
        setup.solve(1.0)
    setup.removeObstacle("block")
    assert setup.plan(seed=1)


def test_goals_count_again_when_they_are_free_again(setup, scenario, caplog):
    start = scenario.start_configuration(setup.robot)
    goal = scenario.goal_configurations(setup.robot)[0]
    setup.setConfigurations(start, [goal, start])
    at_goal = Obstacle("block", Box((0.1, 0.1, 0.1)), Pose(tuple(setup.robot.tip_pose(goal).translation)))
    setup.addObstacle(at_goal)
    with caplog.at_level(logging.WARNING):
        np.testing.assert_allclose(setup.plan(seed=1).path[-1], start)
    assert "1 of 2 goals do not count" in caplog.text
    setup.removeObstacle("block")
    setup.setup()
    assert setup.getGoal().getStateCount() == 2


def test_a_distance_from_what_is_dangerous_is_kept_from_whoever_comes(setup):
    setup.setMinClearance(0.03)
    setup.addObstacle(BALL)
    kept = [setup.getConstraints().separation.min_clearance]
    for change in (setup.removeObstacle, "colleague"), (setup.removeObstacle, "ball"), (setup.addObstacle, BALL):
        change[0](change[1])
        kept.append(setup.getConstraints().separation.min_clearance)
    assert [kept[0].obstacles, kept[1].obstacles, kept[2]] == [("colleague", "ball"), ("ball",), None]
    assert (kept[3].obstacles, kept[3].distance) == (("ball",), 0.03)


MISTAKES = [
    ("removeObstacle", ("table",), UnknownNameError, "table"),  # the limit is about it
    ("moveObstacle", ("tble", Pose()), UnknownNameError, "tble"),
    ("addObstacle", (Obstacle("table", Sphere(0.1)),), InputError, "already"),
    ("setScene", (None,), InputError, "must be a Scene"),
]


@pytest.mark.parametrize(("call", "arguments", "error", "message"), MISTAKES)
def test_mistakes_change_nothing(setup, call, arguments, error, message):
    setup.setMinClearance(0.03, ["table"])
    scene, checker = setup.scene, setup.checker
    with pytest.raises(error, match=message):
        getattr(setup, call)(*arguments)
    assert setup.scene is scene
    assert setup.checker is checker


def test_a_result_of_another_scene_is_not_timed(setup):
    setup.addObstacle(BALL)
    setup.moveObstacle("ball", Pose((0.3, 0.6, 0.6)))
    result = setup.plan(seed=1)
    setup.moveObstacle("ball", Pose((0.3, 0.6, 0.7)))
    with pytest.raises(StaleSceneError, match="plan again"):
        result.timed()
