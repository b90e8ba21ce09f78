"""A Panda that is to swing to and fro, and what else a policy may propose to it."""

import numpy as np

HOME = np.array([-1.0, 0.0, 0.0, -2.0, 0.0, 2.2, 0.785])
SWING = np.array([1.0, 0.3, 0.0, -0.3, 0.0, 0.3, 0.0])
BENDS, VELOCITY, TWIST, SWINGING, NOTHING, JUMPS = (0, 1, 2), 3, 4, 5, 6, 7  # kinds of proposals


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
