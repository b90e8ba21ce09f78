"""Constraints and the check of a configuration: quick and in words they agree, and both plug-ins read the same."""

from dataclasses import replace

import numpy as np
import pytest
from ompl import base as ob

from safe_ompl import (
    CertifiedMotionValidator,
    CollisionChecker,
    CollisionFreeValidity,
    Constraints,
    TipBounds,
    ToolOrientation,
    Verdict,
)
from safe_ompl.collision import Separation
from safe_ompl.common import UnknownNameError
from safe_ompl.danger import DangerField, DangerLimit
from safe_ompl.geometry import Obstacle, Pose, Sphere
from safe_ompl.paths import ConfigurationCheck
from safe_ompl.planning.ompl import SampledValidity, ScratchState, StateBridge, joint_space
from safe_ompl.scene import Scene

START = np.array([0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
DOWN = (0.0, 0.0, -1.0)


class Setting:
    """A robot beside a ball, with the plug-ins for it."""

    def __init__(self, robot):
        self.robot = robot
        self.scene = Scene((Obstacle("ball", Sphere(0.15), Pose((0.45, 0.1, 0.55)), weight=1.0),))
        self.checker = CollisionChecker(robot, self.scene)
        self.field = DangerField.of_scene(robot, self.scene)
        self.si = ob.SpaceInformation(joint_space(robot))
        self.bridge = StateBridge(self.si.getStateSpace())
        self.scratch = ScratchState(self.bridge)
        self.validity = CollisionFreeValidity(self.si, self.checker)
        self.validator = CertifiedMotionValidator(self.si, self.checker)
        self.si.setStateValidityChecker(self.validity)
        self.si.setMotionValidator(self.validator)
        self.si.setup()
        self.elbow_up = SampledValidity(lambda state: state[2] > 0, self.bridge)

    def constraints(self):
        """Return constraints of every kind, by what they say of themselves."""
        none = Constraints()
        return {
            "is in collision": none,
            "keeps less than 200 mm from": none.with_min_clearance(self.checker, 0.2),
            "may move 200 mm, and come to": none.with_moving_obstacles({"ball": 0.4}, 0.5),
            "is above the limit": replace(none, danger=DangerLimit(self.field, 12.0)),
            "from its direction": replace(none, tool=(ToolOrientation(self.robot, (0, 0, 1), DOWN, 1.0),)),
            "outside of its bounds": replace(none, tool=(TipBounds(self.robot, [-1, -1, 0.2], [1, 1, 1]),)),
            "is refused by your state validity checker": replace(none, user=self.elbow_up),
        }


@pytest.fixture
def setting(ur5):
    return Setting(ur5)


@pytest.mark.parametrize("words", range(7))
def test_quickly_and_in_words_the_answer_is_the_same(setting, rng, words):
    objection, constraints = list(setting.constraints().items())[words]
    check = ConfigurationCheck(setting.checker, constraints)
    setting.validity.setConstraints(constraints)
    said = []
    for q in rng.uniform(setting.robot.lower, setting.robot.upper, (150, 6)):
        said.append(check.objection(q))
        assert check.allows(q) is (said[-1] is None)
        state = setting.scratch.set(q)
        assert check.allows(q, state) is (said[-1] is None)
        assert setting.si.isValid(state) is (said[-1] is None)
    assert None in said
    assert any(objection in words for words in said if words)


def test_joint_limits_are_part_of_the_check(setting):
    check, beyond = ConfigurationCheck(setting.checker, Constraints()), START.copy()
    beyond[2] = 3.5
    assert not check.allows(beyond)
    assert not check.within_limits(beyond)
    assert check.objection(beyond).startswith(": joint 'elbow_joint' = 3.5 is outside its limits [-3.14159,")
    assert not check.allows(np.full(6, np.nan))


def test_motions_keep_to_the_same_constraints(setting, rng):
    for constraints in setting.constraints().values():
        setting.validity.setConstraints(constraints)
        setting.validator.setConstraints(constraints)
        for q in rng.uniform(setting.robot.lower, setting.robot.upper, (40, 6)):
            if setting.validator.motion.check(q, q).verdict is Verdict.FREE:
                assert setting.validity.check.allows(q)


def test_constraints_about_what_there_is_not_are_refused_and_change_nothing(setting):
    before = setting.validity.getConstraints()
    wrong = Constraints(Separation(speeds={"nobody": 1.0}, time=1.0))
    for plugin in (setting.validity, setting.validator):
        motion = setting.validator.motion
        with pytest.raises(UnknownNameError, match="nobody"):
            plugin.setConstraints(wrong)
        assert plugin.getConstraints() == before
        assert setting.validator.motion is motion


def test_a_distance_from_the_dangerous_follows_them_to_another_scene(setting):
    asked = Constraints().with_min_clearance(setting.checker, 0.05)
    other = setting.scene.without("ball").with_obstacles(Obstacle("cat", Sphere(0.1), weight=1.0))
    moved = asked.in_scene_of(CollisionChecker(setting.robot, other))
    assert moved.separation.min_clearance.obstacles == ("cat",)
    empty = moved.in_scene_of(CollisionChecker(setting.robot, Scene()))
    assert empty.separation.min_clearance is None
    assert empty.in_scene_of(setting.checker) == asked
    named = Constraints().with_min_clearance(setting.checker, 0.05, ["ball"])
    assert named.in_scene_of(CollisionChecker(setting.robot, other)) is named


def test_the_validator_does_not_keep_the_users_checks_alive(setting):
    constraints = Constraints(user=SampledValidity(lambda state: True, setting.bridge))
    setting.validator.setConstraints(constraints)
    assert setting.validator.motion.check(START, START).verdict is Verdict.FREE
    del constraints
    with pytest.raises(ReferenceError, match="no longer exists"):
        setting.validator.motion.check(START, START)
