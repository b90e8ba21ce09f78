"""The comparison with other planners: what is exported, what the judge says, and the processes that answer."""

import json

import numpy as np
import pinocchio as pin
import pytest

from bench._plain import SPACING, Judge, samples
from bench.peers import judged, processes, table
from bench.peers.export import export
from bench.peers.processes import Runner
from bench.peers.systems import SYSTEMS, System
from safe_ompl import CollisionChecker, Motion, Robot, Scene
from safe_ompl.scene import MbmFile

POLE = {"name": "pole", "radius": 0.05, "length": 1.0, "position": [0.5, 0.0, 0.5]}
POLE |= {"orientation_quat_xyzw": [0, 0, 0, 1]}
SCENE = Scene.from_mbm({"cylinder": [POLE]})
LEFT, RIGHT = [1.0, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8], [-1.0, 0.3, 0.0, -1.6, 0.0, 1.9, 0.8]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("peers")
    problem = {"index": 1, "start": LEFT, "goals": [RIGHT], "cylinder": [POLE]}
    beyond = {**problem, "index": 2, "goals": [RIGHT, [9.0, *RIGHT[1:]]]}
    file = folder / "problems.json"
    file.write_text(json.dumps({"robot": "panda", "problems": {"pole": [problem, beyond]}}))
    robot, problems, outside = export(MbmFile.load(file), slice(None), folder)
    assert [(problem.name, problem.blocked) for problem in problems] == [("pole 1", False)]
    assert outside == ["pole 2"]
    return robot, problems[0]


def test_the_exported_robot_has_the_same_joints_and_bodies(exported):
    description = json.loads(exported[0].read_text())
    model = pin.buildModelFromUrdf(description["urdf"])
    robot = Robot.from_example("panda")
    assert [model.names[k] for k in range(1, model.njoints)] == list(robot.joint_names)
    bodies = pin.buildGeomFromUrdf(model, description["urdf"], pin.GeometryType.COLLISION)
    assert len(bodies.geometryObjects) == len(robot.collision_model.geometryObjects)


@pytest.mark.parametrize("name", ["safe_ompl, raw", "OMPL RRTConnect + simplifier, 0.02"])
def test_a_runner_answers_with_a_path_and_its_times(exported, tmp_path, name):
    robot, problem = exported
    system = next(s for s in SYSTEMS if s.name == name)
    runner = Runner(system, robot, tmp_path)
    try:
        answer = runner.ask({**problem.question, "seed": 1, "time": 10.0}, processes.WARMING)  # kernels may be compiled
    finally:
        runner.close()
    run = judged(answer, problem, 1)
    assert run["solved"]
    if name == "safe_ompl, raw":  # the other one may touch between its samples
        assert not run["touching"]
    assert min(answer[key] for key in ("building", "planning", "smoothing")) >= 0


NO_ANSWERS = [
    (None, "no path"),
    ([LEFT], "the path has other ends"),
    ([LEFT, RIGHT[:5]], "way points"),
    ([LEFT, LEFT], "the path has other ends"),
    ([LEFT, [9.0, *LEFT[1:]], RIGHT], "'panda_joint1' is 6.1 outside its limits"),
    ([LEFT, [np.nan, *LEFT[1:]], RIGHT], "way points"),
]


@pytest.mark.parametrize(("path", "error"), NO_ANSWERS)
def test_what_is_no_answer_is_not_solved(exported, path, error):
    answer = {"path": path, "building": 0.0, "planning": 0.0, "smoothing": 0.0}
    run = judged(answer, exported[1], 0)
    assert not run["solved"]
    assert error in run["error"]


FAKE = """
import os, sys, time
sys.path.insert(0, {folder!r})
from protocol import serve

class Fake:
    def __init__(self, robot, options):
        self.answered = 0

    def build(self, problem):
        self.order = problem["order"]

    def plan(self, seed, seconds):
        self.answered += 1
        if self.order == "raise":
            raise ValueError("start is in collision")
        if self.order == "end":
            os.kill(os.getpid(), 9)
        if self.answered == 1:
            time.sleep(2.0)  # kernels are compiled
        return [[0.0], [1.0]]

    def smooth(self, path):
        return path

serve(Fake)
"""


ORDER = {"seed": 0, "time": 0.1, "order": "solve"}


@pytest.fixture
def comparison(exported, tmp_path, monkeypatch):
    (tmp_path / "fake.py").write_text(FAKE.format(folder=str(processes.RUNNERS)))
    monkeypatch.setattr(processes, "RUNNERS", tmp_path)
    monkeypatch.setattr(processes, "GRACE", 1.0)
    systems = (System("fake", "fake"), System("other", "fake"))
    comparison = processes.Comparison(systems, exported[0], tmp_path)
    yield comparison
    comparison.close()


def test_warming_up_may_take_longer_than_any_answer(comparison):
    comparison.warm_up(ORDER)
    for _ in range(2):
        answers = comparison.ask(ORDER)
        assert [answer["path"] for answer in answers.values()] == [[[0.0], [1.0]]] * 2
    assert not comparison.unavailable


def test_an_error_is_of_one_problem_alone(comparison):
    comparison.warm_up(ORDER)
    failed = comparison.ask({**ORDER, "order": "raise"})
    assert failed["fake"]["error"] == "ValueError: start is in collision"
    assert failed["fake"]["path"] is failed["other"]["path"] is None
    assert comparison.ask(ORDER)["fake"]["path"] == [[0.0], [1.0]]
    assert not comparison.unavailable


def test_a_process_that_ends_is_started_anew_but_not_for_ever(comparison, monkeypatch):
    monkeypatch.setattr(processes, "GRACE", 30.0)
    for end in range(processes.STARTS):
        assert comparison.ask(ORDER)["fake"]["path"] == [[0.0], [1.0]]
        assert "ended" in comparison.ask({**ORDER, "order": "end"})["fake"]["error"]
        assert ("fake" in comparison.unavailable) == (end == processes.STARTS - 1)
    assert set(comparison.unavailable) == {"fake", "other"}
    assert comparison.ask(ORDER) == {}


# ---------------------------------------------------------------------------------------------------- tables


def run_of(total, danger, touching=False):
    times = {"building": 0.0, "planning": total, "smoothing": 0.0}
    judged = dict.fromkeys(("min_clearance", "mean_clearance", "near", "peak_danger", "integral_danger", "length"), 1.0)
    return {"solved": True, "touching": touching, "times": times, "mean_danger": danger, **judged}


def test_a_planner_stands_beside_its_repaired_paths(tmp_path):
    runs = {"safe_ompl": [run_of(0.01, 9.0)], "other, 0.05": [run_of(0.02, 12.0, True), run_of(0.04, 12.0)]}
    runs[f"other, 0.05{table.WITH_OURS}"] = [run_of(0.05, 13.0), run_of(0.05, 13.0)]
    header, rows = table.comparison(runs)
    found = {"header": list(header), "rows": [list(row) for row in rows]}
    assert table.compact(found)[1] == [
        ("safe_ompl", "0 of 1", "10 (10)", "9", "–"),
        ("other, 0.05", "1 of 2", "30 (38)", "12", "50 (50)"),
    ]
    table.figure(found, tmp_path / "figure.png")
    assert (tmp_path / "figure.png").stat().st_size > 10_000


def test_without_its_sources_a_system_is_left_out_with_the_reason(exported, tmp_path, monkeypatch):
    monkeypatch.delenv("VAMP_DIR", raising=False)
    comparison = processes.Comparison([s for s in SYSTEMS if s.name == "VAMP"], exported[0], tmp_path)
    assert comparison.unavailable == {"VAMP": "VAMP_DIR does not name a folder with its sources"}


# ------------------------------------------------------------------------------------------------ the judge

AROUND = [LEFT, [1.0, -1.2, 0.0, -2.6, 0.0, 1.9, 0.8], [-1.0, -1.2, 0.0, -2.6, 0.0, 1.9, 0.8], RIGHT]


@pytest.fixture(scope="module")
def panda():
    return Robot.from_example("panda")


def test_the_judge_knows_contact_clearance_and_length(panda):
    judge = Judge(panda, SCENE)
    verdict = judge.verdict(Motion.through([LEFT, RIGHT]))
    assert verdict.touching
    assert verdict.length == pytest.approx(2.0)
    assert verdict.worst.other == "pole"
    assert verdict.worst.distance < -0.04  # the forearm passes through the middle of the pole, whose radius is 50 mm
    free = judge.verdict(Motion.through(AROUND))
    assert not free.touching
    clearances = [CollisionChecker(panda, SCENE).clearance(q).distance for q in samples(Motion.through(AROUND), 0.005)]
    assert free.min_clearance == pytest.approx(min(clearances), abs=1e-3)
    assert free.mean_clearance == pytest.approx(np.mean(clearances), rel=0.01)


def test_samples_that_are_left_out_touch_nothing(panda):
    # Graze the pole: the first contact must be the one that all samples show.
    judge, checker = Judge(panda, SCENE), CollisionChecker(panda, SCENE)
    rng = np.random.default_rng(1)
    found = 0
    for _ in range(6):
        start = np.array(LEFT) + rng.uniform(-0.2, 0.2, 7)
        motion = Motion.through([start, start - [rng.uniform(0.5, 1.2), 0, 0, 0, 0, 0, 0]])
        every = any(checker.in_collision(q) for q in samples(motion, 0.002))
        found += every
        assert judge.verdict(motion).touching or not every
    assert 0 < found < 6


def test_a_curve_that_comes_back_is_sampled_densely(panda):
    # One piece from a configuration back to itself: q + 4 u (1 − u) d, whose ends show no motion.
    far = np.zeros(7)
    far[0] = -2.0
    motion = Motion([0.0, 1.0], np.array([[LEFT, 4 * far, -4 * far]]))
    rows = samples(motion, SPACING)
    assert np.linalg.norm(np.diff(rows, axis=0), axis=1).max() <= SPACING
    assert np.abs(np.diff(rows, axis=0)).sum() == pytest.approx(4.0, rel=1e-3)
    assert Judge(panda, SCENE).verdict(motion).touching
