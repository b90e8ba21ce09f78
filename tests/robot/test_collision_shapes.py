"""No gap between the shapes of a URDF and what is checked: bare links, dropped shapes, impossible sizes."""

import logging
import pickle
import re

import numpy as np
import pytest

from safe_ompl import Box, CollisionChecker, InputError, Obstacle, Pose, Robot, Scene

BOX = '<box size="0.3 0.05 0.05"/>'
SHAPE = f'<origin xyz="0.2 0 0"/><geometry>{BOX}</geometry>'


def arm(path, upper, lower, joint='<origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>'):
    """Write an arm of two links with the given inner XML, and return the file."""
    path.write_text(
        f"""<robot name="arm"><link name="base"/><link name="upper">{upper}</link><link name="lower">{lower}</link>
        <joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/>
        <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
        <joint name="b" type="revolute"><parent link="upper"/><child link="lower"/>{joint}
        <limit lower="-2" upper="2" effort="1" velocity="1"/></joint></robot>"""
    )
    return path


@pytest.fixture
def file(tmp_path):
    return tmp_path / "arm.urdf"


def collision(shape, origin='<origin xyz="0.2 0 0"/>'):
    return f"<collision>{origin}<geometry>{shape}</geometry></collision>"


COLLISION, VISUAL = f"<collision>{SHAPE}</collision>", f"<visual>{SHAPE}</visual>"
WALL = Scene((Obstacle("wall", Box((0.02, 0.5, 0.5)), Pose((0.6, 0.0, 0.0))),))


def test_a_robot_without_collision_shapes_is_refused_unless_asked_for(file):
    with pytest.raises(InputError, match=r"arm.urdf: no moving link has a collision shape.*collision='visual'"):
        Robot.from_urdf(arm(file, VISUAL, VISUAL))
    robot = pickle.loads(pickle.dumps(Robot.from_urdf(file, collision="visual")))
    assert len(robot.collision_model.geometryObjects) == 2
    arm(file, "", "")
    with pytest.raises(InputError, match="no visual ones either"):
        Robot.from_urdf(file, collision="visual")


def test_links_without_collision_shapes_are_named(file, caplog):
    robot = Robot.from_urdf(arm(file, COLLISION, VISUAL))
    assert robot.links_without_collision == ("lower",)
    assert "links_without_collision=['lower']" in repr(robot)
    (warning,) = [r.getMessage() for r in caplog.records if "no collision shape" in r.getMessage()]
    assert "lower" in warning
    assert "upper" not in warning
    filled = Robot.from_urdf(file, collision="visual")
    assert filled.links_without_collision == ()
    assert not CollisionChecker(robot, WALL).in_collision(np.zeros(2))
    assert CollisionChecker(filled, WALL).in_collision(np.zeros(2))


MASS = '<inertial><mass value="{}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>'
ONE_PLACE = "<!-- both axes are in one place -->"
FIXED = '<link name="f">{}</link><joint name="c" type="fixed"><parent link="upper"/><child link="f"/></joint>'


@pytest.mark.parametrize(
    ("upper", "lower", "base", "more", "lacking"),
    {
        "a frame at the end": (COLLISION, "", "", "", ()),
        "mass at the end": (COLLISION, MASS.format(0.5), "", "", ("lower",)),
        "mass of a simulator's": (COLLISION, MASS.format(1e-9), "", "", ()),
        "between shapes": ("", COLLISION, COLLISION, "", ("upper",)),
        "between drawings": ("", COLLISION, VISUAL, "", ("upper",)),
        "two axes in one place": ("", COLLISION, COLLISION, ONE_PLACE, ()),
        "nothing before it": ("", COLLISION, "", "", ()),
        "shapes on a link fixed to it": ("", COLLISION, COLLISION, FIXED.format(COLLISION), ()),
        "a fixed frame": (COLLISION, COLLISION, COLLISION, FIXED.format(MASS.format(0.5)), ()),
        "mass of both": (MASS.format(2), COLLISION, "", FIXED.format(MASS.format(1)), ("upper",)),
        "a base that stands": (COLLISION, COLLISION, MASS.format(9), "", ()),
    }.values(),
)
def test_links_without_any_shape_are_named_where_something_must_be(file, upper, lower, base, more, lacking):
    joint = {"joint": '<axis xyz="0 0 1"/>'} if more == ONE_PLACE else {}
    text = arm(file, upper, lower, **joint).read_text()
    file.write_text(text.replace('<link name="base"/>', f'<link name="base">{base}</link>{more}'))
    robot = Robot.from_urdf(file)
    assert robot.links_without_collision == lacking
    collision, visual = robot.collision_model, robot.visual_model if "<visual>" in text + base else None
    same = Robot.from_models(robot.model, collision, visual, tip=robot.tip)
    assert same.links_without_collision == lacking
    wheeled = Robot.from_urdf(file, mobile_base=((-1, 1), (-1, 1)))
    assert wheeled.links_without_collision == ("base",) * (base not in ("", COLLISION)) + lacking


def test_an_incomplete_inertial_takes_no_shape_with_it_and_a_wrong_one_is_refused(file):
    robot = Robot.from_urdf(arm(file, COLLISION, COLLISION + '<inertial><mass value="1"/></inertial>'))
    assert {body.name for body in robot.collision_model.geometryObjects} == {"upper_0", "lower_0"}
    strange = '<inertial><mass value="one"/><inertia ixx="1"/></inertial>'
    with pytest.raises(InputError, match="link 'lower': 1 collision shapes are in the file, 0 could be read"):
        Robot.from_urdf(arm(file, COLLISION, COLLISION + strange))


@pytest.mark.parametrize(
    ("element", "message"),
    [
        (collision('<sphere radius="-0.1"/>'), "the radius of its sphere is '-0.1'; it must be > 0"),
        (collision('<cylinder radius="0.1" length="0"/>'), "the length of its cylinder is '0'; it must be > 0"),
        (collision('<box size="0.1 0 0.1"/>'), "the size of its box is '0.1 0 0.1'"),
        (collision('<box size="0.1 nan 0.1"/>'), "box: size='0.1 nan 0.1' must be 3 finite numbers"),
        (collision('<box size="0.1 0.1"/>'), "box: size='0.1 0.1' must be 3 finite numbers"),
        (collision("<sphere/>"), "sphere: radius='' must be a finite number"),
        (collision('<capsule radius="1" length="1"/>'), "<capsule> cannot be read; use box, sphere, cylinder, mesh"),
        (collision('<mesh filename="a.obj" scale="1 0 1"/>'), "the scale '1 0 1' makes the mesh flat"),
        (collision(BOX, '<origin xyz="nan 0 0"/>'), "origin: xyz='nan 0 0' must be 3 finite numbers"),
        (collision(BOX, '<origin rpy="0 inf 0"/>'), "origin: rpy='0 inf 0' must be"),
        (collision(""), "it has 0 shapes; give one of box"),
        ("<collision/>", "it has 0 shapes"),
    ],
)
def test_impossible_shapes_are_refused(file, element, message):
    with pytest.raises(InputError, match="arm.urdf: link 'lower', collision 0: .*" + re.escape(message)):
        Robot.from_urdf(arm(file, COLLISION, element))


@pytest.mark.parametrize(
    ("joint", "message"),
    [
        ('<axis xyz="0 0 0"/>', "axis is '0 0 0'; it must have a direction"),
        ('<axis xyz="0 nan 1"/>', "axis: xyz='0 nan 1' must be 3 finite numbers"),
        ('<origin xyz="inf 0 0"/><axis xyz="0 0 1"/>', "origin: xyz='inf 0 0'"),
    ],
)
def test_impossible_joints_are_refused(file, joint, message):
    with pytest.raises(InputError, match=f"joint 'b': .*{message}"):
        Robot.from_urdf(arm(file, COLLISION, COLLISION, joint))


def test_impossible_visual_shapes_matter_only_if_they_collide(file, caplog):
    broken = f"<visual><geometry>{BOX.replace('0.3', '-0.3')}</geometry></visual>"
    with caplog.at_level(logging.WARNING):
        robot = Robot.from_urdf(arm(file, COLLISION, broken))
    assert robot.links_without_collision == ("lower",)
    with pytest.raises(InputError, match=r"link 'lower', visual 0: the size of its box is '-0.3 0.05 0.05'"):
        Robot.from_urdf(file, collision="visual")
