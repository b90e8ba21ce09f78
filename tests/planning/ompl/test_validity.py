"""States and motions as OMPL asks for them: free, within limits, and within the same constraints."""

from dataclasses import replace

import numpy as np
import pytest
from ball import BALL, START
from ompl import base as ob

from safe_ompl import CertifiedMotionValidator, CollisionFreeValidity, Constraints
from safe_ompl.collision import CollisionChecker, Separation, TipBounds, ToolOrientation, Verdict
from safe_ompl.common import Counts, UnknownNameError
from safe_ompl.danger import DangerField, DangerLimit
from safe_ompl.motions import ConfigurationCheck
from safe_ompl.planning.ompl import SampledValidity, bridge_of
from safe_ompl.robot import ScratchState, StateBridge, joint_space

DOWN = (0.0, 0.0, -1.0)


class Setting:
    """A space information with our plug-ins for a robot among obstacles."""

    def __init__(self, robot, scene):
        self.robot, self.scene = robot, scene
        self.checker = CollisionChecker(robot, scene)
        self.si = ob.SpaceInformation(joint_space(robot))
        self.bridge = StateBridge(self.si.getStateSpace())
        self.ends = ScratchState(self.bridge), ScratchState(self.bridge)
        self.validity = CollisionFreeValidity(self.si, self.checker)
        self.validator = CertifiedMotionValidator(self.si, self.checker)
        self.si.setStateValidityChecker(self.validity)
        self.si.setMotionValidator(self.validator)
        self.si.setup()

    def is_valid(self, q):
        return self.si.isValid(self.ends[0].set(np.asarray(q, dtype=float)))

    def check(self, start, end):
        return self.si.checkMotion(self.ends[0].set(start), self.ends[1].set(end))

    def drawn(self, rng, count):
        return rng.uniform(self.robot.lower, self.robot.upper, (count, self.robot.n))

    def free(self, rng):
        return next(q for q in self.drawn(rng, 500) if not self.checker.in_collision(q))

    def constraints(self):
        """Return constraints of every kind, by what they say of themselves."""
        none, elbow_up = Constraints(), SampledValidity(lambda state: state[2] > 0, self.bridge)
        danger = DangerLimit(DangerField.of_scene(self.robot, self.scene), 12.0)
        return {
            "is in collision": none,
            "keeps less than 200 mm from": none.with_min_clearance(self.checker, 0.2),
            "may move 200 mm, and come to": none.with_separation(speeds={"ball": 0.4}, time=0.5),
            "is above the limit": replace(none, danger=danger),
            "from its direction": replace(none, tool=(ToolOrientation(self.robot, (0, 0, 1), DOWN, 1.0),)),
            "outside of its bounds": replace(none, tool=(TipBounds(self.robot, [-1, -1, 0.2], [1, 1, 1]),)),
            "is refused by your state validity checker": replace(none, user=elbow_up),
        }


@pytest.fixture(scope="module", params=["ur5", "kinova", "twin_arm"])
def setting(request, robot_named, clutter):
    return Setting(robot_named(request.param), clutter)


@pytest.fixture
def beside_ball(ur5):
    return Setting(ur5, BALL)


def test_valid_is_free_of_collision(setting, plain_check, clutter, rng):
    plain, answers = plain_check(setting.robot, clutter), set()
    for q in setting.drawn(rng, 80):
        nearest = plain.nearest(q)
        if abs(nearest) > 3e-5:
            assert setting.is_valid(q) is (nearest > 0)
            answers.add(nearest > 0)
            turns = 2 * np.pi * setting.robot.continuous
            assert setting.is_valid(q + turns) is (nearest > 0)
    assert answers == {True, False}


def test_what_is_not_finite_or_outside_the_limits_is_refused_without_a_query(setting, rng):
    robot, q = setting.robot, setting.free(rng)
    assert setting.is_valid(q) is True
    setting.checker.counts.reset()
    for i in range(robot.n):
        for bad in (np.nan, np.inf, -np.inf):
            state = setting.ends[0].set(q)
            setting.si.getStateSpace().copyFromReals(state, [*q[:i], bad, *q[i + 1 :]])  # the bridge would wrap it
            assert setting.si.isValid(state) is False
    for i in np.flatnonzero(~robot.continuous):
        for value in (robot.lower[i] - 1e-3, robot.upper[i] + 1e-3, np.nan):
            beyond = q.copy()
            beyond[i] = value
            assert setting.is_valid(beyond) is False
            assert setting.check(q, beyond) is False
            assert setting.check(beyond, q) is False
    assert setting.checker.counts == Counts()


def test_the_checkers_bridge_is_taken_while_the_bounds_of_the_space_are_the_same(beside_ball):
    si, bridge = beside_ball.si, beside_ball.validity.bridge
    assert bridge_of(si) is bridge
    bounds = ob.RealVectorBounds(bridge.n)
    bounds.setLow(-1.0)
    bounds.setHigh(1.0)
    si.getStateSpace().setBounds(bounds)
    changed = bridge_of(si)
    assert changed is not bridge
    np.testing.assert_array_equal([changed.lower, changed.upper], [[-1.0] * bridge.n, [1.0] * bridge.n])


def test_clearance_is_the_distance_to_the_obstacles(setting, rng):
    q = setting.free(rng)
    expected = setting.checker.clearance(q).distance
    assert setting.validity.clearance(setting.ends[0].set(q)) == pytest.approx(expected)
    assert setting.si.getStateValidityChecker().clearance(setting.ends[0].set(q)) == pytest.approx(expected)
    assert expected > 0


def test_motions_are_those_of_the_certified_check(setting, rng):
    answers = set()
    for start in setting.drawn(rng, 60):
        end = setting.bridge.inside(start + 0.3 * rng.normal(size=setting.robot.n))
        answer = setting.check(start, end)
        assert answer is (setting.validator.motion.check(start, end).verdict is Verdict.FREE)
        answers.add(answer)
    assert answers == {True, False}


# ------------------------------------------------------------------------------------------------------- constraints


@pytest.mark.parametrize("words", range(7))
def test_quickly_in_words_and_of_many_at_once_the_answer_is_the_same(beside_ball, rng, words):
    setting = beside_ball
    refusal, constraints = list(setting.constraints().items())[words]
    check = ConfigurationCheck(setting.checker, constraints)
    setting.validity.setConstraints(constraints)
    setting.validator.setConstraints(constraints)
    Q, robot, said = setting.drawn(rng, 150), setting.robot, []
    for q in Q:
        said.append(check.refusal(q))
        allowed = said[-1] is None
        assert check.allows(q) is allowed
        assert check.allows(q, setting.ends[0].set(q)) is allowed
        assert setting.is_valid(q) is allowed
        if allowed is False:
            assert setting.validator.motion.check(q, q).verdict is not Verdict.FREE
    assert None in said
    assert any(refusal in words for words in said if words)
    # Of many at once, the same are allowed as one by one, and none outside the limits.
    many = np.vstack([Q, robot.upper + 1e-3, np.full(robot.n, np.nan)])
    np.testing.assert_array_equal(list(check.allowed(many)), [q for q, words in zip(Q, said, strict=True) if not words])


def test_constraints_about_what_there_is_not_are_refused_and_change_nothing(beside_ball):
    motion, before = beside_ball.validator.motion, beside_ball.validity.getConstraints()
    wrong = Constraints(Separation(speeds={"nobody": 1.0}, time=1.0))
    for plugin in (beside_ball.validity, beside_ball.validator):
        with pytest.raises(UnknownNameError, match="nobody"):
            plugin.setConstraints(wrong)
        assert plugin.getConstraints() == before
    assert beside_ball.validator.motion is motion


def test_the_validator_does_not_keep_the_users_checker_alive(beside_ball):
    constraints = Constraints(user=SampledValidity(lambda state: True, beside_ball.bridge))
    beside_ball.validator.setConstraints(constraints)
    assert beside_ball.validator.motion.check(START, START).verdict is Verdict.FREE
    del constraints
    with pytest.raises(ReferenceError):
        beside_ball.validator.motion.check(START, START)
