"""Proofs as tests: `assert_proven`, and the marker of pytest; with cases of the trackers that samples pass."""

from itertools import pairwise

import numpy as np
import pytest

from safe_ompl import CollisionChecker, Motion, Obstacle, Pose, Scenario, Scene, Sphere, assert_proven, check

pytest_plugins = ("pytester",)

NAMES = ("joint1", "joint2")
SWEEP = Motion.hermite([0.0, 2.0], [[-1.0, 0.0], [1.0, 0.0]], names=NAMES)
CORNER = np.array([[-0.5, 0.0], [0.0, 1.5], [0.5, 0.0]])
BLEND = Motion([0.0, 1.0], [[CORNER[0], 2 * (CORNER[1] - CORNER[0]), CORNER[0] - 2 * CORNER[1] + CORNER[2]]], NAMES)
POINTS = np.array([[0.0, 0.0], [0.6, 0.0], [0.6, 0.0], [0.0, 0.0]])
SPLINE = Motion.hermite([0.0, 1.0, 2.0, 3.0], POINTS, [[0, 0], [1, 0], [-1, 0], [0, 0]], names=NAMES)


def outside(angle, depth, bend=0.0, radius=5e-4):
    """Return where a small ball is that the arm's tip goes into by a depth, at an angle and a bend of its joints."""
    tip = 0.5 * np.exp(1j * angle) + 0.4 * np.exp(1j * (angle + bend))  # round, with a radius of 4 cm
    place = tip * (1 + (0.04 + radius - depth) / abs(tip))
    return np.array([place.real, place.imag, 0.0])


CASES = {
    # moveit#236: by default states are checked 5 % of the space's extent apart; something thin stands between two.
    "thin": (SWEEP, np.linspace(-1, 1, 4)[:, None] * [1, 0], outside(0.0, 0.1)),
    # moveit2#3759: a thousand way points, all of them verified, and yet it touches.
    "graze": (SWEEP, np.linspace(-1, 1, 1000)[:, None] * [1, 0], outside(0.0, 9e-6)),
    # curobo#450: what is checked is not what is driven: a corner is blended, a spline overshoots.
    "blend": (BLEND, np.vstack([np.linspace(a, b, 200) for a, b in pairwise(CORNER)]), outside(0.0, 0.01, bend=0.75)),
    "spline": (SPLINE, POINTS, outside(0.84, 0.02)),
}


def scenario_with(ball):
    pole = Obstacle("pole", Sphere(5e-4), Pose(ball))
    robot = Scenario.load("planar2").robot
    return Scenario("cell", robot, Scene([pole]), [-1.2, 0.0], {"configuration": [1.2, 0.0]})


@pytest.mark.parametrize("case", CASES)
def test_samples_are_fine_but_the_motion_touches(case):
    motion, samples, ball = CASES[case]
    scenario = scenario_with(ball)
    robot = scenario.build_robot()
    checker = CollisionChecker(robot, scenario.scene)
    assert min(checker.pair_distances(q).min() for q in samples) > 0  # which is what the other system asks
    with pytest.raises(AssertionError, match=r"collision at .* s: 'link2' and 'pole'"):
        assert_proven(motion, scenario)
    found = check(motion, robot, scenario.scene).violations
    found = [one for one in found if one.decided]
    assert all(one.kind == "collision" and one.value < 0 for one in found), found
    assert checker.pair_distances(motion.at(found[0].at)).min() < 0  # there it is


def test_the_marker_fails_when_a_recorded_motion_is_no_longer_proven(pytester):
    save_csv = "time,joint1,joint2\n0,-1,0\n2,1,0\n"
    pytester.path.joinpath("swing.csv").write_text(save_csv)
    scenario_with(outside(0.0, -0.1)).save(pytester.path / "free.yaml")
    scenario_with(outside(0.0, 0.1)).save(pytester.path / "blocked.yaml")
    pytester.makepyfile("""
        import pytest

        @pytest.mark.proven("swing.csv", "free.yaml", tube=0.001)
        def test_free():
            pass

        @pytest.mark.proven("swing.csv", "blocked.yaml")
        def test_blocked():
            pass

        @pytest.mark.proven("swing.csv", "free.yaml", tube=0.2)
        def test_wide():
            pass
    """)
    found = pytester.runpytest("-p", "safe_ompl.apps.proven", "--strict-markers")
    found.assert_outcomes(passed=1, failed=2)
    found.stdout.fnmatch_lines(["*swing.csv: not proven:*", "*collision at * s: 'link2' and 'pole', -*mm*"])


def test_a_start_that_touches_is_no_proof_either():
    scenario = scenario_with(outside(-1.2, 0.01))
    with pytest.raises(AssertionError, match=r"planar2|cell.*not proven.*start.*pole"):
        assert_proven(SWEEP, scenario)
