"""Certificates and bounds of the danger hold for robots of every make: mimics, loads, mobile bases, cells."""

import numpy as np
import pytest

from safe_ompl import CertificateError, CollisionChecker, MotionProver, Robot, Scene
from safe_ompl.certificates import certificate, verify
from safe_ompl.certificates.issue import terms_of_field
from safe_ompl.danger import CertifiedDanger, DangerField
from safe_ompl.geometry import Box, Capsule, Obstacle, Pose, Sphere

SCENE = Scene(
    (
        Obstacle("ball", Sphere(0.1), Pose((0.9, 0.6, 0.6)), 1.0),
        Obstacle("box", Box((0.1, 0.4, 0.2)), Pose((-0.8, -0.4, 0.5))),
    )
)


def danger_of(robot):
    points, weights, _ = SCENE.danger_points(SCENE.spacing)
    return DangerField(robot, points, weights)


def mimicking(panda, ur5, data_folder):
    return Robot.from_urdf(data_folder / "gripper_arm.urdf", tip="finger_2")


def loaded(panda, ur5, data_folder):
    return panda.with_attached("rod", Capsule(0.03, 0.3), pose=(0.0, 0.0, 0.2), danger=True)


def mobile(panda, ur5, data_folder):
    return Robot.from_example("ur5", mobile_base=((-0.2, 0.2), (-0.2, 0.2)))


def cell(panda, ur5, data_folder):
    return Robot.combined("cell", {"a": panda.with_base((0.0, 0.8, 0.0)), "b": ur5.with_base((0.0, -0.8, 0.0))})


@pytest.fixture(scope="module", params=[mimicking, loaded, mobile, cell])
def robot(request, panda, ur5, data_folder):
    return request.param(panda, ur5, data_folder)


@pytest.fixture(scope="module")
def free_edges(robot):
    """Three short motions that are proven free."""
    rng, proof, found = np.random.default_rng(1), MotionProver(CollisionChecker(robot, SCENE)), []
    while len(found) < 3:
        start, end = rng.uniform(robot.lower, robot.upper, (2, robot.n))
        end = start + 0.15 * (end - start)
        if proof.is_free(start, end):
            found.append((start, end))
    return found


def test_certificates_verify(robot, free_edges):
    for edge in free_edges:
        content = certificate(edge, robot, SCENE, field=danger_of(robot))
        verify(content, robot, SCENE, terms=terms_of_field(danger_of(robot), SCENE.spacing))


def test_a_certificate_of_a_robot_without_its_load_is_refused(robot, free_edges):
    if not robot.attached:
        robot = robot.with_attached("ball", Sphere(0.01))
    less = robot.without_attached(robot.attached[-1].name)
    with pytest.raises(CertificateError, match="the robot has changed"):
        verify(certificate(free_edges[0], less, SCENE), robot, SCENE)


def test_no_danger_exceeds_its_bound(robot, free_edges):
    field = danger_of(robot)
    for start, end in free_edges:
        bounds = CertifiedDanger(field).of_path([start, end])
        samples = field.values(start + np.linspace(0.0, 1.0, 300)[:, None] * (end - start))
        assert samples.max() <= bounds.upper * (1 + 1e-9)
        assert bounds.upper <= 1.06 * bounds.lower
