"""SafeRRTConnect: its trees and steps, its threshold, and its company in OMPL."""

import _thread
import threading
from functools import partial

import numpy as np
import pytest
from plane import APPROXIMATE, EXACT, PlaneProblem, SlopedHotSpot, Stop, walled_in

from safe_ompl import SafeRRTConnect, make_planner

Problem = partial(PlaneProblem, SafeRRTConnect)


def test_small_steps_heed_the_termination_condition():
    task = Problem(range=1e-5)
    stop = Stop(task.walls, 500)
    assert task.solve(stop.condition) == APPROXIMATE
    assert stop.checked_too_late <= 2, "one step"


@pytest.mark.parametrize("alpha", [0.0, 1.0])
def test_ctrl_c_ends_the_loop(arm_between_walls, alpha):
    planner = SafeRRTConnect(arm_between_walls.getSpaceInformation(), alpha=alpha)
    threading.Timer(0.1, _thread.interrupt_main).start()
    with pytest.raises(KeyboardInterrupt):
        arm_between_walls.plan(planner, time=1e6)


@pytest.mark.parametrize("name", ["SafeRRTConnect", "ClassicRRTConnect", "PaperSafeRRTConnect"])
def test_the_tree_outside_grows_less_while_the_other_is_walled_in(name):
    task = PlaneProblem(lambda si: make_planner(name, si, {"range": 0.25, "iterations": 900}), walled_in, SlopedHotSpot)
    assert task.solve(60.0) == APPROXIMATE
    outside = len(task.planner.plannerGraph().configurations)
    if name == "PaperSafeRRTConnect":  # whose trees alternate
        assert outside > 350
    else:
        assert 100 < outside < 200, "every second turn at first, then one of nine"


def test_shorter_steps_lead_into_a_pocket():
    task = Problem(lambda x, y: x > 0.3 and (abs(y) > 0.02 or x > 0.9), SlopedHotSpot, range=0.5)
    assert task.solve() == EXACT


def test_the_threshold_keeps_the_peak_of_the_danger_low(shelf):
    def avoidable_danger(rise):
        planner = SafeRRTConnect(shelf.getSpaceInformation(), threshold_rise=rise)
        return np.mean([shelf.plan(planner, time=20.0, seed=seed).report.danger.avoidable for seed in range(5)])

    assert avoidable_danger(0.05) < 0.5 * avoidable_danger(0.0)


def test_a_threshold_does_not_close_a_dangerous_passage():
    """Start and goal are harmless; the only gap lies in the middle of the hot spot."""
    for seed in range(4):
        gap = {"threshold_rise": 0.01, "danger_decay": 0}
        assert Problem(lambda x, y: abs(x) < 0.1 and abs(y) > 0.1, SlopedHotSpot, seed=seed, **gap).solve(60.0) == EXACT
