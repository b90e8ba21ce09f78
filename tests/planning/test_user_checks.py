"""Whoever sets a checker or a motion validator has it obeyed, by all who plan, judge and simplify."""

import json
import logging
from itertools import pairwise

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import CertifiedMotionValidator, CollisionFreeValidity, SafePRM, SafeSetup, Scene
from safe_ompl.collision import CollisionChecker, Verdict
from safe_ompl.common import CollisionError, InputError
from safe_ompl.geometry import Obstacle, Pose, Sphere
from safe_ompl.planning.ompl import SampledValidity, StateBridge

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
GOAL = START * [-1, 1, 1, 1, 1, 1]
UP = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
LIFTED = -1.45  # the ball is easily passed above it: the checker forbids that


def low_only(state):
    return bool(state[1] < LIFTED)


class LowOnly(ob.StateValidityChecker):
    def isValid(self, state):
        return low_only(state)


class LowMotions(ob.MotionValidator):
    """Forbids motions that end where `low_only` forbids states."""

    def checkMotion(self, start, end):
        return low_only(start) and low_only(end)


@pytest.fixture
def setup(ur5):
    scene = Scene((Obstacle("ball", Sphere(0.15), Pose((0.45, 0.1, 0.55)), weight=1.0),))
    setup = SafeSetup(ur5, scene)
    setup.setConfigurations(START, GOAL)
    return setup


def densely(path):
    return np.concatenate([a + np.linspace(0, 1, 100)[:, None] * (b - a) for a, b in pairwise(path)])


def function_on_setup(setup):
    setup.setStateValidityChecker(low_only)


def object_on_setup(setup):
    setup.setStateValidityChecker(LowOnly(setup.getSpaceInformation()))


def function_on_si(setup):
    setup.getSpaceInformation().setStateValidityChecker(low_only)


def object_on_si(setup):
    setup.getSpaceInformation().setStateValidityChecker(LowOnly(setup.getSpaceInformation()))


DOORS = [function_on_setup, object_on_setup, function_on_si, object_on_si]


def test_without_it_paths_go_where_it_forbids(setup):
    paths = [setup.plan(seed=seed, time=20.0).path for seed in range(3)]
    assert max(densely(path)[:, 1].max() for path in paths) > LIFTED + 0.05


@pytest.mark.parametrize("door", DOORS)
def test_a_checker_is_obeyed_and_named(setup, door):
    door(setup)
    for seed in range(1):
        result = setup.plan(seed=seed, time=20.0)
        assert result
        assert densely(result.path)[:, 1].max() < LIFTED + 0.01
        assert result.report.certified
    (check,) = result.report.checks
    assert (check.resolution, check.passed) == (0.01, True)
    if "object" in door.__name__:
        assert str(result).splitlines()[-1] == "certified: collision; sampled at 0.01 rad: your checker LowOnly"
    told = json.loads(json.dumps(result.as_dict()))["validation"]
    assert told["proven"] is True
    assert told["checks"][0]["resolution"] == 0.01


@pytest.mark.parametrize("planner", ["SafePRM", "BubblePlanner", "RRTConnect", "BITstar"])
def test_all_planners_obey_it(setup, planner):
    setup.setStateValidityChecker(low_only)
    result = setup.plan(planner, time=20.0 if planner != "BITstar" else 1.0, seed=1)
    assert result or planner == "BITstar"
    if result:
        assert densely(result.path)[:, 1].max() < LIFTED + 0.01


def test_planners_run_by_hand_obey_it(setup):
    function_on_si(setup)
    setup.setPlanner(SafePRM(setup.getSpaceInformation()))
    assert setup.solve(20.0)
    assert densely(setup.solution())[:, 1].max() < LIFTED + 0.01


@pytest.mark.parametrize("options", [{"simplify": True}, {"optimise": 1.0}])
def test_simplification_obeys_it(setup, options):
    setup.setStateValidityChecker(low_only)
    result = setup.plan(seed=0, time=20.0, **options)
    assert result.report.certified
    assert densely(result.path)[:, 1].max() < LIFTED + 0.01


def test_without_danger_simplification_obeys_it(setup, ur5):
    plain = SafeSetup(ur5, setup.scene, danger=None)
    plain.setConfigurations(START, GOAL)
    plain.setStateValidityChecker(low_only)
    result = plain.plan(seed=0, time=20.0, simplify=True)
    assert densely(result.path)[:, 1].max() < LIFTED + 0.01


def test_places_of_the_tip_obey_it(setup):
    setup.setStateValidityChecker(low_only)
    setup.setWorkspaceGoal(setup.robot.tip_pose(GOAL).translation)
    for _ in range(4):
        state = setup.getStateSpace().allocState()
        assert setup.getGoal().maxSampleCount()
        setup.getGoal().sampleGoal(state)
        assert state[1] < LIFTED


def test_a_report_says_whose_check_refuses(setup):
    free = setup.is_free([START, START + 0.3 * UP])
    assert free
    assert free.why == ""
    setup.setStateValidityChecker(low_only)
    found = setup.report([START, START + 0.3 * UP])
    assert not found.certified
    assert found.validation.proven
    edge, verdict = found.refused
    assert (edge, verdict.verdict, verdict.pair[0]) == (0, Verdict.BLOCKED, "low_only")
    assert verdict.at == pytest.approx(0.5, abs=0.04)
    assert not setup.is_free([START, START + 0.3 * UP])


def test_is_free_names_the_edge_and_the_pair(setup):
    verdict = setup.is_free([START, START * [0.9, 1, 1, 1, 1, 1], GOAL])
    assert not verdict
    assert verdict.refused[0] == 1
    assert "edge 1 is blocked" in verdict.why
    assert "'ball'" in verdict.why


def test_start_and_goal_are_asked_about(setup):
    high = START + 0.3 * UP
    setup.setStateValidityChecker(low_only)
    with pytest.raises(CollisionError, match="goal is refused by your state validity checker low_only"):
        setup.setConfigurations(START, high)
    setup.setStateValidityChecker(None)
    function_on_si(setup)
    with pytest.raises(CollisionError, match="start is refused by your state validity checker"):
        setup.setStartConfiguration(high)
    setup.setStateValidityChecker(None)
    setup.setConfigurations(START, high)
    with pytest.raises(CollisionError, match="goal is refused by your state validity checker"):
        setup.setStateValidityChecker(low_only)
    assert setup.user_checks == (), "it stays what it was"


def test_a_start_that_a_checker_on_the_si_refuses_is_named(setup, caplog):
    setup.getSpaceInformation().setStateValidityChecker(lambda state: False)
    with caplog.at_level(logging.WARNING):
        assert setup.plan(time=1.0).status == "Invalid start"
    assert "start is refused by your state validity checker" in caplog.text


def test_the_resolution_is_chosen(setup):
    asked = []

    def count(state):
        asked.append(state[1])
        return True

    setup.setStateValidityChecker(count)
    setup.setSamplingResolution(0.05)
    assert setup.getSamplingResolution() == 0.05
    asked.clear()
    assert setup.report([START, START + 0.1 * UP]).checks[0].resolution == 0.05
    np.testing.assert_allclose(asked, START[1] + np.array([0.0, 0.05, 0.1]))
    with pytest.raises(InputError, match="resolution must be a positive distance"):
        setup.setSamplingResolution(0.0)


@pytest.mark.parametrize("answer", [None, 1, "yes"])
def test_an_answer_that_is_none(setup, answer):
    with pytest.raises(InputError, match="must return a bool"):
        setup.setStateValidityChecker(lambda state: answer)


def test_what_is_no_checker(setup):
    with pytest.raises(InputError, match=r"must be an ob.StateValidityChecker or a function of a state, got 5"):
        setup.setStateValidityChecker(5)


def test_what_a_checker_raises_arrives(setup):
    def broken(state):
        if abs(state[0] - START[0]) > 1e-9:
            raise LookupError("the user's own")
        return True

    setup.getSpaceInformation().setStateValidityChecker(broken)
    with pytest.raises(LookupError, match="the user's own"):
        setup.plan()


def test_motions_are_sampled_with_both_ends(setup):
    seen = []

    def record(state):
        seen.append(state[0])
        return True

    check = SampledValidity(record, StateBridge(setup.getStateSpace()), 0.3)
    assert check.check(np.zeros(6), np.eye(6)[0]).verdict is Verdict.FREE
    np.testing.assert_allclose(seen, [0, 0.25, 0.5, 0.75, 1])


# ------------------------------------------------------------------------------------------------- motion validators


@pytest.mark.parametrize("options", [{}, {"simplify": True}])
def test_a_motion_validator_is_obeyed_and_named(setup, options):
    setup.getSpaceInformation().setMotionValidator(LowMotions(setup.getSpaceInformation()))
    result = setup.plan(seed=0, time=20.0, **options)
    assert result.report.certified
    assert result.path[:, 1].max() < LIFTED
    assert str(result.report.validation) == "certified: collision; asked: your motion validator LowMotions"


def test_a_motion_validator_does_not_replace_the_proof(setup):
    class Anything(ob.MotionValidator):
        def checkMotion(self, start, end):
            return True

    setup.getSpaceInformation().setMotionValidator(Anything(setup.getSpaceInformation()))
    through = setup.report([START, GOAL])
    assert not through.certified
    assert not through.validation.proven
    assert through.checks[0].passed
    result = setup.plan(seed=0, time=20.0)
    assert result.report.validation.proven


def test_the_packages_own_plugins_add_nothing(setup):
    si = setup.getSpaceInformation()
    setup.setStateValidityChecker(low_only)
    si.setMotionValidator(LowMotions(si))
    assert [check.name for check in setup.report([START, START]).checks] == ["low_only", "LowMotions"]
    setup.setStateValidityChecker(CollisionFreeValidity(si, setup.checker))
    si.setMotionValidator(CertifiedMotionValidator(si, setup.checker))
    assert setup.report([START, START]).checks == ()
    assert setup.user_checks == ()
    si.setStateValidityChecker(CollisionFreeValidity(si, CollisionChecker(setup.robot, setup.scene)))
    assert [check.name for check in setup.report([START, START]).checks] == ["CollisionFreeValidity"]
