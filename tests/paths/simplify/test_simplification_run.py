"""What simplification promises of paths and situations that are out of the ordinary."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from safe_ompl import Box, Capsule, CollisionChecker, DangerField, MotionProver, Obstacle, Pose, Sphere
from safe_ompl.paths import Simplifier, unrolled
from safe_ompl.paths.cost import ObstacleCost
from safe_ompl.paths.edges import shortcut
from safe_ompl.paths.simplifier import SimplificationRun
from safe_ompl.planning import setup_scenario
from safe_ompl.robot import Robot
from safe_ompl.scene import Scenario, Scene, find_scenario

PLANAR2 = Path(__file__).parents[3] / "scenarios" / "robots" / "planar2.urdf"
START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
GOAL = START * [-1, 1, 1, 1, 1, 1]


@pytest.fixture(scope="module")
def planar2():
    return Robot.from_urdf(PLANAR2, tip="tip")


def length(robot, path):
    return sum(np.linalg.norm(robot.difference(a, b)) for a, b in pairwise(path))


def never():
    return False


# ------------------------------------------------------------------------------------------------ danger elsewhere


@pytest.mark.parametrize("seed", [73, 357])
@pytest.mark.parametrize("asked", [8, 1000])
def test_where_a_shortcut_meets_other_danger_points_it_is_no_dearer_than_the_given_path(planar2, seed, asked):
    """The given path goes round a danger point so far that another one, behind the arm, is what counts along it."""
    rng = np.random.default_rng(seed)
    start, goal = rng.uniform(-1.5, 1.5, (2, 2))
    middle, across = 0.5 * (start + goal), np.array([start[1] - goal[1], goal[0] - start[0]])
    detour = middle + rng.uniform(0.1, 0.6) * across / np.linalg.norm(across)
    path = np.array([start, detour, goal])
    near = planar2.keypoints(middle)[-1] + [0.0, 0.0, rng.uniform(0.01, 0.1)]
    behind = np.array([-0.6, 0.0, 0.1])
    along = np.concatenate([np.linspace(a, b, 100) for a, b in pairwise(path)])
    dangers = [DangerField(planar2, [point]).values(along) for point in (near, behind)]
    field = DangerField(planar2, [behind, near], [1.2 * (dangers[0] / dangers[1]).max(), 1.0])
    simplifier = Simplifier(CollisionChecker(planar2, Scene()), field, clearance=0.0)
    questions = iter(range(asked))
    found = simplifier.simplify(path, lambda: next(questions, None) is None)
    assert simplifier.cost.of(found) <= simplifier.cost.of(path) * (1 + 1e-9)


def test_from_a_danger_point_all_paths_cost_infinity_and_it_soon_ends(planar2):
    rng = np.random.default_rng(8)
    path = rng.uniform(-2.5, 2.5, (3, 2))
    others = np.column_stack([rng.uniform(-1, 1, (12, 2)), np.zeros(12)])
    field = DangerField(planar2, [planar2.keypoints(path[0])[-1], *others])
    simplifier = Simplifier(CollisionChecker(planar2, Scene()), field)
    assert simplifier.cost.of(path) == np.inf
    questions = iter(range(150))
    found = simplifier.simplify(path, lambda: next(questions, None) is None)
    assert next(questions, None) is not None, "it did not end by itself"
    np.testing.assert_array_equal(found[[0, -1]], path[[0, -1]])


@pytest.mark.parametrize("seed", [8, 12])
def test_the_least_clearance_is_that_of_pairs_that_never_touch_too(ur5, seed):
    rng = np.random.default_rng(seed)
    angle, distance = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.7)
    place = Pose((distance * np.cos(angle), distance * np.sin(angle), float(rng.uniform(0, 0.3))))
    checker = CollisionChecker(ur5, Scene((Obstacle("ball", Sphere(0.05), place),)))
    path = rng.uniform(-2, 2, (2, 6))
    dense = min(checker.clearance(q).distance for q in np.linspace(*path, 200))
    assert ObstacleCost(checker, 0.05).clearances(path)[1] == pytest.approx(dense, abs=0.02)


# ------------------------------------------------------------------------------------------------------- early stops


def test_of_a_long_path_few_edges_are_looked_at(ur5):
    class Counting:
        robot = ur5
        edges = 0

        def of_edges(self, starts, ends, samples):
            self.edges += len(starts)
            return np.linalg.norm(ends - starts, axis=1)

    class Proof:
        def accepts(self, start, end):
            return np.linalg.norm(end - start) < 0.5 * np.linalg.norm(GOAL - START)

    cost, path = Counting(), np.linspace(START, GOAL, 500)
    found = shortcut(path, cost, Proof(), never)
    np.testing.assert_array_equal(found[[0, -1]], path[[0, -1]])
    assert len(found) < 10
    assert cost.edges < 1500


def test_when_time_is_up_nothing_is_begun(ur5):
    field = DangerField(ur5, [[0.4, 0.4, 0.4]])
    checker = CollisionChecker(ur5, Scene((Obstacle("ball", Sphere(0.1), Pose((0.6, 0.3, 0.2))),)))
    simplifier = Simplifier(checker, field)
    path = np.linspace(START, GOAL, 30)
    run = simplifier.begin(path, lambda: True)
    before = field.counts.field_configurations, checker.counts.distance_queries
    run.improve()
    assert field.counts.field_configurations - before[0] < 100
    assert checker.counts.distance_queries == before[1]


# --------------------------------------------------------------------------------------------------------- two paths


@pytest.fixture(scope="module")
def shelf(ur5):
    """Return a simplifier between two obstacles, a path beside one of them, and one far from both."""
    scene = Scene(
        (
            Obstacle("ball", Sphere(0.1), Pose((0.45, 0.1, 0.55)), weight=1.0),
            Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1)), weight=1.0),
        )
    )
    checker = CollisionChecker(ur5, scene)
    away = START - np.array([np.pi, 0, 0, 0, 0, 0])
    paths = (
        np.array([START, START + np.array([0, 0.3, -0.5, 0, 0.4, 0])]),
        np.array([away, away + np.array([0.5, 0.8, 0, 0, 0, 0])]),
    )
    return checker, DangerField(ur5, [[0.45, 0.1, 0.55], [0.5, 0.0, 0.1]]), paths


def test_paths_begun_together_become_what_each_becomes_alone(shelf):
    checker, field, paths = shelf
    simplifier = Simplifier(checker, field, clearance=0.3)
    together = [simplifier.begin(path, never) for path in paths]
    for run in together:
        run.improve()
    for run, path in zip(together, paths, strict=True):
        np.testing.assert_array_equal(run.best, Simplifier(checker, field, clearance=0.3).simplify(path, never))


# ------------------------------------------------------------------------------------------------- continuous joints


def test_a_joint_that_turns_too_far_goes_the_short_way(kinova):
    joint = int(np.flatnonzero(kinova.continuous)[0])
    path = np.tile(0.5 * (np.maximum(kinova.lower, -2) + np.minimum(kinova.upper, 2)), (3, 1))
    path[:, joint] = 0.0, 2.2, 4.4
    checker = CollisionChecker(kinova, Scene())
    simplifier = Simplifier(checker, DangerField(kinova, [[0.5, 0.5, 0.5]]), weight=0.0, clearance=0.0)
    found = simplifier.simplify(path, never)
    assert length(kinova, found) == pytest.approx(2 * np.pi - 4.4, rel=1e-6)
    assert np.linalg.norm(np.diff(found, axis=0), axis=1).sum() == pytest.approx(2 * np.pi - 4.4, rel=1e-6)
    assert all(MotionProver(checker).is_free(a, b) for a, b in pairwise(found))
    np.testing.assert_allclose(kinova.difference(found[-1], path[-1]), 0.0, atol=1e-12)


def test_unrolled_joints_that_do_not_wrap_stay_as_they_are(kinova, rng):
    path = rng.uniform(-7, 7, (20, kinova.n))
    found = unrolled(kinova, path)
    np.testing.assert_array_equal(found[:, ~kinova.continuous], path[:, ~kinova.continuous])
    np.testing.assert_allclose(np.diff(found, axis=0), kinova.difference(path[:-1], path[1:]), atol=1e-12)


# --------------------------------------------------------------------------------------------------- the same again


def test_the_first_path_on_a_checker_becomes_what_it_becomes_later(planar2):
    """Clearances far beyond what may touch take in more pairs: these are not to depend on what was asked before."""
    capsule = Obstacle("capsule", Capsule(0.0755, 0.279), Pose((-0.354, -0.57, 0.0)), weight=1.0)
    checker = CollisionChecker(planar2, Scene((capsule,), spacing=0.1))
    points, weights, _ = checker.scene.danger_points()
    simplifier = Simplifier(checker, DangerField(planar2, points, weights), weight=0.0)
    path = [
        [-3.06, -2.6], [-2.27, -2.46], [-2.09, -1.68], [-1.31, -1.85],
        [-0.89, -1.29], [-1.56, -0.86], [-1.24, -0.13], [-0.91, 0.6],
    ]  # fmt: skip
    first, again = (simplifier.simplify(path, never) for _ in range(2))
    np.testing.assert_array_equal(first, again)


# ---------------------------------------------------------------------------------------------------- poor minima


@pytest.mark.parametrize(("scenario", "seed"), [("panda_shelf", 1), ("xarm7_pillars", 2)])
def test_shortcuts_after_the_descent_lead_out_of_poor_minima(scenario, seed, monkeypatch):
    setup = setup_scenario(Scenario.load(find_scenario(scenario)))
    setup.prepare("SafeRRTConnect", seed)
    setup.solve(20.0)
    given, simplifier = setup.solution(), setup.simplifier
    found = simplifier.simplify(given, never, proven=True)
    with monkeypatch.context() as patched:
        patched.setattr(SimplificationRun, "_shorten_anew", lambda run: False)
        once = simplifier.simplify(given, never, proven=True)
    assert simplifier.cost.of(found) < 0.9 * simplifier.cost.of(once)
    assert setup.is_free(found)
