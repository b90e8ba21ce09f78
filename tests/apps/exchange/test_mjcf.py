"""Models of MuJoCo: distances are MuJoCo's own, of the pairs that it checks; what is not read is refused."""

import numpy as np
import pytest

from safe_ompl import CollisionChecker, InputError, Robot
from safe_ompl.apps.exchange import world_from_mjcf

mujoco = pytest.importorskip("mujoco")

WEDGE = "0 0 0  0.1 0 0  0 0.2 0  0 0 0.15  0.1 0.2 0.1"
ARM = f"""
<mujoco model="arm">
  <compiler angle="radian" autolimits="true"/>
  <default><joint damping="1"/></default>
  <asset><mesh name="wedge" vertex="{WEDGE}"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" pos="0 0 -0.4"/>
    <geom name="pillar" type="cylinder" size="0.1 0.3" pos="0.8 0.1 0" euler="0.2 0.1 0"/>
    <geom name="picture" type="sphere" size="1" contype="0" conaffinity="0"/>
    <body name="base"><geom name="foot" type="box" size="0.1 0.1 0.05" pos="0 0 -0.1"/>
      <body name="upper" pos="0 0 0.1" euler="0 0 0.3">
        <joint name="pan" axis="0 0 1" range="-2 2" ref="0.2"/>
        <joint name="lift" axis="0 1 0.2" pos="0.02 0 0.01" range="-1.5 1.5"/>
        <geom name="rod" type="capsule" size="0.04" fromto="0.1 0 0 0.5 0 0"/>
        <geom type="sphere" size="0.9" contype="0" conaffinity="0"/>
        <body name="plate" pos="0.3 0 0.1"><geom name="flange" type="box" size="0.03 0.02 0.01" euler="0.3 0 0"/></body>
        <body name="fore" pos="0.55 0 0" quat="0.9 0.1 0 0.3">
          <joint name="roll" axis="1 0 0"/>
          <geom name="wedge" type="mesh" mesh="wedge" pos="0.05 0 0"/>
          <body name="finger" pos="0.2 0 0">
            <joint name="slide" type="slide" axis="0 1 0" range="0.0 0.1" ref="0.05"/>
            <geom name="tip" type="cylinder" size="0.01 0.05"/>
          </body>
          <body name="thumb" pos="0.2 0 0.1">
            <joint name="follow" type="slide" axis="0 -1 0" range="0 0.2"/>
            <geom name="nail" type="sphere" size="0.02"/>
          </body>
        </body>
      </body>
    </body>
    <body name="mug" pos="0.2 0.9 0"><freejoint/><geom name="mug" type="mesh" mesh="wedge"/></body>
  </worldbody>
  <contact><exclude body1="upper" body2="base"/></contact>
  <equality><joint joint1="pan" active="false"/>
    <joint joint1="follow" joint2="slide" polycoef="0.01 0.5 0 0 0"/></equality>
</mujoco>
"""


def load(folder, text, **options):
    (folder / "arm.xml").write_text(text)
    return world_from_mjcf(folder / "arm.xml", meshes=folder, **options)


def test_distances_are_those_of_mujoco(tmp_path):
    robot, scene = load(tmp_path, ARM, tip="finger")
    assert scene.names == ("floor", "pillar", "foot", "mug")
    assert [o.touched_by for o in scene] == [(), (), ("upper",), ()]
    assert robot.joint_names == ("pan", "lift", "roll", "slide")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    model.opt.ccd_tolerance, model.opt.ccd_iterations = 1e-10, 1000
    data, rng, checker = mujoco.MjData(model), np.random.default_rng(1), CollisionChecker(robot, scene)
    bodies = {name: {k for k in range(model.ngeom) if model.body(model.geom_bodyid[k]).name == name
                     and model.geom_contype[k]} for name in ("upper", "plate", "fore", "finger", "thumb")}  # fmt: skip
    ends = {**bodies, **{name: {model.geom(name).id} for name in scene.names}}
    model.geom_margin[:] = 5.0  # so that MuJoCo names all pairs that it looks at
    mujoco.mj_fwdPosition(model, data)
    looked_at = {frozenset(model.body(model.geom_bodyid[g]).name for g in contact.geom) for contact in data.contact}
    selves = {frozenset(pair) for pair in checker.pair_names if not {*pair} & {*scene.names}}
    assert selves == {pair for pair in looked_at if pair <= {*bodies}}
    compared = 0
    for q in rng.uniform(robot.lower, robot.upper, (1000, robot.n)):
        for name, value in zip(robot.joint_names, q, strict=True):
            data.joint(name).qpos[0] = value
        data.joint("follow").qpos[0] = 0.01 + 0.5 * (data.joint("slide").qpos[0] - 0.05)
        mujoco.mj_kinematics(model, data)
        for (one, other), own in zip(checker.pair_names, checker.pair_distances(q), strict=True):
            theirs = min(mujoco.mj_geomDistance(model, data, a, b, 10, None) for a in ends[one] for b in ends[other])
            if theirs > 1e-4:
                assert own == pytest.approx(theirs, abs=1e-6), (one, other)
                compared += 1
            else:
                assert own < 2e-4
    assert compared > 5000


NOT_READ = [
    ('type="sphere" size="0.02"', 'type="ellipsoid" size="0.02 0.02 0.03"', "geom 'nail'.type: .* ellipsoid"),
    ('name="roll" axis="1 0 0"', 'name="roll" type="ball"', "joint 'roll': is a ball joint.* not supported"),
    ("0.01 0.5 0 0 0", "0.01 0.5 1 0 0", "equality .*: must be a linear one of joints"),
    ('joint2="slide" polycoef', 'joint2="sled" polycoef', "MuJoCo does not read it .*sled"),
    ('size="0.9" contype="0" conaffinity="0"', 'size="1" contype="2" conaffinity="2"', "may touch some geoms of"),
    ("<freejoint/>", '<freejoint/><body><joint/><geom size="0.1"/></body>', "joint '.*': is below a free joint"),
    ('name="rod"', 'name="rod" contype="2" conaffinity="2"', ""),
    ('size="0.1 0.3"', 'size="0.1 0.3" contype="2" conaffinity="2"', ""),
]


@pytest.mark.parametrize(("old", "new", "said"), NOT_READ)
def test_what_is_not_read_is_refused(old, new, said, tmp_path):
    text = ARM.replace(old, new, 1)
    assert text != ARM
    if said:
        with pytest.raises(InputError, match=said) as error:
            load(tmp_path, text)
        assert str(error.value).startswith(str(tmp_path / "arm.xml"))
        assert "\n" not in str(error.value)
    else:  # what MuJoCo does not let touch may touch
        robot, scene = load(tmp_path, text)
        links = {link for o in scene for link in o.touched_by}
        assert isinstance(robot, Robot)
        assert "upper" in links


def test_a_world_where_nothing_moves_has_no_robot(tmp_path):
    robot, scene = load(tmp_path, "<mujoco><worldbody><geom name='ball' size='0.1'/></worldbody></mujoco>")
    assert robot is None
    assert scene.names == ("ball",)
