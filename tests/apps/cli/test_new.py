"""`safe-ompl new`: a robot of one's own has a scenario that can be planned, and stumbling stones have signs."""

import json
import re
import shlex
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from safe_ompl import Robot, Scenario, plan_program
from safe_ompl.common.errors import warn_once
from safe_ompl.planning import setup_scenario
from safe_ompl.robot import robots_folder

SCARA = """
<robot name="scara">
  <link name="base"/>
  <link name="inner"><collision>
    <origin xyz="0.2 0 0"/><geometry><box size="0.4 0.08 0.06"/></geometry></collision></link>
  <link name="outer"><collision>
    <origin xyz="0.15 0 0"/><geometry><box size="0.3 0.07 0.05"/></geometry></collision></link>
  <link name="quill"><collision><geometry><cylinder radius="0.02" length="0.3"/></geometry></collision></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="inner"/><origin xyz="0 0 0.4"/>
    <axis xyz="0 0 1"/><limit lower="-2.4" upper="2.4" velocity="4" effort="1"/></joint>
  <joint name="elbow" type="continuous"><parent link="inner"/><child link="outer"/><origin xyz="0.4 0 0.06"/>
    <axis xyz="0 0 1"/><limit velocity="5" effort="1"/></joint>
  <joint name="z" type="prismatic"><parent link="outer"/><child link="quill"/><origin xyz="0.3 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-0.2" upper="0.05" velocity="1" effort="1"/></joint>
</robot>
"""


@pytest.fixture
def urdf(tmp_path, monkeypatch):
    """Begin in a folder with a robot `robots/scara.urdf`."""
    monkeypatch.chdir(tmp_path)
    file = Path("robots/scara.urdf")
    file.parent.mkdir()
    file.write_text(SCARA)
    return file


def test_a_new_scenario_can_be_planned(says, urdf, tmp_path):
    says(f"new {urdf} -o mine.yaml", notes=["3 joints, tip 'quill', reach 0.70 m"])
    scenario = Scenario.load("mine.yaml")
    robot = scenario.build_robot()
    ends = np.array([scenario.start_configuration(robot), *scenario.goal_configurations(robot)])
    left, right = robot.keypoints_batch(ends)[:, -1]
    assert left[1] > 0.1 > -0.1 > right[1]  # on either side of the person
    assert scenario.scene["person"].weight == 1.0
    assert json.loads(says("plan mine.yaml --json -"))["certified"]
    (tmp_path / "again").mkdir()
    says(f"new {urdf} -o again/mine.yaml")
    assert Scenario.load("again/mine.yaml").scene == scenario.scene


@pytest.mark.parametrize("robot", ["scara", "z1", "xarm7"])
def test_the_way_past_the_person_matters(says, robot, urdf):
    given = urdf if robot == "scara" else next(robots_folder().rglob(f"{robot}.urdf"))
    says(f"new {given} -o mine.yaml")
    setup = setup_scenario(scenario := Scenario.load("mine.yaml"))
    start, (goal, *_) = scenario.start_configuration(setup.robot), scenario.goal_configurations(setup.robot)
    straight = np.linspace(start, goal, 41)
    clearances = [setup.checker.clearance(q).distance for q in straight]
    assert 0.05 <= min(clearances) < 0.09
    assert min(clearances[0], clearances[-1]) > 2 * min(clearances)
    result = setup.plan("SafeRRTConnect", time=5.0, seed=1, simplify=True)
    assert result.report.danger.max < 0.85 * setup.field.values(straight).max()


@pytest.mark.parametrize("name", ["1e3", "no", "0x10", "12:30", "null", "~", "1_000", "a: b", "- c", "2026-11-29"])
def test_joints_may_have_names_that_yaml_takes_for_something_else(says, urdf, name):
    urdf.write_text(SCARA.replace('"elbow"', f'"{name}"'))
    own = "no" if name == "no" else "1e3"
    says(f"new {urdf} -o {own}.yaml")
    scenario = Scenario.load(f"{own}.yaml")
    assert scenario.name == own
    assert scenario.build_robot().joint_names == ("shoulder", name, "z")


@pytest.mark.parametrize("robot", ["baxter", "tiago", "z1"])
def test_robots_that_are_hard_to_begin_with(says, robot, tmp_path):
    """Baxter's forearms always touch, which coal sees only if it is asked for contacts."""
    says(f"new {next(robots_folder().rglob(f'{robot}.urdf'))} -o {tmp_path}/mine.yaml")
    assert Scenario.load(tmp_path / "mine.yaml").build_robot().n >= 6


def test_a_link_without_shapes_is_named_by_every_command(says, urdf, tmp_path):
    text = (Path(__file__).parents[3] / "examples" / "arm.urdf").read_text()
    urdf.write_text(re.sub(r'(<link name="upper_arm">).*?(</link>)', r"\1\2", text, flags=re.DOTALL))
    for line, *words in (
        (f"new {urdf} -o arm.yaml",),
        ("plan arm.yaml --json result.json --certificate proof.json", "no collision geometry: upper_arm"),
        ("verify proof.json", "not covered: links without collision geometry: upper_arm"),
        ("verify proof.json arm.yaml", "not covered: links without collision geometry: upper_arm"),
    ):
        warn_once.cache_clear()
        says(line, *words, notes=["nothing is checked for links that have no collision shape: upper_arm"])
    assert json.loads((tmp_path / "result.json").read_text())["links_without_collision"] == ["upper_arm"]


@pytest.mark.parametrize("command", ["plan", "view"])
def test_a_urdf_in_place_of_a_scenario_is_told_what_to_do(refuses, command, urdf):
    refuses(f"{command} {urdf}", "`safe-ompl new")


# ------------------------------------------------------------------------- two arms, a gripper, wheels, a camera


@pytest.fixture
def butler(tmp_path, data_folder, monkeypatch):
    """Write a robot into one folder, its package into another that only an option or ROS's variables lead to."""
    package, work = tmp_path / "share" / "butler", tmp_path / "work"
    (package / "meshes").mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>butler</name></package>")
    shutil.copy(data_folder / "wedge.obj", package / "meshes" / "palm.obj")
    work.mkdir()
    for kind in ("urdf", "srdf"):
        shutil.copy(data_folder / f"butler.{kind}", work)
    monkeypatch.chdir(work)
    return tmp_path / "share"


def printed(text):
    """Return the commands that `new` printed, without the view in the browser."""
    commands = [shlex.split(line) for line in re.findall(r"^    safe-ompl (.*)$", text, re.MULTILINE)]
    return [words for words in commands if words[0] != "view" or "--html" in words]


def test_what_is_printed_runs_as_it_stands(call, butler):
    """An arm is planned for, without lift, wheels and fingers, to the hand and not to the camera."""
    pytest.importorskip("viser")
    status, _, err = call("new", "butler.urdf", "-o", "my first.yaml", "--package-dir", butler)
    assert status == 0
    commands = printed(err)
    assert [words[0] for words in commands] == ["plan", "verify", "view"]
    scenario = Scenario.load("my first.yaml")
    robot = scenario.build_robot()
    assert robot.joint_names == ("left_1", "left_2", "left_3", "left_4")
    assert robot.tip == "left_d"
    assert set(scenario.robot.locked) == {
        *("roam", "lift", "wheel_0", "wheel_1", "left_left_jaw", "right_left_jaw"),
        *("right_1", "right_2", "right_3", "right_4"),
    }
    for words in commands:
        status, _, err = call(*words)
        assert status == 0, words
        assert "held, as not" not in err, "the scenario says where joints are held"


def test_the_srdf_says_which_arm(says, butler, monkeypatch):
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(butler.parent))
    new = "new butler.urdf --srdf butler.srdf -o"
    says(f"{new} srdf.yaml", notes=["4 joints of the group 'right_arm', tip 'right_d'"])
    says(f"{new} left.yaml --group left_arm")
    spec = Scenario.load("left.yaml").robot
    assert (spec.group, spec.tip) == ("left_arm", "left_c")
    assert Robot(spec).joint_names == ("left_1", "left_2", "left_3")
    says(f"{new} tip.yaml --tip left_c")
    assert Scenario.load("tip.yaml").build_robot().joint_names == ("lift", "left_1", "left_2", "left_3")


WRONG_OPTIONS = [
    ([], ["butler.urdf", "link 'left_d'", "'package://butler/meshes/palm.obj' not found", "package dir"]),
    (["--package-dir", "nowhere"], ["--package-dir", "'nowhere' does not exist"]),
    (["--tip", "beak"], ["--tip", "'beak'", "left_d"]),
    (["--group", "left_arm"], ["--group", "give --srdf"]),
    (["--srdf", "butler.srdf", "--group", "legs"], ["butler.srdf", "'legs'", "left_arm"]),
    (["--srdf", "butler.srdf", "--group", "broken"], ["butler.srdf", "'broken'", "'tail'"]),
    (["--srdf", "nothing.srdf"], ["srdf", "nothing.srdf' does not exist"]),
    (["--srdf", "butler.urdf"], ["srdf", "butler.urdf' must end in .srdf or .xml"]),
    (["--srdf", "empty.srdf"], ["empty.srdf", "not a valid SRDF"]),
]


@pytest.mark.parametrize(("words", "said"), WRONG_OPTIONS)
def test_wrong_options_are_one_line(refuses, words, said, butler):
    Path("empty.srdf").write_text("")
    folder = [] if not words or words[0] == "--package-dir" else ["--package-dir", butler]
    refuses(("new", "butler.urdf", "-o", "mine.yaml", *folder, *words), *said)
    assert not Path("mine.yaml").exists()


HAND = """
<robot name="hand">
  <link name="palm"/>
  <link name="finger"><collision><geometry><box size="0.02 0.02 0.1"/></geometry></collision></link>
  <joint name="slide" type="prismatic"><parent link="palm"/><child link="finger"/><origin xyz="0 0 0.1"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.004" velocity="1" effort="1"/></joint>
</robot>
"""
WRONG_URDFS = [
    ("<robot/>", "it has no link"),
    ('<robot name="r"><link name="a"/></robot>', "no joint"),
    ('<robot name="r"><xacro:include filename="b"/></robot>', "`pip install xacro`"),
    (HAND, "person, of 2000 configurations; the tip does not move from one side to the other"),
]


@pytest.mark.parametrize(("text", "said"), WRONG_URDFS)
def test_wrong_urdfs_are_one_line(refuses, text, said, urdf, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacro", None)
    urdf.write_text(text)
    refuses(f"new {urdf} -o mine.yaml", said, "scara.urdf")


def test_arguments_of_xacro_go_to_the_scenario(says, refuses, tmp_path, monkeypatch, data_folder):
    pytest.importorskip("xacro")
    monkeypatch.chdir(tmp_path)
    text = (data_folder / "gripper_arm.urdf").read_text()
    head = 'name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arg name="name" default=""/>'
    Path("arm.urdf.xacro").write_text(text.replace('name="gripper_arm">', head))
    words = "--xacro-arg name:=left"
    says(f"new arm.urdf.xacro -o mine.yaml {words}")
    assert Scenario.load("mine.yaml").build_robot().name == "left"
    says(f"srdf arm.urdf.xacro -o arm.srdf {words}")
    assert 'name="left"' in Path("arm.srdf").read_text()
    refuses(f"new arm.urdf.xacro -o other.yaml {words} {words}", "safe-ompl: --xacro-arg: 'name' is given twice")
    refuses("new arm.urdf.xacro -o other.yaml --xacro-arg name=left", "argument --xacro-arg: must be NAME:=VALUE")


# ------------------------------------------------------------------------------------------------- pick and place


def test_a_gripper_arm_gets_a_program_that_is_solved(says, tmp_path):
    panda = robots_folder() / "panda_description" / "urdf" / "panda.urdf"
    says(f"new {panda} --pick-and-place -o {tmp_path}/work.yaml", notes=["11 steps"])
    scenario = Scenario.load(tmp_path / "work.yaml")
    cube, (width, *_) = scenario.scene["cube"], scenario.scene["cube"].shape.size
    touching = {link for step in scenario.program.steps for link, _ in getattr(step, "touching", ())}
    assert touching == {"panda_leftfinger", "panda_rightfinger", "cube"}
    (closed,) = scenario.program.steps[2].joints.values()
    assert 2 * closed == pytest.approx(width, abs=1e-3)  # both fingers lie on the cube
    assert cube.pose.position[2] == pytest.approx(scenario.scene["table"].pose.position[2] + 0.02 + width / 2)
    found = plan_program(scenario)
    assert found
    held = [stretch for stretch in found.stretches if stretch.robot.attached]
    down = held[-1].robot.tip_pose(held[-1].motion.knots[-1]).rotation[:, 2]
    np.testing.assert_allclose(down, (0.0, 0.0, -1.0), atol=0.02)  # the hand looks down


def test_an_arm_without_a_gripper_gets_one_line(refuses, urdf):
    refuses(f"new {urdf} --pick-and-place -o work.yaml", "the arm with the tip 'quill' has no gripper")
    assert not Path("work.yaml").exists()


def test_limits_beside_the_srdf_are_those_of_the_scenario(says, call, refuses, urdf, tmp_path):
    """And the folder of a package has a name of its own."""
    srdf, limits = urdf.with_suffix(".srdf"), urdf.with_name("joint_limits.yaml")
    srdf.write_text('<robot name="scara"><disable_collisions link1="base" link2="outer" reason="Never"/></robot>')
    limits.write_text("joint_limits: {shoulder: {max_position: 2.0, max_velocity: 1.5}}\n")
    given = f"new {urdf} --srdf {srdf} --package parts={tmp_path} -o"
    says(f"{given} mine.yaml", notes=[f"joint limits are also read from {limits}"])
    robot = Scenario.load("mine.yaml").build_robot()
    assert robot.upper[0] == 2.0
    assert robot.spec.package_dirs == (("parts", tmp_path),)
    limits.write_text("joint_limits: {shoulder: {max_velocity: -1}}\n")
    status, _, err = call(*given.split(), "other.yaml")
    assert status == 2
    assert "joint_limits.shoulder.max_velocity: must be" in err
    refuses("plan mine.yaml --package parts", "must have the form NAME=DIR, not 'parts'")
