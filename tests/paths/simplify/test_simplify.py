"""Simplified paths: cheaper, proven, no less clear, no longer than allowed, and there whenever it stops."""

from itertools import pairwise

import numpy as np
import pytest
from ompl import util as ou

from safe_ompl import CollisionChecker, InputError, MotionProver, SafeSetup, Scene
from safe_ompl.geometry import Box, Obstacle, Pose, Sphere
from safe_ompl.paths import PathReport, Simplifier
from safe_ompl.paths.cost import ObstacleCost, PathCost
from safe_ompl.paths.edges import EdgeProofs, shortcut

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
GOAL = START * [-1, 1, 1, 1, 1, 1]
SEEDS = range(4)


@pytest.fixture(scope="module")
def setup(ur5):
    scene = Scene(
        (
            Obstacle("ball", Sphere(0.15), Pose((0.45, 0.1, 0.55)), weight=1.0),
            Obstacle("shelf", Box((0.3, 0.6, 0.02)), Pose((0.5, 0.0, 0.1)), weight=1.0),
        )
    )
    handler = ou.getOutputHandler()
    ou.noOutputHandler()
    setup = SafeSetup(ur5, scene)
    setup.setConfigurations(START, GOAL)
    yield setup
    ou.useOutputHandler(handler)


@pytest.fixture(scope="module")
def raw(setup):
    """Paths of OMPL's RRT-Connect, as they come."""
    return [setup.plan("RRTConnect", time=10.0, seed=seed).path for seed in SEEDS]


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
    return simplifier.simplify(path, time, on_better)


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


# -------------------------------------------------------------------------------------------------- what comes of it


def test_paths_become_much_cheaper(setup, simplified):
    cost = setup.simplifier.cost
    ratios = [cost.of(better) / cost.of(path) for path, better, _ in simplified]
    assert max(ratios) < 1
    assert np.median(ratios) < 0.7


def test_every_path_on_the_way_is_proven_cheaper_than_the_given_one_and_short_enough(setup, simplified):
    motion, cost = MotionProver(setup.checker), setup.simplifier.cost
    for path, better, steps in simplified:
        assert steps
        np.testing.assert_array_equal(steps[-1][0], better)
        for step, known in steps:
            assert all(motion.is_free(a, b) for a, b in pairwise(step))
            np.testing.assert_array_equal(step[[0, -1]], path[[0, -1]])
            assert length(step) <= 1.25 * length(path) + 1e-9
            assert cost.of(step) == pytest.approx(known, rel=0.02)
            assert known <= cost.of(path)


def test_without_nearness_the_cost_falls_at_every_step(setup, raw):
    for path in raw:
        costs = []
        simplify(setup, path, time=20.0, clearance=0.0, on_better=lambda p, c, to=costs: to.append(c))
        assert (np.diff(costs) <= 1e-9).all()


def test_no_less_clear(setup, simplified):
    for path, better, steps in simplified:
        before = PathReport.of(path, setup.checker).clearance.min
        for step in (better, steps[0][0]):
            assert PathReport.of(step, setup.checker).clearance.min > before - 2e-4


def test_way_points_are_few_and_near_enough_for_a_controller(simplified):
    for _, better, _ in simplified:
        steps = np.linalg.norm(np.diff(better, axis=0), axis=1)
        assert len(better) < 60
        assert steps.max() < 1.0


def test_simplified_again_it_stays_as_cheap(setup, simplified):
    _, better, _ = simplified[0]
    cost = setup.simplifier.cost
    assert cost.of(simplify(setup, better, time=20.0)) <= cost.of(better) * (1 + 1e-9)


def test_the_better_passage_is_taken(setup, raw):
    """A detour that visits the far side of the joint range is cut off."""
    straight = raw[0]
    detour = np.vstack([straight[:1], straight[:1] - [0.0, 0.0, 0.0, 0.0, 0.0, 1.5], straight])
    cost = setup.simplifier.cost
    assert cost.of(simplify(setup, detour, time=20.0)) < 1.1 * cost.of(simplify(setup, straight, time=20.0))


# ------------------------------------------------------------------------------------------------------- when to stop


def test_it_stops_when_told(setup, raw):
    asked = []
    same = simplify(setup, raw[0], lambda: asked.append(1) or True)
    assert asked
    np.testing.assert_array_equal(same[[0, -1]], raw[0][[0, -1]])
    assert length(same) == pytest.approx(length(raw[0]))


@pytest.mark.parametrize("after", [1, 2])
def test_interrupted_the_best_path_so_far_stands(setup, raw, after):
    steps = []

    def interrupt(path, cost):
        steps.append(path)
        if len(steps) == after:
            raise KeyboardInterrupt

    found = simplify(setup, raw[0], time=20.0, on_better=interrupt)
    assert len(steps) == after
    np.testing.assert_array_equal(found, steps[-1])


# ------------------------------------------------------------------------------------------------------ goals and parts


def test_shortcuts_are_the_cheapest_proven_chain(setup, raw):
    cost, proof = setup.simplifier.cost, EdgeProofs(setup.simplifier.motion)
    for path in raw:
        found = shortcut(path, cost, proof, lambda: False)
        assert all(MotionProver(setup.checker).is_free(a, b) for a, b in pairwise(found))
        assert {tuple(q) for q in found} <= {tuple(q) for q in path}
        assert cost.of(found) <= 1.02 * cost.of(path), "edges are sampled coarsely"


def test_the_chain_goes_round_what_is_refused(setup):
    path = np.linspace(START, GOAL, 5)
    step = np.linalg.norm(path[1] - path[0])

    class Refusing:
        """Refuses edges between way points that are not neighbours."""

        def accepts(self, start, end):
            return np.linalg.norm(end - start) < 1.5 * step

    found = shortcut(path, PathCost(setup.robot, []), Refusing(), lambda: False)
    np.testing.assert_array_equal(found, path)


def test_where_no_chain_is_proven_or_time_is_up_there_is_no_shortcut(setup):
    class Refusing:
        def accepts(self, start, end):
            return not np.array_equal(end, GOAL)

    path, cost = np.linspace(START, GOAL, 5), PathCost(setup.robot, [])
    assert shortcut(path, cost, Refusing(), lambda: False) is None
    assert shortcut(path, cost, EdgeProofs(setup.simplifier.motion), lambda: True) is None


class Picky(EdgeProofs):
    """Refuses edges between which the first joint jumps."""

    def accepts(self, start, end):
        return abs(start[0] - end[0]) < 0.4


def test_what_is_refused_is_held_back_without_kinks(setup):
    known = np.zeros((9, 6))
    known[:, 1] = np.linspace(0, 1.6, 9)
    wanted = known.copy()
    wanted[5:7, 0] = 0.5
    found, back = Picky(setup.simplifier.motion).held_back(wanted, known)
    np.testing.assert_array_equal(found[back], known[back])
    assert back[4:8].all()
    assert not back.all()
    assert np.abs(np.diff(found[:, 0])).max() < 0.4


def test_where_nothing_helps_all_goes_back(setup):
    class Refusing(EdgeProofs):
        def accepts(self, start, end):
            return start[0] == end[0] == 0

    known = np.zeros((4, 6))
    found, back = Refusing(setup.simplifier.motion).held_back(known + 0.1, known)
    np.testing.assert_array_equal(found, known)
    assert back.all()


@pytest.mark.parametrize("way_points", [[START, START], [START, START, START], [START, START + 0.01, START]])
def test_where_start_is_goal_nothing_moves(setup, way_points):
    np.testing.assert_array_equal(np.unique(simplify(setup, np.array(way_points)), axis=0), [START])


def test_without_obstacles_there_is_no_least_clearance(ur5):
    nothing = ObstacleCost(CollisionChecker(ur5, Scene()), 0.05)
    assert nothing.clearances(np.array([START, GOAL])) == (np.inf, np.inf)


# ---------------------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"time": 0.0}, "time"),
        ({"weight": -1.0}, "weight"),
        ({"clearance": -0.1}, "clearance"),
        ({"weight": "wide"}, "weight"),
    ],
)
def test_bad_options(setup, raw, options, message):
    with pytest.raises(InputError, match=message):
        simplify(setup, raw[0], **options)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (np.zeros((3, 5)), "shape"),
        (np.full((2, 6), np.nan), "finite"),
        (START[None], "two configurations"),
        ([START, START * [0, 1, 1, 1, 1, 1], GOAL], "edge from way point 0"),
    ],
)
def test_bad_paths(setup, path, message):
    with pytest.raises(InputError, match=message):
        simplify(setup, path)


# --------------------------------------------------------------------------------------------------- what comes first


def test_a_better_path_comes_after_few_questions(setup, raw):
    """Shortcuts between the given way points come before all that costs more."""
    for path in raw:
        before, seen = setup.field.counts.field_configurations, []

        def note(better, cost, before=before, seen=seen):
            seen.append(setup.field.counts.field_configurations - before)

        simplify(setup, path, time=20.0, on_better=note)
        assert seen[0] < 0.5 * seen[-1]


@pytest.mark.parametrize("asked", [3, 10, 30, 100, 300])
def test_stopped_anywhere_the_path_is_proven_and_no_dearer(setup, raw, asked):
    questions = iter(range(asked))
    found = simplify(setup, raw[1], lambda: next(questions, None) is None)
    motion, cost = MotionProver(setup.checker), setup.simplifier.cost
    assert all(motion.is_free(a, b) for a, b in pairwise(found))
    assert cost.of(found) <= cost.of(raw[1]) * (1 + 1e-9)


def test_when_time_is_up_nothing_more_is_proven(setup, raw):
    proofs = EdgeProofs(setup.simplifier.motion, lambda: True)
    proofs.accept(raw[0][:2])
    assert proofs.accepts(raw[0][0], raw[0][1])
    queries = setup.checker.counts.margin_queries
    assert not proofs.accepts(raw[0][0], raw[0][0] + 1e-3)
    assert setup.checker.counts.margin_queries == queries


def test_parts_of_a_proven_edge_are_proven_when_they_are_asked_for(setup, raw):
    proofs = EdgeProofs(setup.simplifier.motion)
    proofs.accept(raw[0])
    proofs.keep(10.0)  # no motion has so much
    parts = np.concatenate([np.linspace(a, b, 3) for a, b in pairwise(raw[0])])
    assert proofs.refused(parts)
    proofs.inherit(parts)
    assert not proofs.refused(parts)
