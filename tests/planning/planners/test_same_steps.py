"""Steps in kernels: as NumPy has them, and the same paths whether a motion is proven at once or asked of OMPL."""

from dataclasses import replace

import numpy as np
import pytest

from safe_ompl import CollisionChecker, SafeSetup, Scenario, Scene
from safe_ompl.planning import setup_scenario
from safe_ompl.planning.ompl import CertifiedMotionValidator, StateBridge, joint_space
from safe_ompl.planning.planners.parts.steps import ADVANCED, REACHED, StepKernel
from safe_ompl.robot import JointLimits, kernels
from safe_ompl.scene import find_scenario

PLANNERS = ["SafeRRTConnect", "ClassicRRTConnect"]


class AnyValidator(CertifiedMotionValidator):
    """Not the class itself, so planners ask it by OMPL's states, as they ask a user's own."""

    asked = 0

    def checkMotion(self, *args):
        self.asked += 1
        return super().checkMotion(*args)


def planned(setup, planner, seed, clearance=0.0):
    """Return the path, and how many nodes it took."""
    setup.prepare(planner, seed)
    if planner == "SafeRRTConnect":
        setup.getPlanner().setClearance(clearance)
    before = setup.counts.copy()
    assert setup.solve(30.0)
    return setup.solution(), (setup.counts - before).nodes


@pytest.fixture
def taken(monkeypatch):
    """Return the outcomes of all steps that a kernel took."""
    outcomes, take = [], StepKernel.take

    def noted(self, *args):
        found = take(self, *args)
        outcomes.append(None if found is None else found.outcome)
        return found

    monkeypatch.setattr(StepKernel, "take", noted)
    return outcomes


def assert_same_paths(setup, taken, seeds=range(3)):
    si = setup.getSpaceInformation()
    asked = AnyValidator(si, setup.checker)
    runs = [(planner, seed) for planner in PLANNERS for seed in seeds]
    at_once = [planned(setup, *run) for run in runs]
    assert {ADVANCED, REACHED} <= set(taken)
    taken.clear()
    setup.validator = asked
    si.setMotionValidator(asked)
    for run, (path, nodes) in zip(runs, at_once, strict=True):
        before = asked.asked
        composed, as_many = planned(setup, *run)
        assert nodes == as_many
        assert asked.asked > before
        assert np.array_equal(path, composed)
    assert not taken, "no kernel is asked"


@pytest.mark.parametrize("scenario", ["planar2", "panda_shelf", "ur5_handover"])
def test_paths_are_those_of_a_validator_of_ones_own(scenario, taken):
    assert_same_paths(setup_scenario(Scenario.load(find_scenario(scenario))), taken)


def test_paths_are_the_same_where_joints_wrap(robot_named, clutter, taken):
    robot = robot_named("kinova")
    assert robot.continuous.any()
    setup = SafeSetup(robot, Scene(tuple(replace(obstacle, weight=1.0) for obstacle in clutter)))
    rng = np.random.default_rng(3)
    Q = [q for q in rng.uniform(robot.lower, robot.upper, (40, robot.n)) if not setup.checker.in_collision(q)]
    setup.setConfigurations(Q[0], Q[1])
    assert_same_paths(setup, taken)


@pytest.mark.parametrize("name", ["panda", "kinova", "slider", "twin_arm"])
def test_steps_and_descents_are_those_of_numpy(robot_named, name):
    robot = robot_named(name)
    bridge = StateBridge(joint_space(robot))
    rng = np.random.default_rng(0)
    for reach in rng.uniform(0.0, 0.5, 200):
        q, target = bridge.between_bounds(rng.random((2, robot.n)))
        delta, step = bridge.difference(q, target), np.empty((2, robot.n))
        length = kernels.steer(q, target, bridge.circular, reach, step)
        assert length == pytest.approx(np.linalg.norm(delta), rel=1e-14)
        there = target if length <= reach else q + (reach / length) * delta
        assert np.array_equal(step, [there, delta / length])
        slope = rng.normal(size=robot.n) * 10.0 ** rng.uniform(-2, 2)
        sideways = slope - (slope @ step[1]) * step[1]
        steepness = np.linalg.norm(sideways)
        moved = bridge.inside(step[0] - reach * min(1.0, steepness) / steepness * sideways)
        assert kernels.descend(step, slope, reach, bridge.lower, bridge.upper, bridge.circular)
        np.testing.assert_allclose(step[1], moved, rtol=0, atol=1e-13)
    along = np.array([q, delta / length])
    assert not kernels.descend(along, np.zeros(robot.n), 0.1, bridge.lower, bridge.upper, bridge.circular)


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm", "parallel", "gripper"])
def test_an_edge_is_laid_as_its_parts_say(robot_named, name):
    robot = robot_named(name)
    limits, rng = JointLimits(robot), np.random.default_rng(0)
    spread = 0.1 * (robot.upper - robot.lower)
    within = 0
    for _ in range(200):
        start, end = rng.uniform(robot.lower - 0.1 * spread, robot.upper + 0.1 * spread, (2, robot.n))
        edge = np.full((2, len(robot.coupling.offsets)), np.nan)
        found = limits.lay_edge(start, end, edge)
        assert found == (limits.hold(start) and limits.hold(end))
        if found:
            within += 1
            delta = robot.difference(start, end)
            assert np.array_equal(edge, [robot.coupling.values(start), robot.coupling.motions(delta)])
    assert within > 20
    assert not limits.lay_edge(np.full(robot.n, np.nan), end, edge)
    narrow = limits.within(robot.lower + spread, robot.upper - spread)
    middle = (robot.lower + robot.upper) / 2
    assert narrow.lay_edge(middle, middle, edge)
    assert not narrow.lay_edge(middle, robot.upper, edge) or robot.continuous.all()


def test_what_is_suspected_changes_no_proof(panda, clutter):
    """Pairs that blocked motions before are looked at first; another checker, which knows none, decides alike."""
    checker = CollisionChecker(panda, clutter)
    required = np.zeros(len(checker.pairs.names)) + 1e-5
    rng = np.random.default_rng(0)
    blocked = 0
    for _ in range(60):
        start = rng.uniform(panda.lower, panda.upper)
        way = 0.5 * rng.normal(size=panda.n)
        found = checker.pairs.bounds.prove((start, way), required, None, 5e-6)
        fresh = CollisionChecker(panda, clutter).pairs.bounds.prove((start, way), required, None, 5e-6)
        assert found.proven == fresh.proven
        assert found.blocked >= fresh.blocked
        if found.blocked:
            blocked += 1
            assert checker.touches(start + found.at * way)
    assert blocked > 10
