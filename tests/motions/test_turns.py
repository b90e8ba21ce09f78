"""Continuous joints turn as their numbers stand, whoever gives the numbers; a path that is not clear is refused."""

from itertools import pairwise

import numpy as np
import pytest
from crank import CRANK
from hypothesis import given, settings, strategies as st

import safe_ompl
from safe_ompl import InputError, Motion, MotionProver, PlanResult, Robot, SafeSetup, Scene, Sphere, read_motion
from safe_ompl.certificates import certificate, motion_certificate, verify
from safe_ompl.robot import ScratchState


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Return a robot of one joint without limits that turns a ball half a metre from it."""
    file = tmp_path_factory.mktemp("wheel") / "wheel.urdf"
    file.write_text(CRANK.replace('type="revolute"', 'type="continuous"'))
    return Robot.from_urdf(file)


def scene(angle):
    """Return a ball where the robot's is at an angle."""
    position = 0.5 * np.array([np.cos(angle), np.sin(angle), 0.0])
    return Scene([safe_ompl.Obstacle("ball", Sphere(0.05), safe_ompl.Pose(tuple(position)))])


def passes(path, angle):
    """Return whether a path of numbers comes near to an angle."""
    fine = np.concatenate([np.linspace(a, b, 2000) for a, b in pairwise(path)])
    return bool((2 * np.abs(np.sin((fine - angle) / 2)) * 0.5 < 0.1).any())


@pytest.mark.parametrize("planner", ["SafeRRTConnect", "SafePRM", "RRTConnect"])
@pytest.mark.parametrize("start", [4.0, -9.5, 40.0, 0.5, -np.pi, np.pi])
def test_a_path_begins_in_the_turn_in_which_the_robot_stands(wheel, start, planner):
    """A robot that stands at 4 rad must not be sent to -2.28 rad; by how much it turns is what any turn would need."""
    setup, turn = SafeSetup(wheel, scene(start + np.pi)), ((start + np.pi) % (2 * np.pi)) - np.pi
    setup.setConfigurations([start], [start + 0.9])
    for simplify in (False, 0.1):
        path = setup.plan(planner, time=5.0, simplify=simplify).path
        np.testing.assert_allclose(path[[0, -1], 0], [start, start + 0.9], atol=1e-12 * (1 + abs(start)))
        np.testing.assert_array_equal(setup.solution(), path)
    assert setup.query.start == [start]
    setup = SafeSetup(wheel, Scene([]))  # in OMPL's words angles are in [-π, π)
    ends = ScratchState(setup.bridge), ScratchState(setup.bridge)
    setup.setStartAndGoalStates(*(end.set(np.array([q])) for end, q in zip(ends, (start, start + 0.9), strict=True)))
    assert setup.solve(5.0)
    np.testing.assert_allclose(setup.solution()[0, 0], turn, atol=1e-12 * (1 + abs(start)))


FORMS = {
    "array": lambda way, file: way,
    "result": lambda way, file: PlanResult("Exact", way, None, "P", 1, ("turn",), 0.1),
    "timed": lambda way, file: Motion.through(way, range(len(way))),
    "file": lambda way, file: read_motion(np.savetxt(file, way, header="turn", comments="") or file),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    ("path", "angle"),
    [([0.0, 6.2], np.pi), ([2.0, -2.0], 0.0), ([2.0, -2.0], np.pi), ([0.0, 3.1, 6.2], np.pi), ([3.0, 3.3], -1.0)],
)
def test_a_check_is_of_the_numbers_as_they_stand(wheel, tmp_path, form, path, angle):
    motion, others = FORMS[form](np.array(path)[:, None], tmp_path / "way.csv"), scene(angle)
    found = safe_ompl.check(motion, wheel, others)
    assert bool(found) != passes(path, angle)
    assert bool(SafeSetup(wheel, others, danger=None).check(motion)) == bool(found)
    long = np.abs(np.diff(path)).max() > np.pi
    assert ("as its numbers stand" in str(found)) == long
    if found:
        held = verify(motion_certificate(found), wheel, others)
        assert held
        assert SafeSetup(wheel, others, danger=None).repair(motion).how == "unchanged"


@settings(max_examples=20)
@given(path=st.lists(st.floats(-7.0, 7.0), min_size=2, max_size=4), angle=st.floats(-3.1, 3.1))
def test_nothing_that_passes_an_obstacle_is_proven(wheel, path, angle):
    """By the numbers as they stand, of all that takes a path; the short way where a path of OMPL has states."""
    others, way = scene(angle), np.array(path)[:, None]
    if not safe_ompl.check(way, wheel, others):
        return
    assert not passes(path, angle)
    setup = SafeSetup(wheel, others, danger=None)
    long = np.abs(np.diff(path)).max() > np.pi
    prover = MotionProver(setup.checker)
    calls = (
        lambda: setup.is_free(way),
        lambda: safe_ompl.prove_many(way[:-1], way[1:], wheel, others).all(),
        lambda: certificate(way, wheel, others),
        lambda: setup.report(way).certified,
        lambda: safe_ompl.time_path(way, wheel, motion=prover, tolerance=0.0) if np.ptp(path) > 1e-3 else True,
    )
    for call in calls:
        if long:
            with pytest.raises(InputError, match=r"joint 'turn' turns by .* more than half a turn: add a way point"):
                call()
        else:
            assert call()


def test_planned_paths_count_turns(wheel):
    """So that a controller that takes the numbers as they stand goes the way that is proven."""
    others = scene(0.0)
    setup = SafeSetup(wheel, others, danger=None)
    setup.setConfigurations([2.5], [-2.5])
    result = setup.plan(time=5.0, seed=1)
    assert result.report.certified
    assert result.path[-1, 0] == pytest.approx(2 * np.pi - 2.5)
    assert not passes(result.path[:, 0], 0.0)
    assert safe_ompl.check(result, wheel, others)
    assert result.timed().at([1e3]).q[0] == pytest.approx(result.path[-1])
