"""Whatever asks for a configuration takes numbers of any kind, and says in one line what is none."""

from dataclasses import replace
from operator import attrgetter
from types import SimpleNamespace

import numpy as np
import pytest

from safe_ompl import CollisionChecker, DangerField, DangerLimit, InputError, MotionProver

Q = np.array([0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.5])
ASKED = [
    *("robot.keypoints", "robot.tip_jacobian", "robot.pinocchio_configuration", "robot.tip_pose"),
    *("robot.bounds.displacement_radii_at", "checker.in_collision", "checker.colliding_pair", "checker.distances"),
    *("checker.pair_distances", "checker.pair_radii_at", "checker.clearance"),
    *("limit.danger", "limit.allows", "field.value", "field.gradient"),
]
MOTIONS = ["motion.is_free", "motion.check", "limit.check"]
NO_CONFIGURATIONS = [
    (np.full(7, np.nan), "must be finite, got"),
    ([0.0] * 6 + [np.inf], "must be finite, got"),
    (np.zeros(6), r"must have shape \(7\), got \(6,\)"),
    (np.zeros((7, 1)), r"must have shape \(7\), got \(7, 1\)"),
    (np.zeros((1, 7)), r"must have shape \(7\), got \(1, 7\)"),
    (None, "must be|must have"),
    (3, "must have shape|must be"),
    ("abc", "must be numbers|.*unknown group state"),
    (["a"] * 7, "must be numbers, got"),
]


@pytest.fixture(scope="module")
def about(panda, clutter):
    checker, field = CollisionChecker(panda, clutter), DangerField(panda, [[0.9, 0.4, 0.6]])
    limit = DangerLimit(field, 1e9)
    return SimpleNamespace(robot=panda, checker=checker, field=field, limit=limit, motion=MotionProver(checker))


@pytest.mark.parametrize(
    ("name", "ask", "what"),
    [
        *((name, lambda ask, q: ask(q), "configuration") for name in ASKED),
        *((name, lambda ask, q: ask(q, Q), "start of a motion") for name in MOTIONS),
        *((name, lambda ask, q: ask(Q, q), "end of a motion") for name in MOTIONS),
    ],
)
def test_what_is_a_configuration(about, name, ask, what):
    method = attrgetter(name)(about)
    expected = ask(method, Q)
    for form in (Q.tolist(), tuple(Q.tolist()), Q.astype(np.float32), np.stack([Q, Q], axis=1)[:, 0]):
        np.testing.assert_equal(ask(method, form), expected)
    counted = replace(about.checker.counts)
    # Numbers in an array of floats are not looked at on the way to Pinocchio.
    for bad, message in NO_CONFIGURATIONS[name == "robot.pinocchio_configuration" :]:
        with pytest.raises(InputError, match=f"{what}: ({message})|^motion between .* is not finite"):
            ask(method, bad)
    assert about.checker.counts == counted, "what is refused is not asked"
