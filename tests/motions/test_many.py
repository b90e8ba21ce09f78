"""Many motions at once: the same is said of each as alone, whatever the number of workers."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import safe_ompl
from safe_ompl import CollisionChecker, Constraints, DangerField, DangerLimit, InputError, MotionProver, RateLimits


def ways(robot, number, seed=0):
    """Return way points (number, 4, n) within the limits."""
    rng = np.random.default_rng(seed)
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    Q = rng.uniform(lower, upper, (number, 1, robot.n))
    return np.clip(Q + np.cumsum(rng.normal(0.0, 0.15, (number, 4, robot.n)), axis=1), lower, upper)


@pytest.mark.parametrize("name", ["panda", "kinova", "twin_arm"])
def test_motions_are_proven_together_as_alone(robot_named, clutter, name):
    robot = robot_named(name)
    Q = ways(robot, 1500)
    starts, ends = Q[:, 0], Q[:, 1]
    motion = MotionProver(CollisionChecker(robot, clutter))
    alone = [motion.is_free(start, end) for start, end in zip(starts, ends, strict=True)]
    assert 200 < sum(alone) < 1300
    for workers in (1, 2):
        assert safe_ompl.prove_many(starts, ends, robot, clutter, workers=workers).tolist() == alone


def test_constraints_are_proven_too(panda, clutter):
    Q = ways(panda, 120)
    field = DangerField(panda, np.array([[0.5, 0.1, 0.5]]))
    wanted = Constraints(danger=DangerLimit(field, float(np.median(field.values(Q[:, 0])))))
    motion = MotionProver(CollisionChecker(panda, clutter), limits=wanted.limits)
    alone = [motion.is_free(way[0], way[1]) for way in Q]
    found = safe_ompl.prove_many(Q[:, 0], Q[:, 1], panda, clutter, constraints=wanted)
    assert found.tolist() == alone
    assert 0 < sum(alone) < safe_ompl.prove_many(Q[:, 0], Q[:, 1], panda, clutter).sum()


def test_no_motion_at_all(panda, clutter):
    none = np.empty((0, panda.n))
    assert safe_ompl.prove_many(none, none, panda, clutter, workers=2).shape == (0,)
    assert safe_ompl.check_many([], panda, clutter, workers=2) == []


@pytest.mark.parametrize("workers", [1, 2])
def test_checks_are_those_of_each_motion_alone(panda, clutter, workers):
    limits = RateLimits.of(panda, acceleration=20.0)
    motions = [*ways(panda, 10), *(CubicSpline([0.0, 1.0, 2.0, 3.0], way) for way in ways(panda, 9, seed=1))]
    found = safe_ompl.check_many(iter(motions), panda, clutter, limits=limits, tube=0.001, workers=workers)
    alone = [safe_ompl.check(motion, panda, clutter, limits=limits, tube=0.001) for motion in motions]
    assert {True, False} == {bool(check) for check in alone}
    assert len({check.proof for check in found}) == 1
    for check, other in zip(found, alone, strict=True):
        assert (str(check), check.claims, repr(check.limits)) == (str(other), other.claims, repr(other.limits))
        np.testing.assert_array_equal(check.motion.coefficients, other.motion.coefficients)
        assert check.proof.checker.scene is clutter
        assert check.separation.tube == other.separation.tube


@pytest.mark.parametrize("workers", [1, 2])
def test_bad_input_is_named(panda, clutter, workers):
    Q = ways(panda, 4)
    with pytest.raises(InputError, match="motion 3: "):
        safe_ompl.check_many([*Q[:3], Q[0][:, :3], *Q[3:]], panda, clutter, workers=workers)
    for starts, ends in ((Q[:, 0], Q[1:, 1]), (Q[:, 0], Q[:, 1, :3]), (Q[:, 0], Q[:, 1] * np.inf)):
        with pytest.raises(InputError, match="motions"):
            safe_ompl.prove_many(starts, ends, panda, clutter, workers=workers)
    for call in (safe_ompl.check_many, lambda Q, *about, **more: safe_ompl.prove_many(Q, Q, *about, **more)):
        with pytest.raises(InputError, match="workers"):
            call(Q[0], panda, clutter, workers=0)
