"""URDFs as people have them: xacro not yet expanded, packages in folders of other names."""

import pickle
import sys

import pytest
from self_pairs import self_pairs

from safe_ompl import InputError, Robot
from safe_ompl.io.problems import built_robot, embedded_robot
from safe_ompl.robot import RobotSpec, robot_hash

XACRO = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'


@pytest.mark.parametrize(
    ("text", "evidence"),
    [
        (XACRO.format('<xacro:include filename="a"/>'), "<xacro:include>"),
        ('<robot name="x"><xacro:macro name="m"/></robot>', "<xacro:macro>"),
        ('<robot name="x"><link name="${prefix}base"/></robot>', r"\$\{prefix\}"),
        ('<robot name="x"><link name="b"><visual><origin xyz="$(arg x) 0 0"/></visual></link></robot>', r"\$\(arg x\)"),
    ],
)
@pytest.mark.parametrize("name", ["arm.urdf.xacro", "arm.xacro", "arm.urdf"])
def test_xacro_is_recognised(tmp_path, text, evidence, name, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacro", None)
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(InputError, match=f"{evidence}.*`pip install xacro`"):
        Robot(RobotSpec(urdf=path))


@pytest.fixture
def macros(data_folder, tmp_path):
    """Return the arm with a gripper as xacro, with a property of another package: how long its links are."""
    pytest.importorskip("xacro")
    package = tmp_path / "src" / "sizes-main"
    package.mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>sizes</name></package>")
    (package / "sizes.xacro").write_text(XACRO.format('<xacro:property name="length" value="${3 * 0.1}"/>'))
    text = (data_folder / "gripper_arm.urdf").read_text().replace('size="0.3 ', 'size="${length} ')
    head = 'name="$(arg prefix)arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    head += '<xacro:include filename="$(find sizes)/sizes.xacro"/>'
    path = tmp_path / "src" / "arm.urdf.xacro"
    path.write_text(text.replace('name="gripper_arm">', head))
    return path


def test_xacro_is_expanded(macros, data_folder, tmp_path):
    """In every place where a robot comes from: the same as the robot of its URDF, and files carry what was expanded."""
    plain = Robot.from_urdf(data_folder / "gripper_arm.urdf", tip="hand")
    robot = Robot.from_urdf(macros, tip="hand", xacro_args={"prefix": "left_"})
    scenario = tmp_path / "scenarios"
    spec = RobotSpec(urdf=macros, tip="hand", xacro_args={"prefix": 2})
    assert [robot.name, Robot(spec).name] == ["left_arm", "2arm"]
    assert RobotSpec.from_mapping(spec.to_mapping(scenario), scenario) == spec
    carried = embedded_robot(robot)
    assert "xacro:" not in carried["recipe"]["urdf"]["text"]
    hashes = {robot_hash(one) for one in (plain, robot, built_robot(carried), pickle.loads(pickle.dumps(robot)))}
    assert len(hashes) == 1


SRDF = """
<xacro:macro name="off" params="a b"><disable_collisions link1="${a}" link2="${b}" reason="Never"/></xacro:macro>
<xacro:off a="base" b="lower"/><group name="$(arg prefix)arm"><chain base_link="base" tip_link="hand"/></group>
"""


def test_an_srdf_in_xacro_is_expanded(data_folder, tmp_path):
    """With the arguments of the URDF; files carry what was expanded, and what others sent is not expanded."""
    pytest.importorskip("xacro")
    urdf, srdf = data_folder / "gripper_arm.urdf", tmp_path / "arm.srdf.xacro"
    srdf.write_text(XACRO.format(SRDF))
    with pytest.raises(InputError, match=r"arm.srdf.xacro: a xacro file, not yet a SRDF \(it holds <xacro:macro>\)"):
        Robot.from_urdf(urdf, srdf, xacro_args=None)
    robot = Robot.from_urdf(urdf, srdf, group="my_arm", xacro_args={"prefix": "my_"})
    assert robot.joint_names == ("turn", "elbow")
    pairs = self_pairs(robot)
    assert frozenset(("base_0", "lower_0")) not in pairs
    assert frozenset(("base_0", "hand_0")) in pairs
    carried = embedded_robot(robot)
    assert robot_hash(built_robot(carried)) == robot_hash(robot)
    carried["recipe"]["srdf"]["text"] = srdf.read_text()
    with pytest.raises(InputError, match="not yet a SRDF"):
        built_robot(carried)


def test_what_others_sent_is_never_expanded(macros):
    """Expressions of xacro are Python."""
    carried = embedded_robot(Robot.from_urdf(macros, tip="hand", xacro_args={"prefix": ""}))
    carried["recipe"]["urdf"]["text"] = macros.read_text()
    with pytest.raises(InputError, match="not yet a URDF"):
        built_robot(carried)


@pytest.mark.parametrize(
    ("text", "arguments", "message"),
    [
        (XACRO.format('<link name="${size}"/>'), {}, "xacro cannot expand it.*size"),
        (XACRO.format('<xacro:include filename="$(find none)/a"/>'), {}, "package 'none' not found.*package dir"),
        (XACRO.format('<link name="$(find none)"/>'), {}, r"cannot expand it \(package 'none' not found; give"),
        (XACRO.format('<link name="$(env NONE)"/>'), {}, r"cannot expand it \(environment variable 'NONE' is not"),
        (XACRO.format('<link name="$(eval 1+)"/>'), {}, r"cannot expand it \(invalid syntax"),
        (XACRO.format('<link name="$(arg none)"/>'), {}, r"cannot expand it \(Undefined substitution argument none\)"),
        (XACRO.format('<link name="base"/>'), {"prefix": "a"}, "no xacro that could take the arguments prefix"),
    ],
)
def test_what_xacro_cannot_expand_is_one_line(tmp_path, text, arguments, message):
    pytest.importorskip("xacro")
    path = tmp_path / "arm.urdf.xacro"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as found:
        Robot.from_urdf(path, xacro_args=arguments)
    assert "\n" not in str(found.value)


@pytest.fixture
def workspace(data_folder, tmp_path):
    """Two packages side by side, in folders that are not called as the packages are."""
    for folder, name in (("robot-main", "twin_description"), ("meshes-v2", "twin_meshes")):
        (tmp_path / "src" / folder / "files").mkdir(parents=True)
        (tmp_path / "src" / folder / "package.xml").write_text(f"<package><name> {name} </name></package>")
    mesh = (data_folder / "wedge.obj").read_bytes()
    (tmp_path / "src" / "meshes-v2" / "files" / "wedge.obj").write_bytes(mesh)
    text = (data_folder / "twin_arm.urdf").read_text()
    urdf = tmp_path / "src" / "robot-main" / "files" / "twin.urdf"
    urdf.write_text(text.replace("wedge.obj", "package://twin_meshes/files/wedge.obj"))
    return urdf


def test_packages_are_found_by_their_manifest(workspace, tmp_path, monkeypatch):
    """Beside the folders above the URDF, in and below folders that are given, and where ROS looks."""
    src, share, lonely = tmp_path / "src", tmp_path / "install" / "share", tmp_path / "elsewhere" / "twin.urdf"
    missing = r"'package://twin_meshes/files/wedge.obj' not found"
    lonely.parent.mkdir()
    lonely.write_text(workspace.read_text())
    assert Robot.from_urdf(workspace).n == 6
    for folder in (tmp_path, src, src / "meshes-v2"):
        assert Robot.from_urdf(lonely, package_dirs=[folder]).n == 6
    (src / "meshes-v2" / "package.xml").rename(src / "meshes-v2" / "kept.xml")
    (src / "meshes-v2" / "package.xml").write_text("<package>")
    with pytest.raises(InputError, match=missing):
        Robot.from_urdf(workspace)
    share.mkdir(parents=True)
    (src / "meshes-v2" / "kept.xml").rename(src / "meshes-v2" / "package.xml")
    (src / "meshes-v2").rename(share / "meshes")
    with pytest.raises(InputError, match=missing):
        Robot.from_urdf(lonely)
    for variable, folder in (("ROS_PACKAGE_PATH", share), ("AMENT_PREFIX_PATH", share.parent)):
        with monkeypatch.context() as patch:
            patch.setenv(variable, f"{tmp_path / 'nowhere'}:{folder}")
            assert Robot.from_urdf(lonely).n == 6


@pytest.mark.parametrize(
    "name",
    [
        "file:///opt/ros/jazzy/share/twin_meshes/files/wedge.obj",
        "/opt/ros/jazzy/share/twin_meshes/files/wedge.obj",
        "file:///home/someone/work/src/twin_meshes/files/wedge.obj",
        "file:///opt/ros/share/meshes-v2/files/wedge.obj",
    ],
)
def test_meshes_that_xacro_named_on_another_machine(workspace, tmp_path, name):
    """`file://$(find PKG)/…` is a path where it was expanded; here the package, or its folder, is elsewhere."""
    lonely = tmp_path / "elsewhere" / "twin.urdf"
    lonely.parent.mkdir()
    lonely.write_text(workspace.read_text().replace("package://twin_meshes/files/wedge.obj", name))
    with pytest.raises(InputError, match=f"collision mesh '{name}' not found"):
        Robot.from_urdf(lonely)
    robot = Robot.from_urdf(lonely, package_dirs=[tmp_path / "src"])
    carried = embedded_robot(robot)
    assert robot_hash(built_robot(carried, package_dirs=[tmp_path / "src"])) == robot_hash(robot)


@pytest.mark.parametrize("whole", [False, True])
def test_a_package_without_a_name(edited, data_folder, whole):
    """Some exporters write three slashes: what follows is a path, whole or below a package folder."""
    name = str(data_folder / "wedge.obj") if whole else "/data/wedge.obj"
    urdf = edited("twin_arm.urdf", "wedge.obj", f"package://{name}")
    assert Robot.from_urdf(urdf, package_dirs=[] if whole else [data_folder.parent]).n == 6


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<robot name="', '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="'),  # xacro leaves it behind
        ('<robot name="gripper_arm">', "<robot>"),  # it is called after its file
        ("<limit ", '<limit drake:acceleration="2.5" '),  # without saying what drake is
    ],
)
def test_what_many_urdfs_hold_or_lack_does_no_harm(edited, old, new):
    assert Robot.from_urdf(edited("gripper_arm.urdf", old, new)).name == "gripper_arm"
