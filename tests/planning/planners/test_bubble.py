"""BubblePlanner: its bubbles are free, it solves what can be solved, and it says what it cannot do."""

import numpy as np
import pytest
from plane import PlaneProblem

from safe_ompl import Box, BubblePlanner, InputError, Obstacle, Pose, Sphere, UnknownNameError
from safe_ompl.collision import BUBBLE_SHAPES, CollisionChecker, bubbles
from safe_ompl.planning import SafeSetup, setup_scenario
from safe_ompl.planning.planners.parts.extend import ElasticBand, TangentialDescent
from safe_ompl.planning.planners.parts.problem import DangerWeight, PlanningProblem
from safe_ompl.planning.planners.parts.volume_tree import Rows
from safe_ompl.scene import Scenario, Scene, find_scenario


@pytest.fixture(scope="module")
def planar():
    return setup_scenario(Scenario.load(find_scenario("planar3")))


@pytest.fixture(scope="module")
def arm(ur5):
    """Return the problem of a UR5 that must go round a post."""
    scene = Scene(
        (
            Obstacle("post", Box((0.1, 0.1, 1.2)), Pose((0.45, 0.0, 0.6)), weight=1.0),
            Obstacle("ball", Sphere(0.1), Pose((-0.4, 0.4, 0.5)), weight=1.0),
        )
    )
    setup = SafeSetup(ur5, scene)
    setup.setConfigurations([-0.8, -1.2, 1.2, 0, 0, 0], [0.8, -1.2, 1.2, 0, 0, 0])
    return setup


def planner_on(setup, **options):
    return BubblePlanner(setup.getSpaceInformation(), **options)


@pytest.mark.parametrize("shape", BUBBLE_SHAPES)
@pytest.mark.parametrize("name", ["ur5", "kinova", "slider"])
def test_no_configuration_in_a_bubble_collides(robot_named, clutter, shape, name):
    robot = robot_named(name)
    checker, rng, seen = CollisionChecker(robot, clutter), np.random.default_rng(3), 0
    while seen < 12:
        q = rng.uniform(robot.lower, robot.upper)
        distances = checker.pair_distances(q) - 1e-5
        if distances.min() <= 0:
            continue
        seen += 1
        reaches = bubbles.extents(BUBBLE_SHAPES[shape].weights(checker.pair_radii_at(q), distances))
        steps = rng.uniform(-1, 1, (60, robot.n))
        if shape != "cube":
            steps /= np.abs(steps).sum(axis=1, keepdims=True)
        for x in q + 0.99 * steps * np.minimum(reaches, 6.0):
            if robot.within_limits(x).all():
                assert not checker.in_collision(x)


@pytest.mark.parametrize("shape", ["link", "cube", "paper"])  # six joints are many for the cube within (9)
@pytest.mark.parametrize("options", [{}, {"alpha": 0.0}], ids=["safe", "classic"])
def test_every_shape_goes_round_the_post(arm, shape, options):
    result = arm.plan(planner_on(arm, shape=shape, **options), time=20.0)
    assert result
    assert result.report.certified
    assert result.counts.distance_queries >= result.counts.nodes


def test_safety_lowers_the_danger(arm):
    safe, classic = (arm.plan(planner_on(arm, alpha=alpha), time=20.0) for alpha in (1.0, 0.0))
    assert safe.report.danger.avoidable < 0.5 * classic.report.danger.avoidable
    assert safe.report.danger.max < classic.report.danger.max


def test_no_danger_is_evaluated_without_alpha(planar):
    result = planar.plan(planner_on(planar, alpha=0.0), time=20.0)
    assert result
    assert result.counts.field_configurations == 0


def test_it_is_deterministic_whatever_the_seed(planar):
    first, second = (planar.plan("BubblePlanner", time=20.0, seed=seed) for seed in (1, 2))
    np.testing.assert_array_equal(first.path, second.path)


def test_the_elastic_band_is_shorter_than_the_chain_of_bubbles_and_proven(planar):
    chain = planar.plan("PaperBubble", time=20.0, parameters={"beta": 20.0})
    problem = PlanningProblem(planar.getSpaceInformation())
    danger = DangerWeight(problem)
    band = ElasticBand(problem, danger, TangentialDescent(problem.bridge, danger))
    settled = band.settled(chain.path, 0.5, lambda: False)
    report = planar.report(settled)
    assert report.certified
    assert len(settled) < len(chain.path)
    assert report.length < chain.report.length
    np.testing.assert_array_equal(settled[[0, -1]], chain.path[[0, -1]])


def test_open_lists_stay_bounded(arm, monkeypatch):
    sizes, length = [], Rows.__len__
    monkeypatch.setattr(Rows, "__len__", lambda self: sizes.append(length(self)) or sizes[-1])
    assert arm.plan(planner_on(arm, max_open=40), time=20.0)
    bounded = max(sizes)
    sizes.clear()
    assert arm.plan(planner_on(arm, max_open=0), time=20.0)
    assert bounded < 40 + 3 * arm.robot.n < max(sizes)


def test_goals_beyond_the_first_are_roots_too(planar):
    scenario = Scenario.load(find_scenario("planar3"))
    setup = setup_scenario(scenario)
    start, goal = scenario.start_configuration(setup.robot), scenario.goal_configurations(setup.robot)[0]
    setup.setConfigurations(start, [goal, start + 0.01])
    result = setup.plan("BubblePlanner", time=20.0)
    np.testing.assert_array_equal(result.path[-1], start + 0.01)


def test_it_needs_distances():
    with pytest.raises(InputError, match="CollisionFreeValidity"):
        PlaneProblem(BubblePlanner)


@pytest.mark.parametrize(
    ("option", "value"),
    [("beta", -1.0), ("nearest_fraction", 2.0), ("max_open", -1), ("max_open", 1.5), ("alpha", float("nan"))],
)
def test_bad_parameters_are_refused(planar, option, value):
    with pytest.raises(InputError, match=option):
        planner_on(planar, **{option: value})


def test_unknown_shapes_are_refused_with_the_known_ones(planar):
    with pytest.raises(UnknownNameError, match="link"):
        planner_on(planar, shape="ball")
