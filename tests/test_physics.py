"""The robot of examples/mujoco is the one that is planned for: the same kinematics, inertias and shapes."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import Box, Obstacle, Pose, Robot, Scene, Sphere, plan_program
from safe_ompl.live.simulation import ContactMonitor, Solid

mujoco = pytest.importorskip("mujoco", reason="needs mujoco")
from bench.programs import Replay  # noqa: E402
from examples.mujoco.servo_robot import STEP, BodyPart, Servo, ServoRobot  # noqa: E402

POST = Obstacle("post", Box((0.1, 0.1, 0.6)), Pose((0.5, 0.3, 0.3)))


@pytest.fixture(scope="module", params=["panda", "ur5"])
def robot(request):
    return Robot.from_example(request.param)


def placed(robot, q, *obstacles, **servo):
    return ServoRobot(robot, Scene(obstacles), q, Servo(**servo))


def test_links_inertias_and_distances_are_those_of_the_planner(robot):
    rng, model = np.random.default_rng(0), robot.shared.model
    data, monitor = model.createData(), ContactMonitor(robot)
    (_, shape, place), *_ = POST.geometries()
    post = [Solid("post", "", shape, place)]
    for _ in range(5):
        q = rng.uniform(robot.lower, robot.upper)
        body = placed(robot, q, POST, payload=0.0, armature=0.0)
        full = robot.pinocchio_configuration(q)
        pin.forwardKinematics(model, data, full)
        for k in range(1, model.njoints):
            np.testing.assert_allclose(body.data.body(model.names[k]).xpos, data.oMi[k].translation, atol=1e-9)
        inertia = np.zeros((robot.n, robot.n))
        mujoco.mj_fullM(body.model, body.data, inertia)
        np.testing.assert_allclose(np.triu(inertia), np.triu(pin.crba(model, data, full)), atol=1e-9)
        distance = monitor.nearest(q, post).distance
        if distance > 1e-3:
            assert body.distance(2.0) == pytest.approx(distance, abs=1e-4)


def test_the_servo_holds_what_it_knows_and_sags_under_what_it_does_not(robot):
    q = np.array([0.3, -1.0, 1.2, -1.5, 0.5, 1.0, 0.2][: robot.n])
    for payload in (0.0, 2.0):
        body = placed(robot, q, payload=payload, friction=0.0)
        for _ in range(1000):
            found = body.step(q, np.zeros(robot.n))
        sag = np.abs(found - q).max()
        assert (1e-4 < sag < 0.1) if payload else sag < 1e-9


def test_set_points_count_after_the_delay(robot):
    start = np.array([0.3, -1.0, 1.2, -1.5, 0.5, 1.0, 0.2][: robot.n])
    body = placed(robot, start, delay=0.005, payload=0.0, friction=0.0)
    moved = [np.abs(body.step(start + 0.1, np.zeros(robot.n)) - start).max() > 1e-9 for _ in range(8)]
    assert moved == [False] * 5 + [True] * 3
    assert body.data.time == pytest.approx(8 * STEP)


def test_a_part_of_a_body_that_is_hit_feels_what_a_spring_and_a_mass_do():
    """A robot that is much heavier than the part, and drives on, is a wall: F = v√(mK)."""
    robot, rate, mass, stiffness = Robot.from_example("panda"), 0.4, 0.3, 2000.0
    q, turn = np.array([0, 0.3, 0, -1.8, 0, 2.1, 0.785]), np.eye(7)[0]
    tip = robot.tip_pose(q).translation
    ways = np.array([-tip[1], tip[0], 0.0]) / np.hypot(*tip[:2])
    part = BodyPart(tip + 0.08 * ways, ways, mass, stiffness)
    servo = Servo(payload=0.0, friction=0.0, delay=0.0)
    body, forces = ServoRobot(robot, Scene(()), q, servo, part), [0.0]
    for k in range(600):
        body.step(q + rate * k * STEP * turn, rate * turn)
        forces.append(body.force)
    assert max(forces) == pytest.approx(rate * float(np.hypot(*tip[:2])) * np.sqrt(mass * stiffness), rel=0.2)


def test_a_program_that_is_driven_meets_only_what_is_put_in_its_way():
    found = plan_program("xarm7_inspection")
    assert not Replay(found).run().contacts
    robot, scenario = found.stretches[0].robot, found.scenario
    place = robot.tip_pose(found.stretches[0].motion.at(0.9 * found.stretches[0].motion.duration)).translation
    scene = scenario.scene.with_obstacles(Obstacle("ball", Sphere(0.03), Pose(tuple(place))))
    hit = Replay(replace(found, scenario=replace(scenario, scene=scene), stretches=found.stretches[:1])).run()
    assert (1, "ball", "link7") in hit.contacts
