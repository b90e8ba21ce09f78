"""The shield: proposals are followed in time where that is proven, and what is executed is proven at every instant."""

import re

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from swinging import (
    BENDS,
    HOME,
    JERKS,
    JUMPS,
    NOTHING,
    SWING,
    TWIST,
    VELOCITY,
    check_stops,
    drive_shield,
    proposing,
    swing,
)

from safe_ompl import CollisionChecker, InputError, Motion, MotionProver, Pose, RateLimits, Shield, Surroundings
from safe_ompl.collision import Separation
from safe_ompl.live.replanning import Action, ReplanningOptions, SpeedLimits

FAR = (3.0, 0.0, 0.0)
RATE, CHUNK = 20.0, 16


def from_path(states, seconds):
    """Return how far the robot is from the path of `swing` in so many seconds, at most [rad]."""
    path = swing(np.linspace(0, seconds, 4001))
    return max(np.abs(path - q).max(axis=1).min() for q in states[:, 0])


def chunks(motion=swing, noise=0.0, seed=0):
    """Return what proposes the motion as a chunk from now on, with noise that begins at 0."""
    rng = np.random.default_rng(seed)

    def propose(shield, time, here):
        positions = motion(time - 0.02 + np.arange(CHUNK) / RATE)
        shield.propose(positions + noise * rng.normal(size=positions.shape), RATE)

    return propose


def once(motion, start=None):
    """Return what proposes a motion in time at the first tick."""
    return lambda shield, time, _: time < 0.03 and shield.propose(motion, start=start)


@pytest.mark.parametrize(("jerk", "within"), [(None, 1e-5), *((jerk, 2e-3) for jerk in JERKS)])
def test_a_proposal_that_nobody_bars_is_driven_as_it_is(shield_for, jerk, within):
    commands, states = drive_shield(shield_for(jerk=jerk), chunks(), lambda t: FAR, 3.0)
    times = np.arange(len(states)) * 0.01
    np.testing.assert_allclose(states[:, 0], swing(times), atol=within)
    assert {command.action for command in commands} == {Action.MOVING}
    assert all(command.follows and command.delay < 1e-9 and not command.reason for command in commands)
    np.testing.assert_allclose(states[:, 1], np.gradient(states[:, 0], 0.01, axis=0), atol=0.02)


TIMES = np.linspace(0, 2, 9)
SPLINE = CubicSpline(TIMES, swing(TIMES), bc_type="clamped")
DENSE = np.arange(2000) / 1000.0


@pytest.mark.parametrize(
    ("motion", "start", "within"),
    [(SPLINE, None, 2e-3), (Motion.of(SPLINE), None, 2e-3)]
    + [(Motion.hermite(DENSE[::k], swing(DENSE[::k])), 0.52, 1e-3) for k in (1, 20)],
)
def test_a_motion_is_driven_in_its_own_timing_to_its_end(shield_for, motion, start, within):
    commands, states = drive_shield(shield_for(), once(motion, start), lambda t: FAR, 2.8)
    begin = 0.0 if start is None else 0.5
    known = SPLINE if start is None else swing
    np.testing.assert_allclose(states[:195, 0], known(np.maximum(np.arange(195) * 0.01 - begin, 0.0)), atol=within)
    assert commands[-1].action is Action.DONE
    assert max(command.delay for command in commands[:39]) < 1e-6 or start is None
    np.testing.assert_allclose(states[-1, 0], known(2.0 if start is None else motion.times[-1]), atol=1e-9)


@pytest.mark.parametrize(
    ("speed", "place", "reason"), [(1, (0.75, 0.0, 0.5), "ball"), (3, FAR, "limits of the joints")]
)
def test_what_cannot_be_driven_in_time_is_driven_later_on_the_same_path(shield_for, speed, place, reason):
    """Beside a ball that leaves after 3 s, and beyond the limits of accelerations."""

    def ball(time):
        return place + np.array([0.0, 0.0, 1.5 * max(time - 3.0, 0.0)])

    times = np.arange(80 // speed + 1) / 20
    commands, states = drive_shield(shield_for(), once(Motion.hermite(times, swing(speed * times))), ball, 6.0)
    assert any(command.action is Action.SLOWED and reason in command.reason for command in commands)
    assert max(command.delay for command in commands) > 0.05
    assert from_path(states, 4.5) < 2e-3
    assert commands[-1].action is Action.DONE


def wild(seed):
    """Return what proposes something else at each tick."""
    return proposing(np.random.default_rng(seed), [*BENDS, VELOCITY, TWIST, JUMPS, NOTHING])


@pytest.mark.parametrize(("seed", "tube", "lag"), [(0, 0.0, 0.0), (1, 0.02, 0.0), (0, 0.0, 0.05)])
@pytest.mark.parametrize("policy", [wild, lambda seed: chunks(noise=2e-3, seed=seed)])
def test_no_stop_is_reached_by_who_keeps_to_the_bound(shield_for, policy, seed, tube, lag):
    rng = np.random.default_rng(seed)
    shield = shield_for(tube, lag=lag)
    middle, way = np.array([0.75, 0.0, 0.5]), rng.normal(size=3)
    way *= 0.25 / np.linalg.norm(way)

    def ball(time):
        return middle + way * np.sin(5 * time)

    commands, _ = drive_shield(shield, policy(seed), ball, 5.0)
    some = rng.permutation(np.array(commands, dtype=object))[:30]
    assert check_stops(shield, some, ball, tube, lag) > 100
    assert {Action.MOVING, Action.SLOWED} <= {command.action for command in commands}


BAD = {  # what becomes of a chunk (16, 7), and how it is refused
    "chunk": lambda positions: np.where(np.arange(7) == 3, np.nan, positions),
    "jumps at 0.2 s of it: joint 'panda_joint1' by": lambda positions: np.vstack([positions[:5], positions[5:] + 0.5]),
    "jumps from where the robot is": lambda positions: positions + 0.5,
    r"got \(16, 6\)": lambda positions: positions[:, :6],
    "at least two positions": lambda positions: positions[:1],
    "too late": lambda positions: positions,
}


@pytest.mark.parametrize("why", BAD)
def test_a_chunk_that_cannot_be_used_ends_in_the_proven_stop(shield_for, why):
    shield = shield_for()
    commands, _ = drive_shield(shield, chunks(), lambda t: FAR, 1.0)
    good = commands[-1]
    for k in range(20, 32):
        now = 0.05 * k
        shield.update({}, {"ball": Pose(FAR)}, now)
        positions = swing(now - 0.02 + np.arange(CHUNK) / RATE)
        shield.propose(BAD[why](positions), RATE, start=now - 1.0 if why == "too late" else None)
        command = shield.command(now + 0.02)
        assert not command.follows
        assert re.search(why, command.reason)
        np.testing.assert_array_equal(command.at(now + 0.03).q, good.at(now + 0.03).q)
    assert command.action is Action.STANDING
    shield.update({}, {"ball": Pose(FAR)}, 1.7)
    shield.propose(command.at(2.0).q + np.linspace(0, 0.1, 8)[:, None] * SWING, RATE)
    assert shield.command(1.7).follows


@pytest.mark.parametrize(
    ("joint", "tilt", "reason"),
    [
        (3, None, "joint 'panda_joint4' leaves its limits before "),
        (1, None, "not proven free of collision before .* s: panda_.* and table"),
        (5, 0.5, "the limit of tool orientation is not proven to hold before "),
    ],
)
def test_it_stops_on_the_path_before_what_is_not_proven(shield_for, joint, tilt, reason):
    motion = Motion.through([HOME, HOME + 3 * np.eye(7)[joint]], [0.0, 2.5])
    commands, states = drive_shield(shield_for(tilt=tilt), once(motion), lambda t: FAR, 2.5)
    assert commands[-1].action is Action.STANDING
    assert re.search(reason, commands[-1].reason)
    assert np.abs(states[-1, 0] - HOME).max() > 0.3


@pytest.mark.parametrize("jerk", [None, JERKS[1]])
def test_a_velocity_is_approached_held_and_left(shield_for, jerk):
    target = np.array([0.5, -0.1, 0.2, 0.0, 0.3, 0.0, -0.4])

    def propose(shield, time, here):
        if time < 1.0:
            shield.propose_velocity(target)

    commands, states = drive_shield(shield_for(jerk=jerk), propose, lambda t: FAR, 2.0)
    np.testing.assert_allclose(states[50:95, 1], np.tile(target, (45, 1)), atol=1e-9)
    assert {command.action for command in commands[4:18]} == {Action.MOVING}
    assert commands[-1].action is Action.DONE
    np.testing.assert_array_equal(states[-1, 1], 0)


def test_a_velocity_that_could_not_be_driven_is_not_driven_later(shield_for):
    shield = shield_for()
    reasons = []
    for k in range(10):
        shield.update({}, {"ball": Pose((0.35, -0.45, 0.6) if k < 5 else FAR)}, 0.05 * k)
        if k == 0:
            shield.propose_velocity(0.5 * SWING)
        command = shield.command(0.05 * k)
        reasons.append(command.reason)
        assert command.action is Action.STANDING
    assert re.fullmatch(r"'ball' may come [1-9]\d* mm too near to \w+ before the robot stops", reasons[0])
    assert set(reasons[1:]) == {"no new velocity was proposed"}


def test_a_twist_moves_the_tip(shield_for, panda):
    shield, twist = shield_for(), np.array([0.0, 0.2, 0.1, 0.0, 0.0, 0.3])
    _, states = drive_shield(shield, lambda shield, t, _: shield.propose_twist(twist), lambda t: FAR, 1.0)
    found = panda.tip_jacobian(states[60, 0]) @ states[60, 1]
    np.testing.assert_allclose(found, twist, atol=0.03)
    shield.propose_twist([1.0, np.nan, 0, 0, 0, 0])
    shield.update({}, {"ball": Pose(FAR)}, 1.05)
    assert not shield.command(1.06).follows


def test_what_cannot_be_is_refused(shield_for, panda, table):
    shield = shield_for()
    assert shield.command(0.0).reason == "nothing was proposed"
    with pytest.raises(InputError, match="time must not go backwards"):
        shield.command(-1.0)
    with pytest.raises(InputError, match="joint 'panda_joint4' = 0 is outside its limits"):
        shield.start(np.zeros(7))
    commands, _ = drive_shield(shield_for(), chunks(), lambda t: FAR, 0.5)
    assert commands[-1].action is Action.MOVING
    with pytest.raises(InputError, match="start where the robot stands first"):
        Shield(panda, Surroundings(table)).command(0.0)
    wide = MotionProver(CollisionChecker(panda, table), separation=Separation(tube=(0.01,) * 7))
    fast = SpeedLimits(RateLimits.of(panda), tool_speed=1.0)
    with pytest.raises(InputError, match="tube: bounds positions"):
        Shield(panda, Surroundings(table), options=ReplanningOptions(limits=fast), prover=wide)
