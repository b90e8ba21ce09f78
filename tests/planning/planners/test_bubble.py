"""BubblePlanner: its bubbles are free, it solves what can be solved, and it says what it cannot do."""

import numpy as np
import pytest
from plane import PlaneProblem

from safe_ompl import Box, BubblePlanner, InputError, Obstacle, Pose, SafeSetup, Scene, Sphere
from safe_ompl.collision import Bubble, CollisionChecker
from safe_ompl.planning.planners.growth import Growth
from safe_ompl.planning.planners.problem import DangerWeight, Margin, PlanningProblem


@pytest.mark.parametrize("printed", [False, True])
@pytest.mark.parametrize("name", ["ur5", "kinova", "slider"])
def test_no_configuration_in_a_bubble_collides(robot_named, clutter, printed, name):
    robot = robot_named(name)
    checker, rng, seen = CollisionChecker(robot, clutter), np.random.default_rng(3), 0
    while seen < 12:
        q = rng.uniform(robot.lower, robot.upper)
        bubble = Bubble.around(q, checker, printed=printed)
        if bubble is None:
            continue
        seen += 1
        steps = rng.uniform(-1, 1, (60, robot.n))
        steps /= np.abs(steps * bubble.weights).sum(axis=1, keepdims=True)
        for x in q + 0.99 * steps:
            if robot.within_limits(x).all():
                assert not checker.in_collision(x)


def test_it_goes_round_a_post_and_danger_is_lower_where_it_counts(ur5):
    post = Obstacle("post", Box((0.1, 0.1, 1.2)), Pose((0.45, 0.0, 0.6)), weight=1.0)
    setup = SafeSetup(ur5, Scene((post, Obstacle("ball", Sphere(0.1), Pose((-0.4, 0.4, 0.5)), weight=1.0))))
    setup.setConfigurations([-0.8, -1.2, 1.2, 0, 0, 0], [0.8, -1.2, 1.2, 0, 0, 0])
    results = safe, classic = [
        setup.plan(BubblePlanner(setup.getSpaceInformation(), alpha=alpha), time=20.0) for alpha in (1.0, 0.0)
    ]
    for result in results:
        assert result.report.certified
        assert result.counts.distance_queries >= result.counts.nodes
    assert safe.report.danger.avoidable < 0.5 * classic.report.danger.avoidable
    assert safe.report.danger.max < classic.report.danger.max
    assert classic.counts.field_configurations == 0


def test_it_is_deterministic_whatever_the_seed(planar3):
    first, second = (planar3.plan("BubblePlanner", time=120.0, seed=seed) for seed in (1, 2))
    np.testing.assert_array_equal(first.path, second.path)


def test_the_elastic_band_is_shorter_than_the_chain_of_bubbles_and_proven(planar3):
    chain = planar3.plan("PaperBubble", time=20.0, parameters={"beta": 20.0})
    problem = PlanningProblem(planar3.getSpaceInformation())
    danger = DangerWeight(problem)
    settled = Growth(problem, danger, Margin(problem, danger)).settled(chain.path, 0.5, lambda: False, 0.0, 1)
    report = planar3.report(settled)
    assert report.certified
    assert len(settled) < len(chain.path)
    assert report.length < chain.report.length
    np.testing.assert_array_equal(settled[[0, -1]], chain.path[[0, -1]])


def test_it_needs_distances():
    with pytest.raises(InputError, match="CollisionFreeValidity"):
        PlaneProblem(BubblePlanner)
