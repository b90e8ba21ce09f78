"""Timing again and again: beside people who have moved, from the middle of a motion, and with coarser cells."""

from dataclasses import replace

import numpy as np
import pytest
from test_people_caps import Limbs, adversary

from safe_ompl import InputError, PathTimer, People, Pose, Scene, StandstillError, time_path

PEOPLE = People(speed=1.0)


@pytest.fixture
def timer(panda, shelf_motion, panda_limits):
    return PathTimer(panda, panda_limits, motion=shelf_motion, people=PEOPLE)


def stepped(scene, by):
    """Return the scene with its person somewhere else."""
    person = scene["operator"]
    x, y, z = person.pose.position
    there = replace(person, pose=Pose((x + by, y, z), person.pose.quaternion_xyzw))
    return Scene(tuple(there if o.name == "operator" else o for o in scene))


def test_it_times_as_time_path_does(timer, panda, shelf_path, shelf_motion, panda_limits):
    for _ in range(2):
        once = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=PEOPLE)
        assert timer.time(shelf_path).duration == once.duration


def test_coarser_cells_are_as_proven_and_cost_little_time(timer, panda, shelf, shelf_path):
    fine = timer.time(shelf_path).duration
    for cells in (60, 100):
        coarse = timer.time(shelf_path, cells=cells)
        assert len(coarse.law.edges) < 300
        assert fine <= coarse.duration < 1.25 * fine
        assert adversary(coarse, Limbs(panda, shelf.scene["operator"]), PEOPLE, 60) > 0


def test_the_rest_of_a_motion_goes_on_as_it_was(timer, shelf_path):
    whole = timer.time(shelf_path)
    for share in (0.0, 0.2, 0.5, 0.9):
        begin = share * whole.duration
        rest = timer.retimed(whole, begin)
        np.testing.assert_allclose(rest.at(0.0).q, whole.at(begin).q, atol=1e-9)
        np.testing.assert_allclose(rest.at(0.0).qd, whole.at(begin).qd, atol=1e-6)
        np.testing.assert_allclose(rest.at(rest.duration).q, shelf_path[-1], atol=1e-9)
        assert rest.duration == pytest.approx(whole.duration - begin, rel=0.05, abs=0.02)


def test_beside_a_person_who_has_moved_it_is_slower_or_says_so(timer, panda, shelf, shelf_path):
    whole = timer.time(shelf_path)
    away = stepped(shelf.scene, 0.3)
    timer.move(away)
    begin = 0.3 * whole.duration
    faster = timer.retimed(whole, begin)
    assert faster.duration < whole.duration - begin
    assert adversary(faster, Limbs(panda, away["operator"]), PEOPLE, 60) > 0
    timer.move(stepped(shelf.scene, -0.07))
    slower = timer.retimed(whole, 0.0)
    assert slower.duration > whole.duration
    with pytest.raises(StandstillError, match="stop"):
        timer.retimed(faster, 0.3 * faster.duration)
    timer.move(shelf.scene)
    assert timer.time(shelf_path).duration == whole.duration


def test_what_cannot_be_is_refused(timer, panda, shelf, shelf_path, panda_limits):
    with pytest.raises(InputError, match="no people who could move"):
        PathTimer(panda, panda_limits).move(shelf.scene)
    with pytest.raises(InputError, match="unknown obstacle 'operator'"):
        timer.move(shelf.scene.without("operator"))
    with pytest.raises(InputError, match="time must be"):
        timer.retimed(timer.time(shelf_path), 99.0)
    assert "PathTimer(" in repr(timer)
