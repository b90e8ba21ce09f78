"""`safe-ompl new`: a robot of one's own has a scenario that can be planned, and stumbling stones have signs."""

from __future__ import annotations

import json

import numpy as np
import pytest

from safe_ompl import Scenario
from safe_ompl.cli.main import main

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
def urdf(tmp_path):
    folder = tmp_path / "robots"
    folder.mkdir()
    file = folder / "scara.urdf"
    file.write_text(SCARA)
    return file


def test_a_new_scenario_can_be_planned(urdf, tmp_path, capsys):
    file, result = tmp_path / "mine.yaml", tmp_path / "result.json"
    assert main(["new", str(urdf), "-o", str(file)]) == 0
    assert "3 joints, tip 'quill', reach 0.70 m" in capsys.readouterr().err
    scenario = Scenario.load(file)
    robot = scenario.build_robot()
    ends = np.array([scenario.start_configuration(robot), *scenario.goal_configurations(robot)])
    left, right = robot.keypoints_batch(ends)[:, -1]
    assert left[1] > 0.1 > -0.1 > right[1]  # on either side of the person
    assert scenario.scene["person"].weight == 1.0
    assert main(["plan", str(file), "--json", str(result)]) == 0
    assert json.loads(result.read_text())["certified"]


def test_nothing_is_overwritten(urdf, tmp_path, capsys):
    file = tmp_path / "mine.yaml"
    file.write_text("mine")
    assert main(["new", str(urdf), "-o", str(file)]) == 2
    assert "is there already" in capsys.readouterr().err
    assert file.read_text() == "mine"
    assert main(["new", str(urdf), "-o", str(tmp_path / "mine.json")]) == 2
    assert "must end in .yaml" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["plan", "view"])
def test_a_urdf_in_place_of_a_scenario_is_told_what_to_do(command, urdf, capsys):
    assert main([command, str(urdf)]) == 2
    assert "`safe-ompl new" in capsys.readouterr().err


def test_without_a_command_there_are_first_steps(capsys):
    with pytest.raises(SystemExit) as left:
        main([])
    assert left.value.code == 0
    assert "first steps" in capsys.readouterr().out
