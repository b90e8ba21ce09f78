"""Whoever sets a state validity checker has it obeyed, by all who plan, judge and simplify."""

import json

import numpy as np
import pytest
from ball import GOAL, START, densely, setup_for
from ompl import base as ob

from safe_ompl import CollisionError, InputError, Verdict
from safe_ompl.planning.ompl import SampledValidity
from safe_ompl.robot import StateBridge

UP = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
HIGH = START + 0.3 * UP
LIFTED = -1.45  # the ball is easily passed above it: the checker forbids that


def low_only(state):
    return bool(state[1] < LIFTED)


class LowOnly(ob.StateValidityChecker):
    def isValid(self, state):
        return low_only(state)


class Anything(ob.MotionValidator):
    def checkMotion(self, start, end):
        return True


@pytest.fixture
def setup(ur5):
    return setup_for(ur5)


def highest(setup, path):
    return densely(setup.robot, path)[:, 1].max()


@pytest.mark.parametrize("as_object", [False, True])
@pytest.mark.parametrize("danger", [{}, None])
def test_a_checker_is_obeyed_and_named(ur5, as_object, danger):
    setup = setup_for(ur5, danger=danger)
    setup.setStateValidityChecker(LowOnly(setup.getSpaceInformation()) if as_object else low_only)
    result = setup.plan(seed=0, time=20.0, simplify=True)
    assert not np.array_equal(result.path, result.planned_path)
    assert max(highest(setup, path) for path in (result.planned_path, result.path)) < LIFTED + 0.01
    name = "LowOnly" if as_object else "low_only"
    assert str(result).splitlines()[-1] == f"certified: no collision; sampled at 0.01 rad: your checker {name}"
    told = json.loads(json.dumps(result.as_dict()))["validation"]
    assert told["proven"] is True
    assert told["checks"] == [{"name": name, "resolution": 0.01, "passed": True}]


def test_a_report_says_who_refuses_and_where(setup):
    free = setup.is_free([START, HIGH])
    assert (bool(free), free.why) == (True, "")
    blocked = setup.is_free([START, START * [0.9, 1, 1, 1, 1, 1], GOAL])
    assert not blocked
    assert blocked.refused[0] == 1
    assert "edge 1 is blocked" in blocked.why
    assert "'ball'" in blocked.why
    setup.setStateValidityChecker(low_only)
    found = setup.report([START, HIGH])
    assert not found.certified
    assert found.validation.proven
    edge, verdict = found.refused
    assert (edge, verdict.verdict, verdict.pair[0]) == (0, Verdict.BLOCKED, "low_only")
    assert verdict.at == pytest.approx(0.5, abs=0.04)


def test_start_and_goal_are_asked_about(setup):
    setup.setStateValidityChecker(low_only)
    refused = "is refused by your state validity checker low_only"
    with pytest.raises(CollisionError, match=f"goal {refused}"):
        setup.setConfigurations(START, HIGH)
    with pytest.raises(CollisionError, match=f"start {refused}"):
        setup.setStartConfiguration(HIGH)
    setup.setStateValidityChecker(None)
    setup.setConfigurations(START, HIGH)
    with pytest.raises(CollisionError, match=f"goal {refused}"):
        setup.setStateValidityChecker(low_only)
    assert setup.getConstraints().user is None, "it stays what it was"


def test_motions_are_sampled_with_both_ends(setup):
    asked = []

    def count(state):
        asked.append(state[1])
        return True

    setup.setStateValidityChecker(count, resolution=0.05)
    asked.clear()
    assert setup.report([START, START + 0.1 * UP]).validation.checks[0].resolution == 0.05
    np.testing.assert_allclose(asked, START[1] + np.array([0.0, 0.05, 0.1]))
    asked.clear()
    check = SampledValidity(count, StateBridge(setup.getStateSpace()), 0.3)
    assert check.check(np.zeros(6), UP).verdict is Verdict.FREE
    np.testing.assert_allclose(asked, [0, 0.25, 0.5, 0.75, 1])


def test_plugins_on_the_space_information_are_refused(setup):
    si = setup.getSpaceInformation()
    for put, plugin in ((si.setStateValidityChecker, low_only), (si.setMotionValidator, Anything(si))):
        put(plugin)
        for run in (setup.plan, setup.solve, setup.setup):
            with pytest.raises(InputError, match=r"give yours to SafeSetup\.setStateValidityChecker"):
                run()
        si.setStateValidityChecker(setup.validity)
    si.setMotionValidator(setup.validator)
    assert setup.plan(time=20.0)
