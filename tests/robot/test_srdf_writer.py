"""The SRDF that is written: a robot that reads it checks the same pairs as without one."""

import xml.etree.ElementTree as ElementTree

import numpy as np
from self_pairs import self_pairs

from safe_ompl import Robot
from safe_ompl.apps import main
from safe_ompl.robot import UrdfFile, disabled_links, find_example, robots_folder


def test_round_trip(data_folder, tmp_path, capsys):
    srdf = tmp_path / "twin.srdf"
    assert main(["srdf", str(data_folder / "twin_arm.urdf"), "-o", str(srdf)]) == 0
    text = srdf.read_text()
    assert "of 1000 configurations" in text
    assert "samples: 0 pairs of links always touch, 6 are adjacent" in capsys.readouterr().err
    with_srdf = Robot.from_urdf(data_folder / "twin_arm.urdf", srdf)
    assert self_pairs(with_srdf) == self_pairs(Robot.from_urdf(data_folder / "twin_arm.urdf"))


def test_round_trip_of_a_robot_whose_links_always_touch(robot_named, tmp_path):
    name = "so101"
    urdf, srdf = robots_folder() / find_example(name).urdf, tmp_path / "found.srdf"
    options = ["--package-dir", str(robots_folder().parents[1])]
    assert main(["srdf", str(urdf), "-o", str(srdf), *options]) == 0
    reasons = [tag.get("reason") for tag in ElementTree.parse(srdf).iter("disable_collisions")]
    assert "Adjacent" in reasons
    example = find_example(name)
    again = Robot.from_urdf(urdf, srdf, [robots_folder().parents[1]], example.tip, example.locked)
    assert self_pairs(again) <= self_pairs(robot_named(name))


def test_links_that_always_touch(edited):
    urdf = edited("gripper_arm.urdf", '<box size="0.06 0.12 0.04"/>', '<sphere radius="0.5"/>')
    found = {(pair.first, pair.second): pair.reason for pair in disabled_links(UrdfFile(urdf), 300)}
    assert found["upper", "hand"] == "Always"
    assert found["base", "upper"] == "Adjacent"


def test_to_standard_output(data_folder, capsys):
    assert main(["srdf", str(data_folder / "gripper_arm.urdf")]) == 0
    root = ElementTree.fromstring(capsys.readouterr().out)
    assert root.get("name") == "gripper_arm"
    assert np.all([tag.get("link1") for tag in root])
