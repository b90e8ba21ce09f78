"""The comparison with other planners: what is exported, what the judge says, and the processes that answer."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "bench"))
sys.path.insert(0, str(Path(__file__).parents[2] / "bench" / "peers"))

from export import export
from judge import read, samples
from processes import Runner, UnavailableError, python_of
from systems import SYSTEMS, System
from table import figure, markdown

from safe_ompl import CollisionChecker, Robot, Scene
from safe_ompl.scenario.mbm import MbmFile

POLE = {
    "name": "pole",
    "radius": 0.05,
    "length": 1.0,
    "position": [0.5, 0.0, 0.5],
    "orientation_quat_xyzw": [0, 0, 0, 1],
}
LEFT, RIGHT = [1.0, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8], [-1.0, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("peers")
    problem = {"index": 1, "start": LEFT, "goals": [RIGHT], "cylinder": [POLE]}
    file = folder / "problems.json"
    file.write_text(json.dumps({"robot": "panda", "problems": {"pole": [problem]}}))
    robot, problems = export(MbmFile.load(file), slice(None), folder)
    return robot, problems[0]


def test_the_exported_robot_has_the_same_joints_and_bodies(exported):
    description = json.loads(exported[0].read_text())
    model = pin.buildModelFromUrdf(description["urdf"])
    robot = Robot.from_example("panda")
    assert [model.names[k] for k in range(1, model.njoints)] == list(robot.joint_names)
    bodies = pin.buildGeomFromUrdf(model, description["urdf"], pin.GeometryType.COLLISION)
    assert len(bodies.geometryObjects) == len(robot.collision_model.geometryObjects)


def test_the_judge_measures_what_the_package_measures(exported):
    path, problem = exported
    robot = Robot.from_example("panda")
    checker = CollisionChecker(robot, Scene.from_mbm({"cylinder": [POLE]}))
    rng = np.random.default_rng(0)
    for q in rng.uniform(robot.lower, robot.upper, (20, 7)):
        verdict = read(path).verdict(problem, np.array([q, q]))
        assert verdict.touching == checker.in_collision(q)
        if not verdict.touching:
            assert verdict.min_clearance == pytest.approx(checker.clearance(q).distance, abs=1e-5)


def test_the_judge_sees_contacts_wrong_ends_and_length(exported):
    path, problem = exported
    straight = np.array([LEFT, RIGHT])
    verdict = read(path).verdict(problem, straight)
    assert verdict.touching
    assert verdict.ends
    assert verdict.length == pytest.approx(2.0)
    assert not read(path).verdict(problem, straight[::-1]).ends


def test_samples_are_no_farther_apart_than_asked():
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.25]])
    steps = np.linalg.norm(np.diff(samples(path, 0.1), axis=0), axis=1)
    assert steps.max() <= 0.1 + 1e-12
    assert steps.sum() == pytest.approx(1.25)


@pytest.mark.parametrize("name", ["safe_ompl, raw", "OMPL RRTConnect + simplifier, 0.02"])
def test_a_runner_answers_with_a_path_and_its_times(exported, tmp_path, name):
    robot, problem = exported
    system = next(s for s in SYSTEMS if s.name == name)
    runner = Runner(system, robot, tmp_path)
    try:
        answer = runner.ask({**problem, "seed": 1, "time": 10.0})
    finally:
        runner.close()
    verdict = read(robot).verdict(problem, np.array(answer["path"]))
    assert verdict.ends
    assert min(answer[key] for key in ("building", "planning", "smoothing")) >= 0


def test_a_runner_that_ends_is_reported_with_its_last_words(exported, tmp_path):
    robot, _ = exported
    with pytest.raises(UnavailableError, match="ended"):
        Runner(System("broken", "no_such_runner"), robot, tmp_path)


def test_what_pip_did_not_install_is_reported_with_the_reason(tmp_path):
    environment = tmp_path / "absent"
    environment.mkdir()
    (environment / "made").write_text("no")
    (tmp_path / "absent.log").write_text("ERROR: no matching distribution\n")
    with pytest.raises(UnavailableError, match="no matching distribution"):
        python_of(System("absent", "x", "absent", ("absent",)), tmp_path)


def test_the_table_tells_contacts_and_what_was_not_run(tmp_path):
    solved = {
        "building": 0.01,
        "planning": 0.02,
        "smoothing": 0.03,
        "solved": True,
        "touching": True,
        "near": 0.0,
    }
    solved |= {"min_clearance": 0.01, "mean_clearance": 0.1, "length": 2.0}
    solved |= {"mean_danger": 1.0, "peak_danger": 2.0, "integral_danger": 2.0}
    failed = {"building": 0.01, "planning": 5.0, "smoothing": 0.0, "solved": False}
    text = markdown({"one": [solved, failed]}, {"other": "no wheel"})
    assert "| one | 1/2 | 1 | 10 | 20 (20) | 30 | 60 (60) |" in text
    assert "Not run: **other** (no wheel)." in text
    figure({"one": [solved], "two": [failed]}, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 5000
