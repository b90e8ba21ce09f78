"""Limits of the tool along whole motions, held against dense samples."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from edges import random_edge

from safe_ompl import InputError, TipBounds, ToolOrientation, Verdict

ROBOTS = ["panda", "ur5", "kinova", "slider", "twin_arm", "parallel"]
UP = [0.0, 0.0, 1.0]


def plain_angle(robot, q, axis, direction):
    """Return the angle by Pinocchio alone, from the cosine."""
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, robot.pinocchio_configuration(q))
    turned = data.oMf[robot.tip_frame].rotation @ np.array(axis) / np.linalg.norm(axis)
    return np.arccos(np.clip(turned @ np.array(direction) / np.linalg.norm(direction), -1.0, 1.0))


def test_the_angle_is_that_between_axis_and_direction(ur5, rng):
    limit = ToolOrientation(ur5, [0.0, 3.0, 4.0], [1.0, 1.0, 0.0], 1.0)
    for q in rng.uniform(-2.0, 2.0, (20, ur5.n)):
        wanted = plain_angle(ur5, q, [0.0, 3.0, 4.0], [1.0, 1.0, 0.0])
        assert limit.angle(q) == pytest.approx(wanted, abs=1e-7)
        assert limit.allows(q) == (wanted <= 1.0)


def limit_of_angle(robot, start, rng):
    axis, direction = rng.normal(size=(2, 3))
    if rng.random() < 0.3:
        return ToolOrientation(robot, axis, direction, 1.5)
    return ToolOrientation(robot, robot.tip_pose(start).rotation.T @ direction, direction, rng.uniform(0.1, 1.0))


def limit_of_position(robot, start, rng):
    tip = robot.tip_pose(start).translation
    return TipBounds(robot, tip - rng.uniform(0.01, 0.6, 3), tip + rng.uniform(0.01, 0.6, 3))


def excess(limit, q):
    """Return by how much a limit is passed [rad or m]."""
    if isinstance(limit, ToolOrientation):
        return limit.angle(q) - limit.limit
    tip = limit.robot.tip_pose(q).translation
    return max((limit.lower - tip).max(), (tip - limit.upper).max())


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize(
    ("made", "pair"),
    [(limit_of_angle, ("tool orientation", "its limit")), (limit_of_position, ("tip position", "its limit"))],
)
def test_what_is_proven_holds_at_every_sample(robot_named, rng, name, made, pair):
    robot, seen = robot_named(name), set()
    for seed in range(12):
        start, end = random_edge(robot, seed, 0.8)
        limit, delta = made(robot, start, rng), robot.difference(start, end)
        verdict = limit.check(start, end)
        seen.add(verdict.verdict)
        if verdict.verdict is Verdict.FREE:
            assert max(excess(limit, start + t * delta) for t in np.linspace(0.0, 1.0, 51)) <= 0.0
        else:
            assert verdict.verdict is Verdict.BLOCKED, "no motion at random is as near to its limit as the floor"
            assert excess(limit, start + verdict.at * delta) > 0.0
            assert verdict.pair == pair
        steps = rng.uniform(0.0, 0.1, robot.n)
        corners = start + steps * rng.choice([-1.0, 1.0], (20, robot.n))
        assert not limit.holds_within(start, steps) or max(excess(limit, q) for q in corners) <= 0.0
        assert limit.holds_within(start, 0.0 * steps) == (excess(limit, start) < 0.0)
    assert seen == {Verdict.FREE, Verdict.BLOCKED}


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("axis", [UP, [1.0, 0.0, 0.0], [0.3, -0.5, 0.8]])
def test_the_rates_bound_how_fast_the_axis_turns(robot_named, rng, name, axis):
    robot, step = robot_named(name), 1e-6
    limit = ToolOrientation(robot, axis, UP, 1.0)
    for q in rng.uniform(robot.lower, robot.upper, (30, robot.n)):
        before = robot.tip_pose(q).rotation @ limit.axis
        for i in range(robot.n):
            after = robot.tip_pose(q + step * np.eye(robot.n)[i]).rotation @ limit.axis
            assert np.linalg.norm(after - before) <= step * limit.rates[i] + 1e-12


def test_a_wrist_that_turns_about_the_axis_costs_nothing(panda):
    limit = ToolOrientation(panda, UP, UP, 1.0)
    assert limit.rates[-1] < 1e-6
    assert ToolOrientation(panda, [1.0, 0.0, 0.0], UP, 1.0).rates.tolist() == [1.0] * 7
    q = np.array([0.1, 0.2, 0.3, -1.5, 0.4, 1.6, -2.8])
    limit = ToolOrientation(panda, [0, 0, 1], panda.tip_pose(q).rotation[:, 2], 0.01)
    assert limit.check(q, [*q[:-1], 2.8]).verdict is Verdict.FREE


def test_mimic_joints_count_with_their_multipliers(robot_named):
    robot = robot_named("parallel")
    rates = ToolOrientation(robot, [1.0, 0.0, 0.0], UP, 1.0).rates
    assert rates[robot.joint_names.index("elbow")] == pytest.approx(3.0)


def test_a_motion_at_the_limit_is_undecided(ur5):
    q = np.array([0.5, -1.2, 1.2, -1.0, -1.57, 0.0])
    limit = ToolOrientation(ur5, UP, [0.0, 1.0, 0.0], 1.0)
    limit = ToolOrientation(ur5, UP, [0.0, 1.0, 0.0], limit.angle(q) + 5e-10)
    assert limit.allows(q)
    verdict = limit.check(q, q + 0.5 * np.eye(6)[5])  # turns about the axis: the angle stays what it is
    assert verdict.verdict is Verdict.UNDECIDED
    assert 0.0 <= verdict.at <= 1.0


def test_walls_may_be_missing(ur5):
    limit = TipBounds(ur5, [-np.inf, -np.inf, 0.0], [np.inf, np.inf, np.inf])
    q = np.array([0.5, -1.2, 1.2, -1.0, -1.57, 0.0])
    assert limit.excess(q) == pytest.approx(-ur5.tip_pose(q).translation[2])
    assert limit.check(q, q + 0.05).verdict is Verdict.FREE


NO_LIMITS = [
    (ToolOrientation, ([0, 0, 0], UP, 0.5), "axis of the tool must be a vector that is not zero, got"),
    (ToolOrientation, (UP, [0, 0], 0.5), r"direction of the tool: must have shape \(3\), got \(2,\)"),
    (ToolOrientation, (UP, [0, 0, np.nan], 0.5), "direction of the tool: must be finite"),
    (ToolOrientation, (UP, UP, 0.0), r"angle of the tool: must be a finite angle \[rad\] in \(0, 3.1415"),
    (ToolOrientation, (UP, UP, 30.0), "angle of the tool: must be"),
    (TipBounds, ([0, 0, 1], [1, 1, 1]), "the lower corner must be below the upper one"),
    (TipBounds, ([0, 0], [1, 1, 1]), "lower corner: must have shape"),
    (TipBounds, ([0, 0, 0], [1, 1, np.nan]), "upper corner must be 3 numbers"),
]


@pytest.mark.parametrize(("kind", "given", "words"), NO_LIMITS)
def test_what_is_no_limit_is_refused(ur5, kind, given, words):
    with pytest.raises(InputError, match=words):
        kind(ur5, *given)
