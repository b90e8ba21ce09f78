"""The adaptive margin: where it begins, when it falls, and that motions keep it."""

import numpy as np
import pytest

from safe_ompl import Scenario
from safe_ompl.planning.planners.parts.clearance import AdaptiveMargin, PenaltyMargin
from safe_ompl.planning.planners.parts.problem import DangerWeight
from safe_ompl.scene import find_scenario


@pytest.fixture
def danger(shelf_problem):
    return DangerWeight(shelf_problem)


@pytest.fixture
def margin(shelf_problem, danger):
    return AdaptiveMargin(shelf_problem, danger)


@pytest.fixture
def ends(shelf):
    scenario = Scenario.load(find_scenario("panda_shelf"))
    goals = scenario.goal_configurations(shelf.robot)
    return [scenario.start_configuration(shelf.robot)[None], np.array(goals[:1])]


def test_it_begins_with_what_start_and_goal_keep(shelf, margin, ends):
    kept = min(shelf.checker.clearance(q).distance for Q in ends for q in Q)
    margin.largest = 1.0
    margin.begin_between(ends)
    level = margin.level
    assert 0.8 < level / (0.8 * kept) <= 1.0 + 1e-3
    margin.largest = 0.01
    margin.begin_between(ends)
    assert margin.level == level, "once"
    margin.reset()
    margin.begin_between(ends)
    assert margin.level == 0.01


def test_it_falls_with_the_refusals_and_vanishes(margin, ends):
    q = ends[0][0]
    outside = q + 10.0  # no motion there is free
    margin.level = 0.02
    levels = [margin.level]
    for _ in range(200):
        assert not margin.motion_is_free(q, outside)
        levels.append(margin.level)
    assert levels[11] == 0.02
    assert levels[12] == pytest.approx(0.012)
    assert levels[-1] == 0.0
    assert min(level for level in levels if level) >= 5e-4


def test_it_is_not_in_force_while_danger_has_no_weight(margin, danger, ends):
    q = ends[0][0]
    margin.level = 10.0  # nothing keeps that
    assert not margin.motion_is_free(q, q + 1e-6)
    danger.scale = 0.0
    assert margin.motion_is_free(q, q + 1e-6)


def test_none_without_danger_and_none_where_it_is_off(margin, danger, ends):
    margin.begin_between(ends)
    assert margin.level is None, "its largest value is 0"
    margin.largest, danger.alpha = 0.05, 0.0
    margin.begin_between(ends)
    assert margin.level is None


def test_penalties_ask_for_less_each_time_and_then_for_nothing(shelf_problem, danger):
    margin = PenaltyMargin(shelf_problem, danger)
    margin.level = 0.04
    assert [margin.after(penalties) for penalties in range(3)] == pytest.approx([0.04, 0.012, 0.0])
    margin.lower()
    assert margin.after(0) == pytest.approx(0.024)
    margin.lower()
    assert margin.after(0) == 0.0, "less than is worth while"
    margin.level = 0.04
    danger.scale = 0.0
    assert margin.after(0) == 0.0


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
