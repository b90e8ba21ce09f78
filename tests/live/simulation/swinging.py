"""A Panda that is to swing to and fro, and what else a policy may propose to it."""

import numpy as np

from safe_ompl import Pose

HOME = np.array([-1.0, 0.0, 0.0, -2.0, 0.0, 2.2, 0.785])
SWING = np.array([1.0, 0.3, 0.0, -0.3, 0.0, 0.3, 0.0])
BENDS, VELOCITY, TWIST, SWINGING, NOTHING, JUMPS = (0, 1, 2), 3, 4, 5, 6, 7  # kinds of proposals

JERKS = ([7500, 3750, 5000, 6250, 7500, 10000, 10000], [800] * 7, [100] * 7)  # the first are a Franka's


def drive(shield, propose, ball, seconds, latency=0.02):
    """Propose at each tick, with the ball where `ball` has it; return commands and states (T, 3, n) in between.

    Nothing that is driven is beyond the limits, touches what stands still or jumps.
    """
    commands, states = [], []
    for k in range(round(seconds / shield.tick)):
        now = k * shield.tick
        shield.update({}, {"ball": Pose(tuple(ball(now)))}, now)
        here = commands[-1].at(now + latency).q if commands else HOME
        propose(shield, now + latency, here)
        commands.append(shield.command(now + latency))
        times = now + latency + np.arange(5) * shield.tick / 5
        states.append([commands[-1].at(t) for t in times])
    states = np.array(states).reshape(-1, 3, 7)
    limits, robot = shield.limits.joints, shield.robot
    assert (np.abs(states[:, 1]) <= limits.velocity * (1 + 1e-9)).all()
    assert (np.abs(states[:, 2]) <= limits.acceleration * (1 + 1e-6)).all()
    steps = np.diff(states[:, 0], axis=0) - 0.005 * (states[1:, 1] + states[:-1, 1])
    assert np.abs(steps).max() < 0.01**2 * limits.acceleration.max()
    assert not any(shield.prover.checker.in_collision(q) for q in states[::5, 0])
    assert robot.within_limits(states[:, 0]).all()
    return commands, states


def swing(t):
    """Return the positions (…, n) of a smooth motion that begins at rest, at times [s]."""
    return HOME + SWING * 0.9 * (1 - np.cos(0.9 * np.maximum(np.asarray(t), 0.0)))[..., None]


def proposing(rng, kinds):
    """Return what proposes at each tick one of the kinds: chunks that bend or jump, velocities, twists, nothing."""

    def propose(shield, time, here):
        kind, way = rng.choice(kinds), rng.normal(size=7)
        if kind in BENDS:
            bends = np.cumsum(np.cumsum(rng.normal(scale=[0.002, 0.01, 0.05][kind], size=(10, 7)), axis=0), axis=0)
            shield.propose(here + bends, rng.uniform(10.0, 60.0))
        elif kind == VELOCITY:
            shield.propose_velocity(way)
        elif kind == TWIST:
            shield.propose_twist(0.5 * way[:6])
        elif kind == SWINGING:
            shield.propose(swing(time + np.arange(16) / 20) + 2e-3 * rng.normal(size=(16, 7)), 20.0)
        elif kind == JUMPS:
            shield.propose(here + rng.normal(size=(5, 7)), 20.0)

    return propose
