"""Parts that planners share: growth by turns, and what it asks; danger's weight, decay and threshold; the margin."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from safe_ompl import Box, CertifiedMotionValidator, DangerObjective, Obstacle, Pose, Robot, SafeSetup, Scenario, Scene
from safe_ompl.common import Counts, InputError, PlanningError
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.ompl import StateCost
from safe_ompl.planning.planners.growth import Extension, Growth
from safe_ompl.planning.planners.problem import DangerDecay, DangerWeight, Margin, PlanningProblem
from safe_ompl.planning.planners.tree import Trees

PLANNERS = ["SafeRRTConnect", "ClassicRRTConnect"]

# -------------------------------------------------------------------------------- growth by turns, and what it asks


class AnyObjective(DangerObjective):
    """Not the class itself, so compiled code does not compute it."""


class AnyValidator(CertifiedMotionValidator):
    """Not the class itself, so planners ask it by OMPL's states, as they ask a user's own."""

    asked = 0

    def checkMotion(self, *args):
        self.asked += 1
        return super().checkMotion(*args)


def planned(setup, planner, seed):
    """Return the path, and how many nodes it took."""
    setup.prepare(planner, seed)
    if planner == "SafeRRTConnect":
        setup.getPlanner().setClearance(0.0)
    assert setup.solve(30.0)
    return setup.solution(), setup.getPlanner().counts.nodes


@pytest.fixture
def asked(monkeypatch):
    """Return the names of what compiled code asks of problem and cost."""
    asked = []

    def note(kind, name):
        answer = getattr(kind, name)

        def noted(self, *args):
            asked.append(name)
            return answer(self, *args)

        monkeypatch.setattr(kind, name, noted)

    note(PlanningProblem, "motion_is_free")
    note(StateCost, "values")
    note(StateCost, "value_and_gradient")
    return asked


def wrapping_setup(robot, clutter):
    setup = SafeSetup(robot, Scene(tuple(replace(obstacle, weight=1.0) for obstacle in clutter)))
    rng = np.random.default_rng(3)
    Q = [q for q in rng.uniform(robot.lower, robot.upper, (40, robot.n)) if not setup.checker.in_collision(q)]
    setup.setConfigurations(Q[0], Q[1])
    return setup


@pytest.mark.parametrize("problem", ["planar2", "panda_shelf", "ur5_handover", "joints that wrap"])
def test_paths_are_those_of_a_validator_and_of_an_objective_of_ones_own(problem, kinova, clutter, asked):
    wraps = problem == "joints that wrap"
    setup = wrapping_setup(kinova, clutter) if wraps else setup_scenario(Scenario.load(problem))
    si = setup.getSpaceInformation()
    validator = AnyValidator(si, setup.checker)
    runs = [(planner, seed) for planner in PLANNERS for seed in range(3)]
    at_once = [planned(setup, *run) for run in runs]
    undecided = asked.count("motion_is_free")
    assert not {"values", "value_and_gradient"} & {*asked}
    setup.validator = validator
    si.setMotionValidator(validator)
    setup.setOptimizationObjective(AnyObjective(si, setup.field))
    asked.clear()
    for run, (path, nodes) in zip(runs, at_once, strict=True):
        of_ones_own, as_many = planned(setup, *run)
        assert nodes == as_many > 0
        assert np.array_equal(path, of_ones_own)
    assert asked.count("motion_is_free") == validator.asked > undecided
    assert {"values", "value_and_gradient"} <= {*asked}


def test_trees_that_grow_are_not_asked_to_grow(plane, danger):
    growth = Growth(plane, danger, Margin(plane, danger))
    trees, rng = Trees(plane.bridge, plane.cost, Counts()), np.random.default_rng(0)
    trees.add_start(np.array([-0.8, 0.0]))
    trees.add_goal(np.array([0.5, 0.0]))

    def connect(stop):
        return growth.connect(trees, rng, 0.3, 0.0, 0, stop, lambda: sys.maxsize, list)

    with pytest.raises(PlanningError, match="make one for each thread"):
        connect(lambda: connect(lambda: False))
    others = Trees(plane.bridge, plane.cost, Counts())
    with pytest.raises(InputError, match="there is no node 0 in these trees"):
        growth.extend(others, trees.start, 0, np.zeros(2), 0.3)
    np.testing.assert_array_equal(connect(lambda: False)[[0, -1]], [[-0.8, 0.0], [0.5, 0.0]])


def test_motions_are_free_that_the_motion_validator_calls_free(ur5):
    scene = Scene((Obstacle("box", Box((0.3, 0.3, 0.6)), Pose((0.45, 0.0, 0.3))),))
    si = SafeSetup(ur5, scene).getSpaceInformation()
    bounds = si.getStateSpace().getBounds()
    bounds.setHigh(0, 1.0)  # narrower than the robot's own
    si.getStateSpace().setBounds(bounds)
    task, rng = PlanningProblem(si), np.random.default_rng(0)
    bridge, verdicts = task.bridge, []
    for _ in range(100):
        start = rng.uniform(ur5.lower, ur5.upper)
        end = start + rng.uniform(-0.5, 0.5, ur5.n)
        states = [si.allocState(), si.allocState()]
        for q, state in zip((start, end), states, strict=True):
            bridge.write(q, state)
        verdicts.append(task.motion_is_free(start, end))
        assert verdicts[-1] == si.checkMotion(*states)
    assert 10 < sum(verdicts) < 90


# ------------------------------------------------------------------------------------------------------ danger


@pytest.fixture
def danger(plane):
    return DangerWeight(plane)


def test_the_weight_is_relative_to_the_usual_slope(plane, danger):
    for alpha, scale, weight in ((2.0, 1.0, 2.0), (2.0, 0.5, 1.0), (0.0, 1.0, 0.0)):
        danger.alpha, danger.scale = alpha, scale
        assert danger.weight == weight / plane.slope


@pytest.mark.parametrize("half_life", [0, 20])
def test_danger_fades_to_half_and_to_next_to_nothing_or_turn_by_turn(danger, half_life):
    decay, rng = DangerDecay(danger, Margin(danger._problem, danger)), np.random.default_rng(1)
    decay.half_life = half_life

    def scales(turn, *args):
        decay.reset()
        return [(turn(*args), danger.scale)[1] for _ in range(200)]

    faded, chosen = scales(decay.fade), scales(decay.turn, rng)
    if not half_life:
        assert {*faded, *chosen} == {1.0}
        return
    assert [faded[k] for k in (0, 20, 60)] == pytest.approx([1.0, 1 / 2, 1 / 82])
    assert set(chosen) == {0.0, 1.0}
    assert np.mean(chosen[:10]) > 0.8
    assert np.mean(chosen[80:]) < 0.1


def test_the_threshold_begins_with_the_danger_of_the_ends_and_rises_after_eight_refusals(plane, danger):
    growth = Growth(plane, danger, Margin(plane, danger))

    def step(trees):  # to where it is a little more dangerous than at the goal
        return growth.extend(trees, trees.start, 0, np.array([0.0, 0.0]), 0.31)[0]

    def two_trees():
        growth.reset()
        trees = Trees(plane.bridge, plane.cost, Counts())
        trees.add_start(np.array([-0.8, 0.0]))
        trees.add_goal(np.array([0.5, 0.0]))
        return trees

    assert step(two_trees()) is Extension.ADVANCED, "there is none"
    growth.rise, trees = 0.1, two_trees()
    for _ in range(8):
        assert step(trees) is Extension.TRAPPED
    assert step(trees) is Extension.ADVANCED
    assert 1.0 < trees.start.costs[1] / trees.goal.costs[0] < 1.1


# ------------------------------------------------------------------------------------------------------- margin


def test_the_margin_follows_obstacles_that_move():
    box = Obstacle("box", Box((0.1, 0.1, 0.4)), Pose((0.45, 0.0, 0.3)), weight=1.0)
    setup = SafeSetup(Robot.from_example("ur5"), Scene((box,)), movable=("box",))
    problem = PlanningProblem(setup.getSpaceInformation())
    problem.take(setup.getProblemDefinition().getOptimizationObjective())
    margin, q = Margin(problem, DangerWeight(problem)), np.array([2.0, -1.6, 1.2, -1.2, -1.57, 0.0])
    margin.largest = 0.05
    margin.begin_between([q[None]])
    assert margin.level == 0.05
    margin.largest = 10.0
    margin.reset()
    margin.begin_between([q[None]])
    assert 0.6 < margin.level / setup.checker.clearance(q).distance < 0.801, "it is cut to most of what the ends keep"
    margin.largest = 0.05
    tip = setup.robot.tip_pose(q).translation
    setup.checker.move(setup.checker.scene.moved({"box": Pose(tuple(tip.tolist()))}))
    margin.reset()
    margin.begin_between([q[None]])
    assert margin.level == 0.0
