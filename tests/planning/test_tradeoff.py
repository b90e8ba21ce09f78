"""The front between the shortest and the least dangerous path: a front, proven, the same for the same seed."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from safe_ompl import CollisionError, InputError, Obstacle, Person, Pose, Robot, SafeSetup, Scene, Sphere, tradeoff
from safe_ompl.drawing import plots
from safe_ompl.scene import Scenario


def assert_front(setup, front):
    """Assert that no path of a front is dominated, all are proven, and lead where they shall."""
    assert front
    start, goal = front.results[0].path[[0, -1]]
    lengths = [result.report.length for result in front.results]
    means = [result.report.danger.mean for result in front.results]
    dangers = [setup.simplifier.weighing(1.0).cost.of(r.path) - r.report.length for r in front.results]
    assert all(a < b for a, b in pairwise(lengths))
    assert all(a > b for falling in (means, dangers) for a, b in pairwise(falling))
    assert list(front.weights) == sorted(set(front.weights))
    for result in front.results:
        assert setup.is_free(result.path)
        np.testing.assert_array_equal(result.path[[0, -1]], [start, goal])


@pytest.fixture(scope="module")
def beside_a_worker():
    person = Obstacle("worker", Person(height=1.75), Pose((1.0, 0.0, -0.8), (0.0, 0.0, 1.0, 0.0)))
    setup = SafeSetup(Robot.from_example("ur5"), Scene((person,)))
    setup.setConfigurations([0.9, -1.6, 1.6, -1.6, -1.57, 0.0], [-0.9, -1.6, 1.6, -1.6, -1.57, 0.0])
    return setup


@settings(max_examples=8)
@given(st.lists(st.floats(-0.9, 0.9), min_size=4, max_size=4), st.integers(0, 1000))
def test_it_is_a_front(places, seed):
    x, y, turn, bend = places
    scenario = Scenario.load("planar3")
    danger, thing = (
        Obstacle("danger", Sphere(0.1), Pose((0.6 + 0.2 * x, 0.5 * y, 0.0)), weight=1.0),
        Obstacle("thing", Sphere(0.08), Pose((-0.5, 0.4, 0.0)), weight=0.0),
    )
    setup = SafeSetup(scenario.build_robot(), Scene((danger, thing)))
    try:
        setup.setConfigurations([-1.2, 0.3 * bend, 0.2], [1.2 + 0.3 * turn, 0.2, -0.3 * bend])
    except CollisionError:
        assume(False)
    front = tradeoff(setup, (0.0, 0.5, 5.0), time=2.0, seed=seed)
    assume(front)
    assert_front(setup, front)


def test_weights_that_were_not_monotone(beside_a_worker):
    """As one plan for each weight, lengths are 2.09, 2.55, 2.23, 2.31, and dangers 7.92, 7.24, 7.47, 7.25."""
    setup, weights = beside_a_worker, (0.0, 1.0, 10.0, 100.0)
    front = tradeoff(setup, weights, time=60.0, seed=1)
    assert_front(setup, front)
    assert front.weights[:3] == weights[:3]
    assert front.results[0].report.length == pytest.approx(1.8, abs=0.01)  # the straight line
    assert front.results[-1].report.danger.mean < 7.3
    for weight, own in zip(front.weights, front.results, strict=True):
        cost = setup.simplifier.weighing(weight).cost
        setup.setSimplification(weight=weight)
        for other in (*front.results, setup.plan(seed=1, simplify=True)):
            assert cost.of(own.path) <= cost.of(other.path) * (1 + 1e-9)
    setup.setSimplification()
    again = tradeoff(setup, weights, time=60.0, seed=1)
    for first, second in zip(front.results, again.results, strict=True):
        np.testing.assert_array_equal(first.path, second.path)
    assert len(str(front).splitlines()) == 1 + len(front)


def test_a_time_limit_and_a_problem_without_solution(beside_a_worker):
    assert_front(beside_a_worker, tradeoff(beside_a_worker, time=0.1))
    wall = Obstacle("wall", Sphere(0.25), Pose((0.7, 0.0, 0.0)), weight=1.0)
    robot = Scenario.load("planar3").build_robot()
    setup = SafeSetup(robot.with_limits(dict.fromkeys(robot.joint_names, (-1.5, 1.5))), Scene((wall,)))
    setup.setConfigurations([-1.2, 0.0, 0.0], [1.2, 0.0, 0.0])
    setup.setMaxDanger(1.01 * max(setup.field.values(np.array([[-1.2, 0.0, 0.0], [1.2, 0.0, 0.0]]))))
    front = tradeoff(setup, time=0.3)
    assert not front
    assert (str(front), front.weights) == ("no path", ())


BAD_INPUT = [
    ({"weights": ()}, "weights"),
    ({"weights": "10"}, "weights"),
    ({"weights": (0, -1)}, "weight: .*-1"),
    ({"weights": (0, np.nan)}, "weight: .*nan"),
    ({"time": 0}, "time limit"),
    ({"seed": -1}, "seed"),
]


@pytest.mark.parametrize(("options", "named"), BAD_INPUT)
def test_bad_input(beside_a_worker, options, named):
    with pytest.raises(InputError, match=named) as refused:
        tradeoff(beside_a_worker, **options)
    assert "\n" not in str(refused.value)
    plain = SafeSetup(beside_a_worker.robot, beside_a_worker.scene, danger=None)
    with pytest.raises(InputError, match="danger field"):
        tradeoff(plain)


def test_it_is_drawn(beside_a_worker, tmp_path):
    pytest.importorskip("matplotlib")
    front = tradeoff(beside_a_worker, weights=(0, 1), time=2.0)
    plots.plot_tradeoff(front, tmp_path / "front.png")
    assert (tmp_path / "front.png").stat().st_size > 10_000
