"""The scripts in examples/ are short and run as they stand."""

import re
import runpy
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "examples"
SCRIPTS = sorted(FOLDER.glob("*.py"))
ADAPTERS = sorted((FOLDER / "adapters").glob("*.py"))
PACKAGES = ("meshcat", "mujoco", "pybullet", "rclpy")
PHYSICS = [FOLDER / "mujoco" / f"{name}.py" for name in ("follow", "world_as_scene")]


@pytest.mark.parametrize("script", [*SCRIPTS, *ADAPTERS, *PHYSICS], ids=lambda script: script.stem)
def test_it_is_short_and_runs(script, tmp_path, monkeypatch, capfd):
    text = script.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 60
    for package in re.findall(r"\(pip install (\w+)\)", text):
        pytest.importorskip(package, reason=f"{script.name} needs {package}, which is not installed here")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(script)])
    runpy.run_path(str(script), run_name="__main__")
    assert capfd.readouterr().out


@pytest.mark.parametrize(
    ("script", "package"),
    [
        (script, package)
        for script in (*ADAPTERS, *PHYSICS, FOLDER / "ros" / "world.py")
        for package in PACKAGES
        if package in script.read_text(encoding="utf-8")
    ],
    ids=lambda value: getattr(value, "stem", value),
)
def test_it_says_what_to_install(script, package, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, "servo_robot", raising=False)
    with pytest.raises(SystemExit, match=rf"^{package} is missing.*: .*pip install [\w'\[\]-]+$"):
        runpy.run_path(str(script), run_name="__main__")


def test_the_list_of_examples_is_complete():
    listed = re.findall(r"\]\(([\w/]+\.py)\)", (FOLDER / "README.md").read_text(encoding="utf-8"))
    with_ros = [FOLDER / "ros" / "world.py"]  # see tests/apps/exchange/test_ros_node.py
    found = [script.relative_to(FOLDER).as_posix() for script in (*SCRIPTS, *ADAPTERS, *PHYSICS, *with_ros)]
    assert sorted(listed) == sorted(found)
