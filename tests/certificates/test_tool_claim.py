"""The claim that the tool keeps to its limits: proven when it is issued, and not to be faked."""

import copy
import json

import numpy as np
import pytest
from signing import signed

from safe_ompl import CertificateError, PlanningError, SafeSetup, certificate, verify
from safe_ompl.certificates.claims import Tool
from safe_ompl.certificates.verifier.bodies import PlainTool, Stretch

PATH = np.array([[0.0, -1.5, 0.5, 0, 0, 0], [0.6, -1.5, 0.5, 0.1, 0, 0]])
T = np.linspace(0.0, 1.0, 500)[:, None]


@pytest.fixture(scope="module")
def tips(ur5):
    return [ur5.tip_pose(q) for q in PATH[0] + T * (PATH[1] - PATH[0])]


@pytest.fixture(scope="module")
def tilt(tips):
    """Return how far [rad] the z axis of the tip turns from where it is at the start."""
    return max(np.arccos(tips[0].rotation[:, 2] @ tip.rotation[:, 2]) for tip in tips)


def claim(tips, angle, room=0.01):
    places = np.array([tip.translation for tip in tips])
    bounds = np.transpose([places.min(axis=0) - room, places.max(axis=0) + room])
    orientation = {"axis": [0, 0, 1], "direction": tips[0].rotation[:, 2].tolist(), "angle": angle}
    return {"orientation": orientation, "position": dict(zip("xyz", bounds.tolist(), strict=True))}


def written(robot, scene, tool):
    return json.loads(json.dumps(certificate(PATH, robot, scene, {"tool": tool})))


def test_it_is_proven_up_to_the_angle_that_is_reached(ur5, clutter, tips, tilt):
    found = verify(written(ur5, clutter, claim(tips, 1.01 * tilt)))
    assert found.not_claimed == ("clearance", "danger", "moving obstacles", "tube")
    assert found.claims[1].startswith("the tool's axis (0, 0, 1) within ")
    assert found.claims[2].startswith("the tip at x from ")
    with pytest.raises(PlanningError, match="the orientation of the tool is not as claimed near"):
        written(ur5, clutter, claim(tips, 0.99 * tilt))
    with pytest.raises(PlanningError, match="the position of the tool is not as claimed near"):
        written(ur5, clutter, claim(tips, 1.01 * tilt, room=-1e-4))


def test_another_limit_in_the_file_is_refused(ur5, clutter, tips, tilt):
    content = written(ur5, clutter, claim(tips, 1.01 * tilt))
    tampered = copy.deepcopy(content)
    tampered["tool"]["orientation"]["angle"] = 0.99 * tilt
    with pytest.raises(
        CertificateError, match="piece 0 of the motion: the orientation of the tool is not as claimed near"
    ):
        verify(signed(tampered))
    tampered = copy.deepcopy(content)
    tampered["tool"]["position"]["y"][0] += 0.02
    with pytest.raises(
        CertificateError, match="piece 0 of the motion: the position of the tool is not as claimed near"
    ):
        verify(signed(tampered))
    with pytest.raises(CertificateError, match="digest differs"):
        verify({key: value for key, value in content.items() if key != "tool"})


@pytest.mark.parametrize("name", ["panda", "kinova", "slider", "twin_arm"])
def test_what_the_verifier_accepts_holds_at_every_sample(robot_named, rng, name):
    robot, accepted = robot_named(name), 0
    for _ in range(25):
        start = rng.uniform(robot.lower, robot.upper)
        end = np.clip(start + rng.uniform(-0.6, 0.6, robot.n), robot.lower, robot.upper)
        delta = robot.difference(start, end)
        tips = [robot.tip_pose(start + t * delta) for t in T]
        tool = claim(tips[:1], rng.uniform(0.2, 1.2), rng.uniform(0.05, 0.5))
        stretch = Stretch("edge", np.array([start, start + delta]))
        if PlainTool(robot, Tool.from_mapping(tool)).exceeded(stretch) is None:
            accepted += 1
            for tip in tips:
                cosine = tip.rotation[:, 2] @ tool["orientation"]["direction"]
                assert cosine >= np.cos(tool["orientation"]["angle"]) - 1e-6
                bounds = tool["position"].values()
                assert all(
                    low - 1e-6 <= x <= high + 1e-6 for x, (low, high) in zip(tip.translation, bounds, strict=True)
                )
    assert 0 < accepted < 25


def test_a_setup_says_what_it_claims(ur5, clutter):
    setup = SafeSetup(ur5, clutter)
    setup.setStartConfiguration(PATH[0])
    setup.setToolConstraint(angle=0.5)
    setup.setTipBounds([-np.inf, -5, -np.inf], [np.inf, 5, 3])
    orientation, position = (limit.as_dict() for limit in setup.getConstraints().tool)
    content = written(ur5, clutter, {"orientation": orientation, "position": position})
    assert verify(content).claims[2] == "the tip at y from -5 to 5 m, z of at most 3 m"
    assert verify(content).claims[1].endswith("within 28.6479° of the direction (0, 0, 1)")
