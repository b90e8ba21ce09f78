"""What becomes of a proposal that lies against how the robot moves: it brakes, and goes no farther than that takes."""

from functools import cache

import numpy as np
import pytest
from hypothesis import Phase, given, settings, strategies as st

from safe_ompl import RateLimits, Robot, Scene, Shield, Surroundings
from safe_ompl.live.replanning import ReplanningOptions, SpeedLimits
from safe_ompl.live.replanning.bounded_path import averaging_window

ACCELERATION = 5.0
OTHERS = dict.fromkeys(("shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"), 0.0)


@cache
def robot_of(n):
    """Return an SO-101 of 5 joints, or of 1 where the others are locked."""
    return Robot.from_example("so101", locked=OTHERS if n == 1 else {})


def shield_of(n, rate, jerk):
    """Return a shield of joints of 2 rad/s and 5 rad/s² alone in the world, at a rate of commands [Hz]."""
    robot = robot_of(n)
    jerks = None if jerk is None else [jerk] * n
    limits = RateLimits.of(robot, velocity=[2.0] * n, acceleration=[ACCELERATION] * n, jerk=jerks)
    shield = Shield(
        robot, Surroundings(Scene(())), options=ReplanningOptions(tick=1 / rate, limits=SpeedLimits(limits))
    )
    shield.start(np.zeros(n))
    return shield


def states(shield, begin, ticks, propose):
    """Return q and q̇ (2, T, n) of so many ticks from time `begin` on; `propose` is called with the time of each."""
    found = []
    for k in range(ticks):
        now = begin + k * shield.tick
        shield.update({}, {}, now)
        propose(now)
        command = shield.command(now)
        found += [command.at(now + share * shield.tick)[:2] for share in (0.5, 1.0)]
    return np.swapaxes(found, 0, 1)


def braking(speed, tick):
    """Return how far a joint goes from when it is told to stop until it stands: v²/2a, and what it does in a tick."""
    return speed**2 / (2 * ACCELERATION) + speed * tick


@pytest.mark.parametrize("n", [1, 5])
@pytest.mark.parametrize(
    ("rate", "known", "jerk"), [(60, 2, None), (100, 2, None), (50, 10, None), (30, 10, 500.0), (50, 3, 500.0)]
)
def test_a_joint_that_is_to_go_and_hold_goes_there_and_holds(n, rate, known, jerk):
    """At 15°/s to 50°: positions one tick apart, some of them known; the robot went on to 100° where n = 5."""
    shield, pan = shield_of(n, rate, jerk), np.eye(n)[0]

    def propose(now):
        ahead = now + np.arange(1, known + 1) / rate
        shield.propose(np.minimum(np.radians(15) * ahead, np.radians(50))[:, None] * pan, rate, start=ahead[0])

    q, qd = states(shield, 0.0, round(4.5 * rate), propose)
    assert q[:, 0].max() - np.radians(50) <= braking(qd[:, 0].max(), 1 / rate)
    np.testing.assert_allclose(q[-1], np.radians(50) * pan, atol=1e-4)
    np.testing.assert_array_equal(q[:, 1:], 0.0)


@settings(max_examples=40, deadline=None, phases=(Phase.explicit, Phase.generate))
@given(
    n=st.sampled_from([1, 5]),
    rate=st.sampled_from([20, 60, 125]),
    known=st.integers(2, 12),
    lead=st.floats(0.0, 1.0),
    seed=st.integers(0, 2**31),
)
def test_whatever_it_does_it_goes_no_farther_than_it_needs_to_brake(n, rate, known, lead, seed):
    """A robot that moves is told to hold somewhere near, and leaves the box between no farther than it must."""
    rng = np.random.default_rng(seed)
    shield = shield_of(n, rate, None)
    velocity = rng.uniform(-1, 1, n) * rng.choice([0.01, 0.1, 0.5])
    states(shield, 0.0, rate // 2, lambda now: shield.propose_velocity(velocity))
    now = shield.tick * (rate // 2)
    q0, qd0, _ = shield.command(now).at(now)
    hold = q0 + rng.uniform(-1, 1, n) * rng.choice([0.0, 1e-3, 1e-2]) / rate * 20
    chunk = np.tile(hold, (known, 1))
    q, qd = states(shield, now, rate, lambda now: shield.propose(chunk, rate, start=now + lead * shield.tick))
    # All joints stop together, and so go as far as the one takes that brakes longest. Behind where it began the robot
    # only brakes; behind the place that it holds it does so from what it has reached on the way.
    # Twice what one hard braking takes is allowed: the curve to the place that is held turns first.
    late = shield.tick + averaging_window(shield.limits.joints)
    fast = np.maximum(np.abs(qd0), np.abs(qd).max(axis=0))
    behind, beyond = (2 * s * (s.max() / (2 * ACCELERATION) + late) + 1e-6 for s in (np.abs(qd0), fast))
    up = hold >= q0
    assert (q.max(axis=0) <= np.maximum(q0, hold) + np.where(up, beyond, behind)).all()
    assert (q.min(axis=0) >= np.minimum(q0, hold) - np.where(up, behind, beyond)).all()
    np.testing.assert_allclose(q[-1], hold, atol=5e-3)


@pytest.mark.parametrize("jerk", [None, 500.0])
@pytest.mark.parametrize("huge", [1e2, 1e6, 1e300])
def test_a_velocity_that_no_joint_can_have_is_followed_as_one_of_twice_the_limits(jerk, huge):
    """Its curve would have cells in proportion, and a command took seconds, or did not end."""
    driven = []
    for speed in (huge, 4.0):
        shield = shield_of(5, 50, jerk)
        driven.append(states(shield, 0.0, 12, lambda now, s=shield, v=speed: s.propose_velocity([v, 0, 0, 0, -v / 2])))
    np.testing.assert_allclose(driven[0][0], driven[1][0], atol=1e-9)
    assert driven[0][0][-1, 0] > 1e-3
