"""The claim that a path stays free while obstacles move: proven for `setMovingObstacles`, and not to be faked."""

import json

import numpy as np
import pytest
from signing import signed

from safe_ompl import CollisionChecker, DangerField, MotionProver, Obstacle, Pose
from safe_ompl.certificates import certificate, verify
from safe_ompl.collision import Separation
from safe_ompl.common import CertificateError, PlanningError

PATH = np.array([[0.0, -1.5, 0.5, 0, 0, 0], [0.6, -1.5, 0.5, 0, 0, 0]])


@pytest.fixture(scope="module")
def nearest(ur5, clutter, plain_check):
    """Return how near each obstacle comes to the robot along the path [m], by name."""
    plain = plain_check(ur5, clutter)
    dense = np.array([plain.distances(q) for q in PATH[0] + np.linspace(0, 1, 200)[:, None] * (PATH[1] - PATH[0])])
    return {name: dense[:, [pair[1] == name for pair in plain.pairs]].min() for name in clutter.names}


def written(ur5, clutter, speed, time, field=None, **claims):
    moving = {"speeds": {"ball": speed}, "time": time}
    return json.loads(json.dumps(certificate(PATH, ur5, clutter, {"moving_obstacles": moving, **claims}, field=field)))


def test_it_is_proven_up_to_how_far_the_obstacle_is(ur5, clutter, nearest):
    content = written(ur5, clutter, 0.95 * nearest["ball"] / 0.5, 0.5)
    found = verify(content)
    assert found.claims[1].startswith("the same while obstacles move no faster than ball ")
    assert found.claims[1].endswith(" m/s, for 0.5 s")
    assert found.not_claimed == ("clearance", "danger", "tool", "tube")
    with pytest.raises(PlanningError, match="cannot be certified"):
        written(ur5, clutter, 1.05 * nearest["ball"] / 0.5, 0.5)


def test_what_it_claims_is_what_the_motion_validator_proves(ur5, clutter, nearest):
    motion = MotionProver(CollisionChecker(ur5, clutter))
    for share, free in ((0.95, True), (1.05, False)):
        moving = motion.with_separation(Separation(speeds={"ball": share * nearest["ball"] / 2.0}, time=2.0))
        assert moving.is_free(*PATH) is free


def test_wherever_the_obstacle_goes_the_path_is_free(ur5, clutter, nearest, plain_check):
    reach = 0.95 * nearest["ball"]
    verify(written(ur5, clutter, reach, 1.0))
    ball, rng = clutter["ball"], np.random.default_rng(0)
    for _ in range(20):
        way = rng.normal(size=3)
        place = np.array(ball.pose.position) + reach * way / np.linalg.norm(way)
        moved = clutter.without("ball").with_obstacles(Obstacle("ball", ball.shape, Pose(tuple(place))))
        plain = plain_check(ur5, moved)
        assert all(plain.nearest(PATH[0] + t * (PATH[1] - PATH[0])) > 0 for t in np.linspace(0, 1, 10))


def test_clearance_is_kept_while_they_move(ur5, clutter, nearest):
    clear = {"distance": 0.5 * nearest["ball"], "obstacles": ["ball"]}
    assert len(verify(written(ur5, clutter, 0.4 * nearest["ball"], 1.0, clearance=clear)).claims) == 4
    with pytest.raises(PlanningError, match="cannot be certified"):
        written(ur5, clutter, 0.6 * nearest["ball"], 1.0, clearance=clear)


@pytest.mark.parametrize(("key", "factor"), [("speeds", 2.0), ("time", 2.0)])
def test_a_claim_that_was_made_larger(ur5, clutter, nearest, key, factor):
    content = written(ur5, clutter, 0.7 * nearest["ball"], 1.0)
    claim = content["moving_obstacles"]
    claim[key] = factor * claim[key] if key == "time" else {"ball": factor * claim[key]["ball"]}
    with pytest.raises(CertificateError, match=r"of piece 0 of the motion, .* mm are needed"):
        verify(signed(content), ur5, clutter)


def test_another_obstacle_is_not_proven(ur5, clutter, nearest):
    content = written(ur5, clutter, 0.5 * nearest["ball"], 1.0)
    other = min(set(nearest) - {"ball"}, key=nearest.__getitem__)
    content["moving_obstacles"]["speeds"][other] = 1.05 * nearest[other]
    with pytest.raises(CertificateError, match="mm are needed"):
        verify(signed(content), ur5, clutter)


def test_the_danger_is_said_to_be_that_of_the_scene(ur5, clutter):
    ball = clutter["ball"]
    scene = clutter.without("ball").with_obstacles(Obstacle("ball", ball.shape, ball.pose, weight=1.0))
    points, weights, _ = scene.danger_points(0.1)
    content = written(ur5, scene, 0.01, 0.1, field=DangerField(ur5, points, weights), spacing=0.1)
    assert "points 0.1 m apart where the scene has them" in verify(content, ur5, scene).claims[1]
