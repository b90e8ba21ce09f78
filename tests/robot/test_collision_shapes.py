"""No gap between the shapes of a URDF and what is checked: bare links, dropped shapes, impossible sizes."""

import logging
import pickle
import re

import numpy as np
import pytest

from safe_ompl import Box, CollisionChecker, InputError, Obstacle, Pose, Robot, Scene

BOX = '<box size="0.3 0.05 0.05"/>'
SHAPE = f'<origin xyz="0.2 0 0"/><geometry>{BOX}</geometry>'


JOINT = '<origin xyz="0.4 0 0"/><axis xyz="0 0 1"/>'


def arm(path, upper, lower, joint=JOINT):
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


LIMIT = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'
KIND = 'type="revolute"><parent link="upper"/>'
COLLISION, VISUAL = f"<collision>{SHAPE}</collision>", f"<visual>{SHAPE}</visual>"
LOWER = f'<link name="lower">{COLLISION}'
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
def test_links_without_any_shape_are_named_where_something_must_be(file, caplog, upper, lower, base, more, lacking):
    joint = {"joint": '<axis xyz="0 0 1"/>'} if more == ONE_PLACE else {}
    text = arm(file, upper, lower, **joint).read_text()
    file.write_text(text.replace('<link name="base"/>', f'<link name="base">{base}</link>{more}'))
    robot = Robot.from_urdf(file)
    assert robot.links_without_collision == lacking
    collision, visual = robot.collision_model, robot.visual_model if "<visual>" in text + base else None
    same = Robot.from_models(robot.model, collision, visual, tip=robot.tip)
    assert same.links_without_collision == lacking
    wheeled = Robot.from_urdf(file, mobile_base=((-1, 1), (-1, 1)))  # what stands still hits nothing by itself
    on_wheels = base not in ("", COLLISION)
    assert wheeled.links_without_collision == ("base",) * on_wheels + lacking
    assert ("links that have no collision shape: base" in caplog.text) == on_wheels
    cell = Robot.combined("cell", {"a": robot, "b": wheeled})
    of_cell = [f"{name}_{link}" for name, one in (("a", robot), ("b", wheeled)) for link in one.links_without_collision]
    assert list(cell.links_without_collision) == of_cell


def test_an_incomplete_inertial_takes_no_shape_with_it_and_a_wrong_one_is_refused(file):
    robot = Robot.from_urdf(arm(file, COLLISION, COLLISION + '<inertial><mass value="1"/></inertial>'))
    assert {body.name for body in robot.collision_model.geometryObjects} == {"upper_0", "lower_0"}
    strange = '<inertial><mass value="one"/><inertia ixx="1"/></inertial>'
    with pytest.raises(InputError, match="link 'lower': inertial: mass: value='one' must be a number"):
        Robot.from_urdf(arm(file, COLLISION, COLLISION + strange))


IMPOSSIBLE_SHAPES = [
    (collision('<sphere radius="-0.1"/>'), "the radius of its sphere is '-0.1'; it must be > 0"),
    (collision('<cylinder radius="0.1" length="0"/>'), "the length of its cylinder is '0'; it must be > 0"),
    (collision('<box size="0.1 0 0.1"/>'), "the size of its box is '0.1 0 0.1'"),
    (collision('<box size="0.1 nan 0.1"/>'), "box: size='0.1 nan 0.1' must be 3 finite numbers"),
    (collision('<box size="0.1 0.1"/>'), "box: size='0.1 0.1' must be 3 finite numbers"),
    (collision("<sphere/>"), "sphere: radius='' must be a finite number"),
    (collision('<capsule radius="1" length="1"/>'), "<capsule> cannot be read; use box, sphere, cylinder, mesh"),
    (collision('<mesh filename="a.obj" scale="1 0 1"/>'), "the scale '1 0 1' makes the mesh flat"),
    (collision(BOX, '<origin xyz="nan 0 0"/>'), "origin: xyz='nan 0 0' must be 3 finite numbers"),
    (collision(BOX, '<origin xyz="0 1e160 0"/>'), "origin: xyz='0 1e160 0' must be at most 10000 m"),
    (collision('<sphere radius="1e160"/>'), "sphere: radius='1e160' must be at most 10000 m"),
    (collision('<cylinder radius="0" length="1"/>'), "the radius of its cylinder is '0'; it must be > 0"),
    (collision(BOX, '<origin rpy="0 inf 0"/>'), "origin: rpy='0 inf 0' must be"),
    (collision(""), "it has 0 shapes; give one of box"),
    ("<collision/>", "it has 0 shapes"),
]
IMPOSSIBLE_JOINTS = [
    ('<axis xyz="0 0 0"/>', "axis is '0 0 0'; it must have a direction"),
    ('<axis xyz="0 nan 1"/>', "axis: xyz='0 nan 1' must be 3 finite numbers"),
    ('<origin xyz="inf 0 0"/><axis xyz="0 0 1"/>', "origin: xyz='inf 0 0'"),
    ('<origin xyz="1e160 0 0"/>', "origin: xyz='1e160 0 0' must be at most 10000 m"),
    ('<limit lower="-1,5" upper="1" effort="1" velocity="1"/>', "limit: lower='-1,5' must be a number"),
    ('<limit lower="-1" upper="" effort="1" velocity="1"/>', "limit: upper='' must be a number"),
    ('<limit lower="-1" upper="1" effort="-3" velocity="1"/>', "limit: effort='-3' must be a number >= 0"),
    ('<limit lower="-1" upper="1" effort="1" velocity="-0.1"/>', "limit: velocity='-0.1' must be a number >= 0"),
    ('<limit lower="nan" upper="1" effort="1" velocity="1"/>', "limit: lower='nan' must be a number"),
    ('<mimic joint="a" multiplier="1,0"/>', "mimic: multiplier='1,0' must be a number"),
    ('<mimic joint="a" offset="x"/>', "mimic: offset='x' must be a number"),
    ('<dynamics damping="little"/>', "dynamics: damping='little' must be a number"),
]
MISREAD = [
    (KIND, KIND.replace("r", "R", 1), "type of joint 'b' 'Revolute'; did you mean 'revolute'?"),
    (KIND, KIND.replace('type="revolute"', ""), "type of joint 'b' ''; known: revolute"),
    (LIMIT, "", "joint 'a': it has no <limit>, and a revolute joint needs one: <limit lower="),
    (LIMIT, '<limit effort="1" velocity="1"/>', "the limits of a leave no range"),
    (LIMIT, LIMIT.replace('"2"', '"1e39"'), "joint 'a' has the limits [-2.0, 1e+39]: no range to plan in"),
    ('<mass value="1"/>', '<mass value="0,5"/>', "link 'upper': inertial: mass: value='0,5' must be a number"),
    ('ixy="0"', 'ixy="0 0"', "link 'upper': inertial: inertia: ixy='0 0' must be a number"),
    ('<box size="0.3', '<box size="0,3', "link 'upper', collision 0: box: size='0,3 0.05 0.05' must be 3 finite"),
]


@pytest.mark.parametrize(
    ("old", "new", "place", "message"),
    [
        *(
            (LOWER, f'<link name="lower">{element}', "link 'lower', collision 0: ", said)
            for element, said in IMPOSSIBLE_SHAPES
        ),
        *((JOINT, joint, "joint 'b': ", said) for joint, said in IMPOSSIBLE_JOINTS),
        *((old, new, "", said) for old, new, said in MISREAD),
    ],
)
def test_what_is_impossible_or_would_be_misread_is_named(file, old, new, place, message):
    text = arm(file, COLLISION + MASS.format(1), COLLISION).read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=f"arm.urdf: .*{place}.*{re.escape(message)}"):
        Robot.from_urdf(file, tip="upper")


EMPTY = ('<box size="0 0 0"/>', '<sphere radius="0"/>', '<cylinder radius="0.0" length="0"/>')


@pytest.mark.parametrize("shape", EMPTY)
def test_shapes_of_size_zero_are_none(file, shape, caplog):
    """As exporters write them for links that have none: such a link is named if something must be there."""
    empty = collision(shape) + collision(shape).replace("collision", "visual")
    robot = Robot.from_urdf(arm(file, COLLISION + empty, empty + MASS.format(1)))
    assert [body.name for body in robot.collision_model.geometryObjects] == ["upper_0"]
    assert robot.links_without_collision == ("lower",)
    assert caplog.text.count("shapes of size zero are taken for none, those of lower, upper") == 1


def test_impossible_visual_shapes_matter_only_if_they_collide(file, caplog):
    broken = f"<visual><geometry>{BOX.replace('0.3', '-0.3')}</geometry></visual>"
    with caplog.at_level(logging.WARNING):
        robot = Robot.from_urdf(arm(file, COLLISION, broken))
    assert robot.links_without_collision == ("lower",)
    with pytest.raises(InputError, match=r"link 'lower', visual 0: the size of its box is '-0.3 0.05 0.05'"):
        Robot.from_urdf(file, collision="visual")
