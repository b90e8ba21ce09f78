"""A Panda that is to swing to and fro, and what else a policy may propose to it."""

from itertools import pairwise

import numpy as np
import pinocchio as pin

from safe_ompl import Pose, Sphere
from safe_ompl.live.replanning import Action
from safe_ompl.live.simulation import ContactMonitor, part_solids

HOME = np.array([-1.0, 0.0, 0.0, -2.0, 0.0, 2.2, 0.785])
SWING = np.array([1.0, 0.3, 0.0, -0.3, 0.0, 0.3, 0.0])
BENDS, VELOCITY, TWIST, SWINGING, NOTHING, JUMPS = (0, 1, 2), 3, 4, 5, 6, 7  # kinds of proposals

JERKS = ([7500, 3750, 5000, 6250, 7500, 10000, 10000], [800] * 7, [100] * 7)  # the first are a Franka's


def drive_shield(shield, propose, ball, seconds, latency=0.02):
    """Propose at each tick, with the ball where `ball` has it; return commands and states (T, 3, n) in between."""
    commands, states = [], []
    for k in range(round(seconds / shield.tick)):
        now = k * shield.tick
        shield.update({}, {"ball": Pose(tuple(ball(now)))}, now)
        here = commands[-1].at(now + latency).q if commands else HOME
        propose(shield, now + latency, here)
        commands.append(shield.command(now + latency))
        times = now + latency + np.arange(5) * shield.tick / 5
        states.append([commands[-1].at(t) for t in times])
    check_commands(shield, shield.limits.joints, commands)
    return commands, np.array(states).reshape(-1, 3, 7)


def drive_replanner(replanner, trajectory, see, seconds, think=True, others=()):
    """Drive with what `see` has at each tick, at most to the end of a trajectory; return the commands."""
    replanner.start(trajectory, others)
    commands = []
    for k in range(round(seconds / replanner.tick)):
        now = k * replanner.tick
        replanner.update(*see(now), now)
        commands.append(replanner.command(now + 0.02))
        if commands[-1].action is Action.DONE:
            break
        if think:
            replanner.think()
    check_commands(replanner, trajectory.limits, commands)
    return commands


def check_commands(pilot, limits, commands):
    """Fail where commands or their stops jump, break limits, touch what stands still, or do not end at rest."""
    smooth = limits.jerk is not None
    step = 0.0025 if smooth else 0.01  # [s]
    for before, after in pairwise(commands):
        jumps = np.abs(np.subtract(before.at(after.time), after.at(after.time)))
        # Accelerations are only continuous if the jerk is limited.
        assert jumps[: 3 if smooth else 2].max() < 1e-6
    for command in {id(command.motion): command for command in commands}.values():
        times = np.arange(command.time, command.standstill + 2 * step, step)
        q, qd, qdd = np.swapaxes([command.at(t) for t in times.tolist()], 0, 1)
        assert (np.abs(qd) <= limits.velocity * (1 + 1e-6)).all()
        assert (np.abs(qdd) <= limits.acceleration * (1 + 1e-6)).all()
        assert pilot.robot.within_limits(q).all()
        assert not any(pilot.prover.checker.in_collision(each) for each in q[:: len(q) // 8 + 1])
        np.testing.assert_array_equal(command.at(np.inf).qd, 0.0)
        # The error of the trapezoidal rule is that of a bounded jerk, or of a bounded acceleration.
        steps = np.abs(np.diff(q, axis=0) - step * (qd[1:] + qd[:-1]) / 2)
        if not smooth:
            assert (steps <= limits.acceleration * step**2).all()
            continue
        assert (steps <= limits.jerk * step**3 / 4 + 1e-9).all()
        assert (np.abs(np.diff(qd, axis=0) - step * (qdd[1:] + qdd[:-1]) / 2) <= limits.jerk * step**2 / 4 + 1e-9).all()
        assert (np.abs(np.diff(qdd, axis=0)) <= limits.jerk * step * (1 + 1e-6) + 1e-7).all()


def check_stops(shield, commands, ball, tube=0.0, lag=0.0):
    """Fail where a ball that grows as fast as it may reaches a moving robot; return at how many instants it moved.

    The ball is where `ball` had it when it was measured. The robot may be at any corner of its tube [rad].
    """
    monitor, moved = ContactMonitor(shield.robot), 0
    for command in commands:
        solids = part_solids("ball", Sphere(0.1), pin.SE3(np.eye(3), np.array(ball(command.measured))))
        for t in np.linspace(command.time, command.standstill, 30).tolist():
            q, qd, _ = command.at(t)
            if np.abs(qd).max() < 1e-6:
                continue
            for off in tube * np.eye(7) if tube else ():  # the nearest corner of the tube, joint by joint
                q = min((q - off, q + off), key=lambda q: monitor.nearest(q, solids).distance)
            assert monitor.nearest(q, solids).distance > 1.6 * (t + lag - command.measured) - 1e-9
            assert not shield.prover.checker.in_collision(q)
            moved += 1
    return moved


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
