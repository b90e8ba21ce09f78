"""A plain OMPL and Pinocchio script becomes a safe one by changing three lines, which tests/test_readme.py counts."""

import subprocess
import sys
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from safe_ompl import CollisionChecker, PathReport, Robot, Scene
from safe_ompl.robot import find_example, robots_folder

EXAMPLES = Path(__file__).parent / "examples"
PILLAR = {"name": "pillar", "box": {"size": [0.15, 0.15, 1.0]}, "position": [0.45, 0.0, 0.4], "weight": 1}


@pytest.mark.parametrize("name", ["plain.py", "safe.py"])
def test_both_run(name):
    folder, arm = robots_folder(), find_example("ur5")
    files = [str(folder / arm.urdf), str(folder / arm.srdf), str(folder.parent.parent)]
    run = subprocess.run(
        [sys.executable, str(EXAMPLES / name), *files], capture_output=True, text=True, timeout=60, check=True
    )
    said = [line for line in run.stderr.splitlines() if "compiling kernels" not in line]
    assert said == []
    rows = [line for line in run.stdout.splitlines() if line and (line[0].isdigit() or line[0] == "-")]
    path = np.loadtxt(StringIO("\n".join(rows)))
    np.testing.assert_allclose(path[[0, -1], 0], [0.9, -0.9])
    robot = Robot.from_urdf(files[0], files[1], [files[2]])
    report = PathReport.of(path, CollisionChecker(robot, Scene.from_mapping({"obstacles": [PILLAR]})))
    assert report.certified or name == "plain.py"
