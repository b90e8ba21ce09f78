"""The types of what users call: a script of the pages' own Python passes `mypy --strict`."""

import subprocess
import sys

import pytest
from snippets import ROOT, python_of

PAGES = ("README.md", "docs/scenarios.md")
OWN = """
mesh, cloud = Mesh("wall.stl", scale=[1, 1, 1]), PointCloud(0.01, "cloud.ply")
way = Motion.through([[0.0], [1.0]], names=["a"])
if setup.solve(1.0):
    print(setup.solution())
"""


@pytest.mark.end_to_end
def test_a_script_of_a_user_is_typed(tmp_path):
    pytest.importorskip("mypy")
    script = tmp_path / "script.py"
    own = f"from safe_ompl import Mesh, Motion, PointCloud\n{OWN}"
    script.write_text("\n".join([*(python_of(ROOT / page) for page in PAGES), own]), encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--cache-dir", str(tmp_path), str(script)]
    found = subprocess.run(command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert found.returncode == 0, found.stdout
