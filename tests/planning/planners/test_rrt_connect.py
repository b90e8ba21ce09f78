"""SafeRRTConnect: its steps, its threshold, what clears and what stays, and its company in OMPL."""

import subprocess
import sys
from functools import partial

import numpy as np
from ompl import tools as ot
from plane import EXACT, TIMEOUT, HotSpot, PlaneProblem, SlopedHotSpot, Stop, wall_with_a_gap

from safe_ompl import SafeRRTConnect, SafeSetup, Scenario
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import find_scenario

Problem = partial(PlaneProblem, SafeRRTConnect)


def test_small_steps_heed_the_termination_condition():
    task = Problem(range=1e-5)
    stop = Stop(task.walls, 500)
    assert task.solve(stop.condition) == TIMEOUT
    assert stop.checked_too_late <= 2, "one step"


# ---------------------------------------------------------------------------------------------------------- promises


def test_clear_keeps_the_parameters():
    task = Problem(alpha=0.25, range=0.3, nearest_fraction=0.5)
    task.planner.clear()
    assert (task.planner.getAlpha(), task.planner.getRange(), task.planner.getNearestFraction()) == (0.25, 0.3, 0.5)


def test_another_objective_is_noticed():
    task, classical = Problem(wall_with_a_gap), Problem(wall_with_a_gap)
    task.problem.setOptimizationObjective(HotSpot(task.si))
    assert task.solve() == classical.solve() == EXACT
    assert task.path.shape != classical.path.shape or (task.path != classical.path).any()


# -------------------------------------------------------------------------------------------------------- other spaces


def test_through_the_benchmark(ur5, clutter):
    setup = SafeSetup(ur5, clutter, danger=None)
    start, goal = np.array([0.0, -1.6, 1.2, -1.2, -1.57, 0.0]), np.array([1.2, -1.6, 1.2, -1.2, -1.57, 0.0])
    setup.setConfigurations(start, goal)
    benchmark = ot.Benchmark(setup, "ur5")
    benchmark.addPlannerAllocator(lambda si: SafeRRTConnect(si, "safe"))
    request = ot.Request(5.0, 4096.0, 4)
    request.displayProgress = request.saveConsoleOutput = False
    request.simplify = False
    benchmark.benchmark(request)
    runs = benchmark.getRecordedExperimentData().planners[0].runs
    assert len(runs) == 4
    assert all(run["correct solution BOOLEAN"] == "1" for run in runs)
    assert len({run["solution length REAL"] for run in runs}) > 1, "runs differ"


# -------------------------------------------------------------------------------------------------------- with a robot


SCRIPT = """
import numpy as np
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene
from safe_ompl.geometry.obstacle import Obstacle
from safe_ompl.geometry.pose import Pose
from safe_ompl.geometry.basic import Sphere
from safe_ompl.planning.safe_setup import SafeSetup

scene = Scene((Obstacle("ball", Sphere(0.1), Pose((0.5, 0.0, 0.6)), weight=1.0),))
setup = SafeSetup(Robot.from_example("ur5"), scene)
setup.setConfigurations([0.8, -1.6, 1.2, -1.2, -1.57, 0.0], [-0.8, -1.6, 1.2, -1.2, -1.57, 0.0])
for seed in (0, 0, 1):
    result = setup.plan(seed=seed)
    assert result, result.status
    print("PATH" + result.path.tobytes().hex())
"""


def test_a_process_ends_quietly_and_repeats_itself():
    run = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, timeout=100)
    assert run.returncode == 0, run.stderr
    assert "leaked" not in run.stderr
    assert "rror" not in run.stderr
    first, again, other = (line for line in run.stdout.splitlines() if line.startswith("PATH"))
    assert first == again
    assert first != other


# -------------------------------------------------------------------------------------------- the adaptive threshold


def avoidable_danger(setup, seed, **options):
    planner = SafeRRTConnect(setup.getSpaceInformation(), **options)
    result = setup.plan(planner, time=20.0, seed=seed)
    assert result
    return result.report.danger.avoidable


def test_the_threshold_keeps_the_peak_of_the_danger_low():
    setup = setup_scenario(Scenario.load(find_scenario("panda_shelf")))
    with_it, without = (
        np.mean([avoidable_danger(setup, seed, threshold_rise=rise) for seed in range(5)]) for rise in (0.05, 0.0)
    )
    assert with_it < 0.5 * without


def test_a_threshold_does_not_close_a_dangerous_passage():
    """Start and goal are harmless; the only gap lies in the middle of the hot spot."""

    def hot_gap(x, y):
        return abs(x) < 0.1 and abs(y) > 0.1

    for seed in range(4):
        problem = Problem(hot_gap, SlopedHotSpot, seed=seed, threshold_rise=0.01, danger_decay=0)
        assert problem.solve() == EXACT
