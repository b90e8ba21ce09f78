"""`safe-ompl verify`: certificates are checked where they were written, elsewhere, and against what has changed."""

import json
import shutil
from pathlib import Path

import pytest

from safe_ompl.cli import main
from safe_ompl.cli.verify import certificate_of
from safe_ompl.paths.certificate.schema import digest
from safe_ompl.scenario.scenario import Scenario, find_scenario
from safe_ompl.setup.from_scenario import setup_scenario


@pytest.fixture
def call(capfd):
    """Return a function that runs the command line and returns status, output and errors."""

    def run(*arguments):
        capfd.readouterr()
        status = main([str(argument) for argument in arguments])
        out, err = capfd.readouterr()
        return status, out, err

    return run


@pytest.fixture
def written(call, tmp_path, monkeypatch):
    """Return a folder with a scenario of its own and `proof.json`, the certificate of a path there."""
    source = find_scenario("planar3").resolve()
    folder = tmp_path / "here"
    (folder / "robots").mkdir(parents=True)
    shutil.copy(source, folder / "planar3.yaml")
    for file in (source.parent / "robots").glob("planar3.*"):
        shutil.copy(file, folder / "robots" / file.name)
    monkeypatch.chdir(folder)
    assert call("plan", "planar3.yaml", "--certificate", "proof.json")[0] == 0
    return folder


def test_it_says_what_it_is_about_and_what_is_not_claimed(call, written):
    status, out, err = call("verify", "proof.json")
    assert (status, err) == (0, "")
    first, second, third = out.splitlines()
    assert first.startswith("proof.json: every motion is free: ")
    assert second == "proof.json: robot planar3 and scene of planar3.yaml: person, machine, bin, post"
    assert third == "proof.json: not claimed: clearance, moving obstacles, tool"


def test_elsewhere_it_verifies_by_itself(call, written, tmp_path, monkeypatch):
    shutil.copy(written / "proof.json", tmp_path / "proof.json")
    shutil.rmtree(written)
    monkeypatch.chdir(tmp_path)
    status, out, err = call("verify", "proof.json")
    assert (status, err) == (0, "")
    assert "robot planar3 and scene that it carries: " in out


def test_what_has_changed_here_is_refused_unless_what_it_carries_is_asked_for(call, written):
    scenario = Scenario.load(written / "planar3.yaml")
    moved = scenario.scene.without(scenario.scene.names[0])
    (written / "planar3.yaml").unlink()
    Scenario(**{**vars(scenario), "scene": moved, "file": None}).save(written / "planar3.yaml")
    status, out, err = call("verify", "proof.json")
    assert (status, out) == (1, "")
    assert err == "safe-ompl: proof.json: the scene has changed since it was written\n"
    assert call("verify", "proof.json", "--carried")[0] == 0
    assert call("verify", "proof.json", "planar3.yaml")[0] == 1


def test_a_certificate_without_a_source_verifies_by_what_it_carries(call, written):
    content = json.loads((written / "proof.json").read_text())
    content = {**content, "source": {}}
    (written / "proof.json").write_text(json.dumps({**content, "digest": digest(content)}))
    status, out, _ = call("verify", "proof.json")
    assert status == 0
    assert "scene that it carries" in out


def test_what_is_carried_is_checked(call, written):
    content = json.loads((written / "proof.json").read_text())
    content["scene"]["content"]["obstacles"].pop()
    (written / "proof.json").write_text(json.dumps({**content, "digest": digest(content)}))
    status, out, err = call("verify", "proof.json", "--carried")
    assert (status, out) == (1, "")
    assert err == "safe-ompl: proof.json: the scene that it carries is not the one that it was written for\n"


def test_a_carried_robot_may_be_replaced_by_its_files(call, written, tmp_path):
    urdf = written / "robots" / "planar3.urdf"
    assert call("verify", "proof.json", "--carried", "--urdf", urdf)[0] == 0
    thicker = tmp_path / "thicker.urdf"
    assert 'radius="0.045"' in urdf.read_text()
    thicker.write_text(urdf.read_text().replace('radius="0.045"', 'radius="0.046"'))
    status, _, err = call("verify", "proof.json", "--carried", "--urdf", thicker)
    assert status == 1
    assert "the robot has changed: 'planar3'" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["planar3.yaml", "--carried"], "--carried: either, or the scenario 'planar3.yaml'"),
        (
            ["--urdf", "robots/planar3.urdf"],
            "--urdf or --package-dir: is for robots that a certificate carries",
        ),
        (["--carried", "--urdf", "nothing.urdf"], "URDF file 'nothing.urdf' does not exist"),
        (["--carried", "--package-dir", "nothing"], "package folder 'nothing' does not exist"),
    ],
)
def test_options_that_do_not_fit(call, written, options, message):
    status, out, err = call("verify", "proof.json", *options)
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_what_a_setup_proves_of_moving_obstacles_stands_in_its_certificate(call, written):
    scenario = Scenario.load(written / "planar3.yaml")
    setup = setup_scenario(scenario, scenario.build_robot())
    assert setup.getMovingObstacles() == ({}, 0.0)
    setup.setMovingObstacles({"person": 0.1}, 0.5)
    result = setup.plan("SafeRRTConnect", time=20, seed=0)
    content = certificate_of(result, setup, scenario, scenario.robot, str(written / "moving.json"))
    assert content["moving_obstacles"] == {"speeds": {"person": 0.1}, "time": 0.5}
    Path("moving.json").write_text(json.dumps(content))
    status, out, err = call("verify", "moving.json")
    assert (status, err) == (0, "")
    assert "the same while obstacles move no faster than person 0.1 m/s, for 0.5 s" in out
    assert "not claimed: clearance, tool\n" in out


def test_a_robot_of_a_scenario_that_holds_something_travels(call, tmp_path, monkeypatch):
    """On a base, with a mesh in the gripper: nothing of it is left where it is verified."""
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    shutil.copy(Path(__file__).parents[1] / "data" / "wedge.obj", here / "wedge.obj")
    (here / "held.yaml").write_text(
        """
robot:
  example: ur5
  base: {position: [0, 0, 0.5]}
  attached:
    - {name: part, link: tool0, position: [0, 0, 0.1], mesh: {file: wedge.obj, scale: [0.05, 0.05, 0.05]}, danger: true}
scene:
  obstacles:
    - {name: post, position: [0.9, 0.9, 0.5], box: {size: [0.1, 0.1, 1]}, weight: 1}
start: [0, -1.5, 0.5, 0.3, 0.2, 0]
goal: {configuration: [0.4, -1.5, 0.6, 0.3, 0.2, 0]}
"""
    )
    monkeypatch.chdir(here)
    assert call("plan", "held.yaml", "--certificate", there / "proof.json")[0] == 0
    monkeypatch.chdir(there)
    shutil.rmtree(here)
    status, out, err = call("verify", "proof.json", "--carried")
    assert (status, err) == (0, "")
    assert "robot ur5 and scene that it carries: post" in out
