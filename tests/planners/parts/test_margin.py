"""The adaptive margin: where it begins, when it falls, and that motions keep it."""

import numpy as np
import pytest

from safe_ompl.planners.rrt_connect import SafeRRTConnect
from safe_ompl.scenario.scenario import Scenario, find_scenario
from safe_ompl.setup.from_scenario import setup_scenario


@pytest.fixture(scope="module")
def shelf():
    return setup_scenario(Scenario.load(find_scenario("panda_shelf")))


def planner_on(setup, **parameters):
    planner = SafeRRTConnect(setup.getSpaceInformation(), **parameters)
    assert setup.plan(planner, time=30.0, seed=0)
    return planner


def ends_of(setup):
    path = setup.solution()
    return min(setup.checker.clearance(q).distance for q in path[[0, -1]])


def test_it_begins_with_what_start_and_goal_keep(shelf):
    planner = planner_on(shelf)
    margin = planner._margin
    margin.reset()
    margin.largest = 1.0
    margin.begin(planner._trees)
    level = margin.level
    assert 0.8 < level / (0.8 * ends_of(shelf)) <= 1.0 + 1e-3
    margin.largest = 0.01
    margin.begin(planner._trees)
    assert margin.level == level, "once"
    margin.reset()
    margin.largest = 0.01
    margin.begin(planner._trees)
    assert margin.level == 0.01


def test_paths_keep_a_margin_that_nothing_lowered(shelf):
    kept = []
    for seed in range(5):
        planner = SafeRRTConnect(shelf.getSpaceInformation(), clearance=0.02, patience=0)
        result = shelf.plan(planner, time=30.0, seed=seed)
        kept.append(planner._margin.level)
        if kept[-1]:
            assert result.report.clearance.min >= kept[-1] - 1e-6
    assert max(kept) >= 0.012, kept


def test_it_falls_with_the_refusals_and_vanishes(shelf):
    planner = planner_on(shelf)
    margin, q = planner._margin, shelf.solution()[0]
    outside = q + 10.0  # no motion there is free
    margin.reset()
    margin.level = 0.02
    levels = [margin.level]
    for _ in range(200):
        assert not margin.motion_is_free(q, outside)
        levels.append(margin.level)
    assert levels[11] == 0.02
    assert levels[12] == pytest.approx(0.012)
    assert levels[-1] == 0.0
    assert min(level for level in levels if level) >= 5e-4


def test_it_is_not_in_force_where_danger_is_not_heeded(shelf):
    planner = planner_on(shelf)
    margin, q = planner._margin, shelf.solution()[0]
    margin.level = 10.0  # nothing keeps that
    assert not margin.motion_is_free(q, q + 1e-6)
    planner._danger.heed = 0.0
    assert margin.motion_is_free(q, q + 1e-6)


def test_none_without_danger_and_none_where_it_is_off(shelf):
    for parameters in ({"alpha": 0.0}, {"clearance": 0.0}):
        assert not planner_on(shelf, **parameters)._margin.level


def test_a_motion_keeps_its_margin_or_is_refused_for_it(shelf):
    motion = shelf.getSpaceInformation().getMotionValidator().motion
    rng, robot = np.random.default_rng(0), shelf.robot
    found = {True: 0, False: 0}
    while sum(found.values()) < 60:
        start = rng.uniform(robot.lower, robot.upper)
        end = start + rng.normal(0.0, 0.1, robot.n)
        if not motion.is_free(start, end):
            assert not motion.is_free(start, end, 0.05)
            continue
        free = motion.is_free(start, end, 0.05)
        samples = (start + t * (end - start) for t in np.linspace(0.0, 1.0, 30))
        least = min(shelf.checker.clearance(q).distance for q in samples)
        found[free] += 1
        assert least >= 0.05 - 1e-6 if free else least < 0.055
    assert min(found.values()) > 5
