"""Claims of clearance, moving obstacles and the tool: as large as what is there, and not larger, whoever says so."""

import re
from fractions import Fraction

import numpy as np
import pytest
from signing import signed, travelled

from safe_ompl import CertificateError, PlanningError, SafeSetup, certificate, verify
from safe_ompl.certificates.claims import ClaimedTool
from safe_ompl.certificates.verifier.bodies import PlainTool
from safe_ompl.certificates.verifier.motion import RecordedPiece, derivatives

PATH = np.array([[0.0, -1.5, 0.5, 0, 0, 0], [0.6, -1.5, 0.5, 0.1, 0, 0]])
T = np.linspace(0.0, 1.0, 300)[:, None]
DENSE = PATH[0] + T * (PATH[1] - PATH[0])


def written(robot, scene, field=None, **claims):
    return travelled(certificate(PATH, robot, scene, claims, field=field))


def moving(speed, time=1.0):
    return {"speeds": {"ball": speed}, "time": time}


def tool(tips, angle, room=0.01):
    places = np.array([tip.translation for tip in tips])
    bounds = np.transpose([places.min(axis=0) - room, places.max(axis=0) + room])
    orientation = {"axis": [0, 0, 1], "direction": tips[0].rotation[:, 2].tolist(), "angle": angle}
    return {"orientation": orientation, "position": dict(zip("xyz", bounds.tolist(), strict=True))}


@pytest.fixture(scope="module")
def least(ur5, clutter, plain_check):
    """Return how near the ball comes to the robot along the path [m]."""
    plain = plain_check(ur5, clutter)
    to_ball = [pair[1] == "ball" for pair in plain.pairs]
    return min(plain.distances(q)[to_ball].min() for q in DENSE)


@pytest.fixture(scope="module")
def tips(ur5):
    return [ur5.tip_pose(q) for q in DENSE]


@pytest.fixture(scope="module")
def tilt(tips):
    """Return how far [rad] the z axis of the tip turns from where it is at the start."""
    return max(np.arccos(tips[0].rotation[:, 2] @ tip.rotation[:, 2]) for tip in tips)


@pytest.fixture(scope="module")
def claimed(least, tips, tilt):
    """Return a function from a factor to claims of each kind, which are true up to 1."""
    ball = {"obstacles": ["ball"]}

    def claims(factor):
        return {
            "clearance": {"clearance": {"distance": factor * least, **ball}},
            "moving obstacles": {"moving_obstacles": moving(2 * factor * least, 0.5)},
            "both": {
                "clearance": {"distance": 0.5 * least, **ball},
                "moving_obstacles": moving((factor - 0.5) * least),
            },
            "orientation": {"tool": {"orientation": tool(tips, tilt / factor)["orientation"]}},
            "position": {"tool": {"position": tool(tips, 1.0, 2e-3 / factor - 2e-3)["position"]}},
        }

    return claims


@pytest.mark.parametrize(
    ("kind", "said", "words"),
    [
        ("clearance", "at least .* mm from ball", "mm are needed"),
        ("moving obstacles", "the same while obstacles move no faster than ball .* m/s, for 0.5 s", "mm are needed"),
        ("both", "at least .* mm from ball", "mm are needed"),
        ("orientation", r"the tool's axis \(0, 0, 1\) within ", "the orientation of the tool is not as claimed near"),
        ("position", "the tip at x from ", "the position of the tool is not as claimed near"),
    ],
)
def test_it_is_proven_up_to_what_is_there(ur5, clutter, claimed, kind, said, words):
    content = written(ur5, clutter, **claimed(0.95)[kind])
    found = verify(content)
    assert re.match(said, found.claims[1])
    assert not set(found.not_claimed) & {kind}
    larger = claimed(1.05)[kind]
    with pytest.raises(PlanningError, match=f"cannot be certified by plain means: .*{words}"):
        written(ur5, clutter, **larger)
    with pytest.raises(CertificateError, match=words):
        verify(signed({**content, "stretches": [{**content["stretches"][0], **larger}]}))
    with pytest.raises(CertificateError, match="digest differs"):
        verify({**content, "stretches": [{**content["stretches"][0], **dict.fromkeys(larger)}]})


@pytest.mark.parametrize("name", ["panda", "kinova", "slider", "twin_arm"])
def test_what_the_verifier_accepts_of_a_tool_holds_at_every_sample(robot_named, rng, name):
    robot, accepted = robot_named(name), 0
    for _ in range(25):
        start = rng.uniform(robot.lower, robot.upper)
        end = np.clip(start + rng.uniform(-0.6, 0.6, robot.n), robot.lower, robot.upper)
        delta = robot.difference(start, end)
        tips = [robot.tip_pose(start + t * delta) for t in T]
        claim = tool(tips[:1], rng.uniform(0.2, 1.2), rng.uniform(0.05, 0.5))
        edge = RecordedPiece("edge", derivatives(np.array([start, delta]), Fraction(1)))
        if PlainTool(robot, ClaimedTool.from_mapping(claim)).exceeded(edge):
            continue
        accepted += 1
        low, high = np.transpose(list(claim["position"].values()))
        for tip in tips:
            cosine = tip.rotation[:, 2] @ claim["orientation"]["direction"]
            assert cosine >= np.cos(claim["orientation"]["angle"]) - 1e-6
            assert (low - 1e-6 <= tip.translation).all()
            assert (tip.translation <= high + 1e-6).all()
    assert 0 < accepted < 25


def test_a_setup_says_what_it_claims(ur5, clutter):
    setup = SafeSetup(ur5, clutter)
    setup.setStartConfiguration(PATH[0])
    setup.setToolConstraint(angle=0.5)
    setup.setTipBounds([-np.inf, -5, -np.inf], [np.inf, 5, 3])
    orientation, position = (limit.as_dict() for limit in setup.getConstraints().tool)
    said = verify(written(ur5, clutter, tool={"orientation": orientation, "position": position})).claims
    assert said[1].endswith("within 28.6479° of the direction (0, 0, 1)")
    assert said[2] == "the tip at y from -5 to 5 m, z of at most 3 m"
