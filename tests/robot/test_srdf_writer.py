"""The SRDF that is written: a robot that reads it checks the same pairs as without one."""

import xml.etree.ElementTree as ElementTree

from self_pairs import self_pairs

from safe_ompl import Robot
from safe_ompl.apps import main
from safe_ompl.robot import UrdfFile, disabled_links


def test_round_trip(data_folder, tmp_path, capsys):
    srdf = tmp_path / "twin.srdf"
    assert main(["srdf", str(data_folder / "twin_arm.urdf"), "-o", str(srdf)]) == 0
    assert "of 1000 configurations" in srdf.read_text()
    assert "samples: 0 pairs of links always touch, 6 are adjacent" in capsys.readouterr().err
    with_srdf = Robot.from_urdf(data_folder / "twin_arm.urdf", srdf)
    assert self_pairs(with_srdf) == self_pairs(Robot.from_urdf(data_folder / "twin_arm.urdf"))
    assert main(["srdf", str(data_folder / "gripper_arm.urdf")]) == 0
    assert ElementTree.fromstring(capsys.readouterr().out).get("name") == "gripper_arm"


def test_links_that_always_touch(edited):
    urdf = edited("gripper_arm.urdf", '<box size="0.06 0.12 0.04"/>', '<sphere radius="0.5"/>')
    found = {(pair.first, pair.second): pair.reason for pair in disabled_links(UrdfFile(urdf), 300)}
    assert found["upper", "hand"] == "Always"
    assert found["base", "upper"] == "Adjacent"
