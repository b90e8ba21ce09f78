"""Options of the command line that say which joints of a robot move, where others are held, and what collides."""

import json

import pytest

from safe_ompl import InputError, Robot
from safe_ompl.apps import main
from safe_ompl.robot import RobotSpec

SRDF = """<robot name="twin_arm">
  <group name="left_arm"><chain base_link="torso" tip_link="left_hand"/></group>
  <group_state name="up" group="both"><joint name="lift" value="0.3"/></group_state>
</robot>"""

SCENARIO = """\
name: test
robot: {{urdf: {urdf}, srdf: twin.srdf}}
start: {{left_shoulder: 0.2, left_elbow: 0.2}}
goal:
  configuration: {{left_shoulder: -0.2, left_elbow: -0.2}}
scene:
  obstacles:
    - {{name: post, box: {{size: [0.1, 0.1, 0.3]}}, position: [3.0, 0.0, 0.0], weight: 1}}
"""


@pytest.fixture
def folder(tmp_path, data_folder, monkeypatch):
    (tmp_path / "twin.srdf").write_text(SRDF)
    (tmp_path / "test.yaml").write_text(SCENARIO.format(urdf=data_folder / "twin_arm.urdf"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_group_and_posture(folder, capsys):
    options = ["--group", "left_arm", "--locked-state", "up", "--lock", "right_slide=0.1", "-v"]
    assert main(["plan", "test.yaml", "--json", "-", *options]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["joint_names"] == ["left_shoulder", "left_elbow"]
    assert "held, as not in the group 'left_arm': right_shoulder = 0, right_turn = 0" in " ".join(err.split())
    assert "lift = 0" not in err


def test_unknown_group_is_one_line(folder, capsys):
    assert main(["plan", "test.yaml", "--group", "legs"]) == 2
    assert "unknown group 'legs'; known: left_arm" in " ".join(capsys.readouterr().err.split())


def test_links_without_collision_shapes_are_listed(capsys):
    assert main(["robots"]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("z1"))
    assert "link01, link05" in line


def test_visual_shapes_for_a_scenarios_robot(folder, data_folder, capsys):
    text = (data_folder / "twin_arm.urdf").read_text().replace("collision>", "visual>")
    (folder / "bare.urdf").write_text(text)
    (folder / "wedge.obj").write_bytes((data_folder / "wedge.obj").read_bytes())
    robot = ["--urdf", "bare.urdf", "--srdf", "twin.srdf", "--group", "left_arm"]
    assert main(["plan", "test.yaml", *robot]) == 2
    assert "no moving link has a collision shape" in " ".join(capsys.readouterr().err.split())
    assert main(["plan", "test.yaml", *robot, "--collision", "visual"]) == 0


def test_specs_keep_what_they_were_given(folder, data_folder):
    spec = RobotSpec(
        urdf=data_folder / "twin_arm.urdf",
        srdf=folder / "twin.srdf",
        group="left_arm",
        locked_state="up",
        collision="visual",
    )
    assert RobotSpec.from_mapping(spec.to_mapping(folder), folder) == spec
    assert Robot(spec).joint_names == ("left_shoulder", "left_elbow")
    with pytest.raises(InputError, match="unknown collision 'meshes'; known: required"):
        RobotSpec(example="ur5", collision="meshes")
