"""The scripts in examples/ are short and run as they stand."""

import re
import runpy
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from safe_ompl import People, Shield, Surroundings, Tracker
from safe_ompl.live import TrackedBody
from safe_ompl.live.simulation import ALL_KEYPOINTS, ContactMonitor, limb_solids

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
    with_ros = [FOLDER / "ros" / "world.py"]  # see tests/live/ros/test_ros_node.py
    found = [script.relative_to(FOLDER).as_posix() for script in (*SCRIPTS, *ADAPTERS, *PHYSICS, *with_ros)]
    assert sorted(listed) == sorted(found)


@pytest.mark.parametrize("shielded", [True, False])
def test_a_robot_behind_send_action_touches_nobody_while_it_moves(shielded):
    example = SimpleNamespace(**runpy.run_path(str(FOLDER / "send_action.py")))
    robot, people, tick, now = example.robot, {}, example.shield.tick, 0.0
    inner = example.StandIn([*example.keys, "gripper.pos"], [*example.start, 0.0])
    arm, monitor = inner, ContactMonitor(robot)
    if shielded:
        around = Surroundings(example.scene, {"anna": Tracker(ALL_KEYPOINTS)}, people=People(speed=1.6))
        arm = example.ShieldedRobot(inner, Shield(robot, around), lambda: people, lambda: now)
    touched, error, before = 0, [], example.start
    for now in np.arange(0.0, 4.0, tick):
        people["anna"] = example.body + np.array([0.45 + 1.6 * max(0.0, 2.0 - now), 0.0, 0.0])
        wave = example.start + 0.6 * np.sin(2.0 * now) * np.eye(7)[0]
        asked = dict(zip(example.keys, np.degrees(wave).tolist(), strict=True)) | {"gripper.pos": 40.0}
        assert arm.send_action(asked)["gripper.pos"] == 40.0
        q = np.radians([inner.get_observation()[key] for key in example.keys])
        error.append(np.abs(q - wave).max())
        body = TrackedBody(1.75)
        solids = limb_solids("anna", body, body.completed(ALL_KEYPOINTS.keypoints(people["anna"]))[0])
        moves, before = np.abs(q - before).max() > 1e-6, q
        touched += bool(moves and monitor.nearest(q, solids).distance <= 0)
    assert max(error[10:20]) < 0.1  # while she is far away, it follows
    assert bool(touched) != shielded
