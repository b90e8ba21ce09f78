"""A Panda beside a shelf and a person, and a path there; what counts as proven; instants at which all must hold."""

import numpy as np
import pytest

from safe_ompl import CollisionChecker, MotionProver
from safe_ompl.motions import SmoothLaw


@pytest.fixture(scope="session")
def shelf_motion(shelf, panda):
    return MotionProver(CollisionChecker(panda, shelf.scene))


@pytest.fixture(scope="session")
def shelf_path(shelf, panda):
    """Return a path that draws the arm in before it passes the person."""
    start, goal = shelf.start_configuration(panda), shelf.goal_configurations(panda)[0]
    return np.array([start, [0.7, -0.6, 0, -2.2, 0, 3.0, 0.785], [-0.7, -0.6, 0, -2.4, 0, 2.6, 0.785], goal])


@pytest.fixture
def free(monkeypatch, shelf_motion):
    """Return a motion whose blends all count as proven."""
    monkeypatch.setattr("safe_ompl.motions.blends.is_free", lambda piece, proof: True)
    return shelf_motion


def instants(law, step=1e-3):
    """Densely, and just before, at and after all instants at which accelerations or jerks may jump."""
    near = [law.knots + side for side in (-1e-9, 0.0, 1e-9)]
    return np.unique(np.clip(np.concatenate([np.arange(0.0, law.duration, step), *near]), 0.0, law.duration))


@pytest.fixture(scope="session")
def assert_within_limits():
    """Return what looks at all rates and velocity limits of a trajectory, at all these instants."""

    def look(trajectory):
        t, kept = instants(trajectory.law), 1 + 1e-9
        state, limits = trajectory.at(t), trajectory.limits
        assert (abs(state.qd) <= limits.velocity * kept).all()
        assert (abs(state.qdd) <= limits.acceleration * kept).all()
        if isinstance(trajectory.law, SmoothLaw):
            assert (abs(trajectory.jerks_at(t)) <= limits.jerk * kept).all()
            changes = abs(np.diff(state.qdd, axis=0))
            assert (changes <= limits.jerk * (1 + 1e-6) * np.diff(t)[:, None] + 1e-7).all()
        if trajectory.velocity_limits:
            cell, _, speed, _ = trajectory.law.at(t)
            assert (
                speed <= np.min([limit.speeds for limit in trajectory.velocity_limits], axis=0)[cell] * kept + 1e-9
            ).all()

    return look
