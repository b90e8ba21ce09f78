"""Simplified paths: cheaper, proven, no less clear, no longer than allowed, and there whenever it stops."""

from contextlib import suppress
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from ball import GOAL, IN_BALL, SCENE, START, never, setup_for

from safe_ompl import CollisionChecker, DangerField, InputError, SafeSetup, Scenario, Scene
from safe_ompl.geometry import Box, Capsule, Cylinder, Obstacle, Pose, Sphere
from safe_ompl.planning.simplification import PathReport, Simplifier, timed
from safe_ompl.planning.simplification.cost import ObstacleCost
from safe_ompl.planning.simplification.costs import bounded_step
from safe_ompl.planning.simplification.edges import RETREAT_STEP, EdgeProofs, retreat
from safe_ompl.robot import motion_limits

GRASP = np.array([0.6, 0.5, 0.0, -1.8, 0.0, 2.3, 0.8])
AWAY = GRASP * [-1, 1, 1, 1, 1, 1, 1] - [0, 0.3, 0, 0, 0, 0, 0]


@pytest.fixture(scope="module")
def setup(ur5):
    dangerous = Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1)), weight=1.0)
    return setup_for(ur5, SCENE.without("shelf").with_obstacles(dangerous))


@pytest.fixture(scope="module")
def planar2():
    return Scenario.load("planar2").build_robot()


@pytest.fixture(scope="module")
def raw(setup):
    """Paths of OMPL's RRT-Connect, as they come."""
    return [setup.plan("RRTConnect", time=10.0, seed=seed).path for seed in range(4)]


@pytest.fixture(scope="module")
def simplified(setup, raw):
    """Of each path what it was, what it became, and all that it was on the way."""
    found = []
    for path in raw:
        steps = []
        better = simplify(setup, path, time=20.0, on_better=lambda p, cost, steps=steps: steps.append((p, cost)))
        found.append((path, better, steps))
    return found


def simplify(setup, path, time=0.2, on_better=None, **options):
    simplifier = Simplifier(setup.checker, setup.field, setup.simplifier.motion, **options)
    if on_better is None:
        return simplifier.simplify(path, time)
    run = simplifier.begin(path, timed(time), on_better)
    with suppress(KeyboardInterrupt):
        run.improve()
    return run.best


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


def after(asked):
    """Return what says stop when it has been asked so often."""
    questions = iter(range(asked))
    return lambda: next(questions, None) is None


# -------------------------------------------------------------------------------------------------- what comes of it


def test_paths_become_much_cheaper_and_no_less_clear(setup, simplified):
    cost = setup.simplifier.cost
    ratios = [cost.of(better) / cost.of(path) for path, better, _ in simplified]
    assert max(ratios) < 1
    assert np.median(ratios) < 0.7
    for path, better, steps in simplified:
        before = PathReport.of(path, setup.checker).clearance.min
        for step in (better, steps[0][0]):
            assert PathReport.of(step, setup.checker).clearance.min > before - 2e-4
        assert len(better) < 60
        assert np.linalg.norm(np.diff(better, axis=0), axis=1).max() < 1.0
        assert cost.of(simplify(setup, better, time=20.0)) <= cost.of(better) * (1 + 1e-9)


def test_every_path_on_the_way_is_proven_cheaper_than_the_given_one_and_short_enough(setup, simplified):
    cost = setup.simplifier.cost
    for path, better, steps in simplified:
        np.testing.assert_array_equal(steps[-1][0], better)
        for step, known in steps:
            assert setup.is_free(step)
            np.testing.assert_array_equal(step[[0, -1]], path[[0, -1]])
            assert length(step) <= 1.25 * length(path) + 1e-9
            assert cost.of(step) == pytest.approx(known, rel=0.02)
            assert known <= cost.of(path) * (1 + 1e-12)


@pytest.mark.parametrize("way_points", [[START, START], [START, START, START], [START, START + 0.01, START]])
def test_where_start_is_goal_nothing_moves(setup, way_points):
    np.testing.assert_array_equal(np.unique(simplify(setup, np.array(way_points)), axis=0), [START])


@pytest.mark.parametrize("seed", [73, 357])
@pytest.mark.parametrize("asked", [8, 1000])
def test_where_a_shortcut_meets_other_danger_points_it_is_no_dearer_than_the_given_path(planar2, seed, asked):
    """The given path goes round a danger point so far that another one, behind the arm, is what counts along it."""
    rng = np.random.default_rng(seed)
    start, goal = rng.uniform(-1.5, 1.5, (2, 2))
    middle, across = 0.5 * (start + goal), np.array([start[1] - goal[1], goal[0] - start[0]])
    path = np.array([start, middle + rng.uniform(0.1, 0.6) * across / np.linalg.norm(across), goal])
    near, behind = planar2.keypoints(middle)[-1] + [0.0, 0.0, rng.uniform(0.01, 0.1)], np.array([-0.6, 0.0, 0.1])
    along = np.concatenate([np.linspace(a, b, 100) for a, b in pairwise(path)])
    dangers = [DangerField(planar2, [point]).values(along) for point in (near, behind)]
    field = DangerField(planar2, [behind, near], [1.2 * (dangers[0] / dangers[1]).max(), 1.0])
    simplifier = Simplifier(CollisionChecker(planar2, Scene()), field, clearance=0.0)
    assert simplifier.cost.of(simplifier.simplify(path, after(asked))) <= simplifier.cost.of(path) * (1 + 1e-9)


def test_from_a_danger_point_all_paths_cost_infinity_and_it_soon_ends(planar2):
    rng = np.random.default_rng(8)
    path, others = rng.uniform(-2.5, 2.5, (3, 2)), np.column_stack([rng.uniform(-1, 1, (12, 2)), np.zeros(12)])
    field = DangerField(planar2, [planar2.keypoints(path[0])[-1], *others])
    simplifier, stop = Simplifier(CollisionChecker(planar2, Scene()), field), after(150)
    assert simplifier.cost.of(path) == np.inf
    found = simplifier.simplify(path, stop)
    assert not stop(), "it did not end by itself"
    np.testing.assert_array_equal(found[[0, -1]], path[[0, -1]])


def test_the_first_path_on_a_checker_becomes_what_it_becomes_later(planar2):
    """Clearances far beyond what may touch take in more pairs: these are not to depend on what was asked before."""
    capsule = Obstacle("capsule", Capsule(0.0755, 0.279), Pose((-0.354, -0.57, 0.0)), weight=1.0)
    scene = Scene((capsule,), spacing=0.1)
    simplifier = Simplifier(CollisionChecker(planar2, scene), DangerField.of_scene(planar2, scene), weight=0.0)
    path = [
        [-3.06, -2.6], [-2.27, -2.46], [-2.09, -1.68], [-1.31, -1.85],
        [-0.89, -1.29], [-1.56, -0.86], [-1.24, -0.13], [-0.91, 0.6],
    ]  # fmt: skip
    first, again = (simplifier.simplify(path, never) for _ in range(2))
    np.testing.assert_array_equal(first, again)


# ------------------------------------------------------------------------------------------------------- when to stop


@pytest.mark.parametrize("asked", [0, 3, 10, 30, 100, 300])
def test_stopped_anywhere_the_path_is_proven_and_no_dearer(setup, raw, asked):
    found, cost = simplify(setup, raw[1], after(asked)), setup.simplifier.cost
    np.testing.assert_array_equal(found[[0, -1]], raw[1][[0, -1]])
    assert setup.is_free(found)
    assert cost.of(found) <= cost.of(raw[1]) * (1 + 1e-9)


# ------------------------------------------------------------------------------------------------------------- edges


@pytest.mark.parametrize("seed", [8, 12])
def test_the_least_clearance_is_that_of_pairs_that_never_touch_too(ur5, seed):
    rng = np.random.default_rng(seed)
    angle, distance = rng.uniform(0, 2 * np.pi), rng.uniform(0.3, 0.7)
    place = Pose((distance * np.cos(angle), distance * np.sin(angle), float(rng.uniform(0, 0.3))))
    checker = CollisionChecker(ur5, Scene((Obstacle("ball", Sphere(0.05), place),)))
    path = rng.uniform(-2, 2, (2, 6))
    dense = min(checker.clearance(q).distance for q in np.linspace(*path, 200))
    assert ObstacleCost(checker, 0.05).clearances(path)[1] == pytest.approx(dense, abs=0.02)
    nothing = ObstacleCost(CollisionChecker(ur5, Scene()), 0.05)
    assert nothing.clearances(path) == (np.inf, np.inf)


# ------------------------------------------------------------------------------------------------- continuous joints


def test_a_joint_that_turns_too_far_goes_the_short_way(kinova, rng):
    joint = int(np.flatnonzero(kinova.continuous)[0])
    path = np.tile(0.5 * (np.maximum(kinova.lower, -2) + np.minimum(kinova.upper, 2)), (3, 1))
    path[:, joint] = 0.0, 2.2, 4.4
    checker = CollisionChecker(kinova, Scene())
    simplifier = Simplifier(checker, DangerField(kinova, [[0.5, 0.5, 0.5]]), weight=0.0, clearance=0.0)
    found = simplifier.simplify(path, never)
    assert length(found) == pytest.approx(2 * np.pi - 4.4, rel=1e-6)
    assert PathReport.of(found, checker).certified
    np.testing.assert_allclose(kinova.difference(found[-1], path[-1]), 0.0, atol=1e-12)
    path = rng.uniform(-7, 7, (20, kinova.n))
    found = kinova.unrolled(path)
    np.testing.assert_array_equal(found[:, ~kinova.continuous], path[:, ~kinova.continuous])
    np.testing.assert_allclose(np.diff(found, axis=0), kinova.difference(path[:-1], path[1:]), atol=1e-12)


# ---------------------------------------------------------------------------------------------------------- bad input


BAD_OPTIONS = [
    ({"time": 0.0}, "time"),
    ({"weight": -1.0}, "weight"),
    ({"clearance": -0.1}, "clearance"),
    ({"path": np.zeros((3, 5))}, "shape"),
    ({"path": np.full((2, 6), np.nan)}, "finite"),
    ({"path": START[None]}, "two configurations"),
    ({"path": [START, IN_BALL, GOAL]}, "edge from way point 0"),
]


@pytest.mark.parametrize(("options", "message"), BAD_OPTIONS)
def test_what_makes_no_sense(setup, raw, options, message):
    with pytest.raises(InputError, match=message):
        simplify(setup, **{"path": raw[0], **options})


# --------------------------------------------------------------------------------- retreats from ends near obstacles


@pytest.fixture(scope="module")
def grasp(panda):
    """Return a problem with a can between the fingers, its axis across the hand."""
    tip = panda.tip_pose(GRASP)
    across = tip.rotation @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    pose = Pose(tuple(tip.translation + 0.01 * tip.rotation[:, 2]), tuple(pin.Quaternion(across).normalized().coeffs()))
    setup = SafeSetup(panda, Scene((Obstacle("can", Cylinder(0.025, 0.12), pose, weight=1.0),), spacing=0.04))
    setup.setConfigurations(AWAY, GRASP)
    return setup


@pytest.mark.parametrize("seed", range(3))
def test_simplified_paths_are_as_clear_and_as_safe_as_their_ends(grasp, seed):
    raw = grasp.plan("RRTConnect", time=10.0, seed=seed).path
    before, after = (grasp.report(path) for path in (raw, grasp.simplifier.simplify(raw, never, proven=True)))
    end = grasp.checker.clearance(GRASP).distance
    assert before.clearance.min < 0.98 * end, "or the test shows nothing"
    assert after.clearance.min > 0.99 * end
    assert after.danger.max <= 1.001 * grasp.field.value(GRASP)
    if seed == 0:
        found = grasp.simplifier.simplify(np.concatenate([raw[::-1], raw[1:]]), never)
        np.testing.assert_array_equal(np.unique(found, axis=0), [GRASP])


def test_where_no_joint_changes_what_is_near_there_is_no_way_out(planar2):
    """A stretched planar arm below a plate, which stays as near as it is, points at what is in danger."""
    plate = Obstacle("plate", Box((2.0, 2.0, 0.02)), Pose((0.0, 0.0, 0.06)))
    nearness = ObstacleCost(CollisionChecker(planar2, Scene((plate,))), 0.1)
    stretched, field = np.zeros(2), DangerField(planar2, [[1.3, 0.0, 0.0]])
    assert len(nearness.near(stretched[None]).rows)
    assert not field.gradient(stretched).any()
    np.testing.assert_array_equal(retreat(stretched, nearness, field, motion_limits(planar2), never), [stretched])


@pytest.mark.parametrize("vectors", [0, 2, 9])
def test_a_step_of_a_retreat_is_the_best_of_its_length(rng, vectors):
    for scale in (0.01, 1.0, 1e3):
        gradient, bends = rng.normal(size=5), scale * rng.normal(size=(vectors, 5))
        step = bounded_step(gradient, bends, RETREAT_STEP)

        def value(steps, gradient=gradient, bends=bends):
            return steps @ gradient + 0.5 * ((steps @ bends.T) ** 2).sum(axis=-1)

        assert np.linalg.norm(step) <= RETREAT_STEP * (1 + 1e-8)
        others = rng.normal(size=(2000, 5))
        others *= RETREAT_STEP * rng.uniform(size=(2000, 1)) / np.linalg.norm(others, axis=1, keepdims=True)
        assert value(step) <= value(others).min() + 1e-12 * abs(value(step))
    assert not bounded_step(np.zeros(5), bends, RETREAT_STEP).any()


def test_edges_are_weeded_out_of_chains_where_they_are_blocked_and_nowhere_else(setup, rng):
    motion, robot = setup.motion_prover, setup.robot
    path = rng.uniform(robot.lower, robot.upper, (9, robot.n))
    costs, known = np.triu(rng.uniform(1.0, 2.0, (9, 9)), 1), np.zeros((9, 9), dtype=np.intp)
    costs[costs == 0.0] = np.inf
    proofs, given = EdgeProofs(motion), costs.copy()
    proofs.chained(path, costs, np.inf, known)
    weeded = np.argwhere(np.isinf(costs) & np.isfinite(given))
    assert len(weeded)
    assert not any(motion.is_free(path[i], path[j]) for i, j in weeded)
    assert all(motion.is_free(path[i], path[j]) for i, j in np.argwhere(known) if [i, j] not in weeded.tolist())
