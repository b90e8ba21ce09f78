"""The robot: loading, self pairs, kinematics, and errors that say what would be right."""

import logging
import xml.etree.ElementTree as ElementTree

import coal
import numpy as np
import pinocchio as pin
import pytest
from self_pairs import self_pairs

from safe_ompl import InputError, Robot, Sphere, UnknownNameError
from safe_ompl.geometry import DISTANCE_ERROR
from safe_ompl.robot import EXAMPLES, JointLimits, find_example, robots_folder
from safe_ompl.robot.collision import always_in_contact, sample_configurations

JOINTS = {"panda": 7, "ur3": 6, "ur5": 6, "ur10": 6, "xarm7": 7, "kinova": 6, "z1": 6, "so101": 5}


@pytest.mark.parametrize("name", sorted(EXAMPLES))
def test_every_example_robot_can_be_planned_for(robot_named, name):
    robot = robot_named(name)
    assert robot.n == len(robot.joint_names) == JOINTS[name]
    assert (robot.lower < robot.upper).all()
    assert robot.tip == EXAMPLES[name].tip
    assert len(robot.segments) == len(robot.segment_names) >= 4
    for body in robot.collision_model.geometryObjects:
        assert not isinstance(body.geometry, coal.BVHModelBase), "meshes become convex hulls"
    data, contacts = robot.model.createData(), pin.GeometryData(robot.collision_model)
    free = [
        not pin.computeCollisions(robot.model, data, robot.collision_model, contacts, q, True)
        for q in sample_configurations(robot.model)[:80]
    ]
    assert np.mean(free) > 0.3, "no pair of links is always in contact"


def test_kinds_of_joints_and_links(kinova, twin_arm, panda):
    assert panda.joint_names == tuple(f"panda_joint{k}" for k in range(1, 8))
    assert (panda.lower[3], panda.upper[3]) == pytest.approx((-3.0718, -0.0698))
    moved = ("panda_joint3", "panda_joint4", "panda_joint5", "panda_joint7", "panda_hand_tcp")
    assert panda.segment_names == moved, "zero-length links, at joints 2 and 6, are left out"
    assert kinova.continuous.tolist() == [True, False, False, True, False, True]
    assert kinova.lower[kinova.continuous] == pytest.approx(-np.pi)
    assert " ".join(twin_arm.joint_names) == "lift left_shoulder left_elbow right_shoulder right_slide right_turn"
    assert twin_arm.prismatic.tolist() == [True, False, False, False, True, False]
    assert twin_arm.continuous.tolist() == [False, True, False, False, False, False]


def test_a_sliding_joint_makes_a_link_even_if_its_length_can_be_zero(twin_arm):
    assert "right_slide" in twin_arm.segment_names
    shoulder, slide = twin_arm.segments[twin_arm.segment_names.index("right_slide")]
    q = np.zeros(6)
    q[twin_arm.joint_names.index("right_slide")] = 0.3
    points = twin_arm.keypoints(q)
    assert np.linalg.norm(points[slide] - points[shoulder]) == pytest.approx(0.3)


def test_continuous_joints_go_the_short_way(kinova):
    start, end = np.full(6, 3.0), np.full(6, -3.0)
    delta = kinova.difference(start.tolist(), end.tolist())
    np.testing.assert_allclose(delta[kinova.continuous], 2 * np.pi - 6)
    np.testing.assert_allclose(delta[~kinova.continuous], -6)
    batch = kinova.difference(np.stack([start, end]), end)
    np.testing.assert_allclose(batch, [delta, np.zeros(6)])
    np.testing.assert_array_equal(start, 3.0)


def test_srdf_removes_exactly_the_pairs_that_it_names(panda):
    srdf = ElementTree.parse(robots_folder() / find_example("panda").srdf)
    disabled = {frozenset((tag.get("link1"), tag.get("link2"))) for tag in srdf.iter("disable_collisions")}
    bodies = list(panda.collision_model.geometryObjects)
    kept = {
        frozenset((a.name, b.name))
        for a in bodies
        for b in bodies
        if a.parentJoint != b.parentJoint
        and frozenset((a.name.rsplit("_", 1)[0], b.name.rsplit("_", 1)[0])) not in disabled
    }
    assert self_pairs(panda) == kept
    assert len(kept) == 44


DEFAULTS = """<robot name="gripper_arm">
  <disable_default_collisions link="hand"/><disable_default_collisions link="finger_1"/>
  <disable_collisions link1="base" link2="upper" reason="Adjacent"/>
  <disable_collisions link1="base" link2="hand" reason="Never"/>
  <enable_collisions link1="hand" link2="upper"/><enable_collisions link1="base" link2="hand"/>
</robot>"""


def test_srdf_says_what_is_off_by_default_and_on_again(data_folder, tmp_path):
    """As MoveIt: what is disabled by name comes first, then what is enabled, then what is off by default."""
    file = tmp_path / "arm.srdf"
    file.write_text(DEFAULTS)
    rest = [("base", "lower"), ("upper", "lower"), ("upper", "hand")]
    rest += [(link, "finger_2") for link in ("base", "upper", "lower")]
    expected = {frozenset(f"{link}_0" for link in pair) for pair in rest}
    robot = Robot.from_urdf(data_folder / "gripper_arm.urdf", file, free=["grip"], tip="hand")
    assert self_pairs(robot) == expected


def test_what_always_touches_is_found_as_the_checker_finds_it():
    """Without contacts coal calls one in ten of these cylinders' overlaps free."""
    robot = Robot.from_urdf(next(robots_folder().rglob("baxter.urdf")), tip="left_gripper")
    assert frozenset(("left_lower_forearm_0", "left_upper_forearm_visual_0")) not in self_pairs(robot)


def test_without_srdf_exactly_adjacent_links_are_not_checked(data_folder, caplog):
    caplog.set_level(logging.INFO)
    robot = Robot.from_urdf(data_folder / "twin_arm.urdf")
    left = [("torso_0", "left_arm_0"), ("left_arm_0", "left_forearm_0"), ("left_arm_0", "left_forearm_1")]
    right = [("torso_0", "right_arm_0"), ("right_arm_0", "right_rail_0"), ("right_rail_0", "right_hand_0")]
    adjacent = [("base_0", "torso_0"), *left, *right]
    same_body = [("left_forearm_0", "left_forearm_1"), ("left_forearm_0", "left_hand_0")]
    same_body += [("left_forearm_1", "left_hand_0")]
    names = [body.name for body in robot.collision_model.geometryObjects]
    every = {frozenset((a, b)) for a in names for b in names if a != b}
    assert self_pairs(robot) == every - {frozenset(pair) for pair in adjacent + same_body}
    said = [record.message for record in caplog.records if record.levelname == "WARNING"]
    assert said == ["twin_arm: no SRDF (`safe-ompl srdf` writes one): 7 pairs of adjacent links are not checked"]
    assert all(f"{a}–{b}" in caplog.text for a, b in adjacent), "in the log's details"


def test_pairs_that_always_touch_are_dropped_and_logged(edited, caplog):
    urdf = edited("gripper_arm.urdf", '<box size="0.06 0.12 0.04"/>', '<sphere radius="0.5"/>')
    robot = Robot.from_urdf(urdf, tip="hand")
    assert frozenset(("upper_0", "hand_0")) not in self_pairs(robot)
    assert "not checked, as in contact in over 95% of samples: upper_0–hand_0" in caplog.text


def test_a_flat_mesh_gets_a_little_thickness(edited, tmp_path, caplog):
    urdf = edited("twin_arm.urdf", "wedge.obj", "flat.obj")
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n")
    with caplog.at_level(logging.INFO):
        robot = Robot.from_urdf(urdf)
    assert "mesh of left_hand_0 is flat: its hull is 0.2 mm thick" in caplog.text
    hand = next(body for body in robot.collision_model.geometryObjects if body.name == "left_hand_0")
    assert np.ptp(np.array(hand.geometry.points()), axis=0).min() == pytest.approx(2e-4)


def test_other_limits_leave_the_rest_and_the_robot_alone(panda):
    narrow = panda.with_limits({"panda_joint2": (-0.5, 0.25)})
    assert (narrow.lower[1], narrow.upper[1]) == (-0.5, 0.25)
    np.testing.assert_array_equal(np.delete(narrow.upper, 1), np.delete(panda.upper, 1))
    assert panda.upper[1] > 1
    held = narrow.with_attached("ball", Sphere(0.05)).with_limits({"panda_joint1": (0.0, 1.0)})
    assert (held.upper[0], held.upper[1], held.attached[0].name) == (1.0, 0.25, "ball")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("bad.urdf", "<robot name='x'><link", "not well-formed XML"),
        ("bad.urdf", "<sdf/>", "not a URDF: the outermost tag is <sdf>, not <robot>"),
        ("bad.urdf", "<robot name='x'/>", "not a valid URDF"),
        ("bad.srdf", "<robot name='x'><disable_collisions", "bad.srdf: not a valid SRDF"),
        ("bad.urdf", None, "URDF file '.*bad.urdf' does not exist"),
        ("bad.srdf", None, "SRDF file '.*bad.srdf' does not exist"),
        ("nowhere", None, "package folder '.*nowhere' does not exist"),
    ],
)
def test_files_that_are_missing_or_malformed(data_folder, tmp_path, name, text, message):
    file, whole = tmp_path / name, data_folder / "gripper_arm.urdf"
    if text is not None:
        file.write_text(text)
    files = {"bad.urdf": (file,), "bad.srdf": (whole, file), "nowhere": (whole, None, [file])}[name]
    with pytest.raises(InputError, match=message):
        Robot.from_urdf(*files, tip="hand")


@pytest.mark.parametrize("name", ["ur10", "so101", "twin_arm"])
def test_deciding_early_changes_no_decision(robot_named, name):
    """Pairs in contact in over 95 % of the samples, all of them asked at all samples."""
    robot = robot_named(name)
    model, geometry, samples = robot.model, robot.collision_model.copy(), sample_configurations(robot.model)
    geometry.addAllCollisionPairs()
    data, contacts, hits = model.createData(), pin.GeometryData(geometry), np.zeros(len(geometry.collisionPairs))
    for request in contacts.collisionRequests:  # as the checker asks coal
        request.enable_contact, request.security_margin = True, DISTANCE_ERROR
    for q in samples:
        pin.computeCollisions(model, data, geometry, contacts, q, False)
        hits += [result.isCollision() for result in contacts.collisionResults]
    pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    expected = [pair for pair, n in zip(pairs, hits, strict=True) if n > 0.95 * len(samples)]
    assert expected, "the case is worth nothing without one"
    found = always_in_contact(model, geometry, samples)
    assert [(pair.first, pair.second) for pair in found] == expected


# ----------------------------------------------------------------------------------- configurations as people have them


def test_mappings_from_names(panda):
    q = np.linspace(-0.5, -0.1, 7)
    named = dict(zip(panda.joint_names, q, strict=True))
    np.testing.assert_array_equal(panda.configuration(named), q)
    np.testing.assert_array_equal(panda.keypoints(named), panda.keypoints(q))
    with pytest.raises(UnknownNameError, match="unknown joint 'panda_joint9'; did you mean 'panda_joint"):
        panda.configuration({"panda_joint9": 0.0})
    with pytest.raises(InputError, match="configuration: no value for 'panda_joint2', 'panda_joint3'"):
        panda.configuration({"panda_joint1": 0.0})


def test_batches(panda):
    Q = np.linspace(-0.9, -0.1, 14).reshape(2, 7)
    np.testing.assert_array_equal(panda.keypoints_batch(Q.tolist()), panda.keypoints_batch(Q))
    with pytest.raises(InputError, match=r"configurations: must have shape \(any, 7\), got \(7,\)"):
        panda.keypoints_batch(Q[0])


@pytest.mark.parametrize("name", ["ur5", "kinova", "twin_arm"])
def test_as_the_robot_says(robot_named, rng, name):
    robot = robot_named(name)
    limits, answers = JointLimits(robot), set()
    for q in rng.uniform(1.2 * robot.lower - 0.01, 1.2 * robot.upper + 0.01, (200, robot.n)):
        answers.add(limits.hold(q))
        assert limits.hold(q) is bool(robot.within_limits(q).all())
    assert answers == {True, False}
    assert robot.within_limits(robot.upper + 0.01).tolist() == robot.continuous.tolist()
    inside = np.clip(np.zeros(robot.n), robot.lower, robot.upper)
    assert limits.hold(inside)
    for bad in (np.nan, np.inf, -np.inf):
        for joint in np.diag(np.ones(robot.n, dtype=bool)):
            assert limits.hold(np.where(joint, bad, inside)) is False
            assert not robot.within_limits(np.where(joint, bad, inside)).all()
