"""When limbs arrive at the robot: bounds that hold, and are exact where they decide, against coal's distances."""

import numpy as np
import pinocchio as pin
import pytest
from limbs import Limbs

from safe_ompl import Obstacle, People, Pose, Scene, time_path
from safe_ompl.collision import DISTANCE_ERROR
from safe_ompl.geometry import Box, Mesh, Person
from safe_ompl.trajectories import BodySpeeds, PeopleDistances

SCENE = Scene([Obstacle("person", Person(height=1.75), Pose((0.75, 0.1, -0.75)), weight=1.0)])
_EXACT = 1e-4  # [m]


def arrivals(distances, found, shift):
    """Return when limbs (M,) at distances [m] arrive that are met `shift` [m] sooner."""
    left, people = found - shift - distances.people.clearance, distances.people
    with np.errstate(divide="ignore"):
        times = left / distances.speeds
    return np.where(distances.speeds > 0, times, np.where(left > 0, np.inf, -np.inf)) - people.reaction_time


def random_curve(robot, rng):
    """Return a curve of three straight motions with random blends or stops, and its cells."""
    lower, upper = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    path = rng.uniform(lower, upper, (4, robot.n))
    curve = time_path(path, robot).curve
    return curve, curve.cells(rng.choice([0.02, 0.1, 0.3]))


@pytest.mark.parametrize("name", ["panda", "ur5", "slider"])
def test_no_limb_arrives_earlier_and_the_first_is_exact(robot_named, name, rng):
    robot, limbs = robot_named(name), Limbs(robot_named(name), SCENE["person"])
    settled = 0
    for _ in range(6):
        speeds = {limb: float(rng.uniform(0, 2)) for limb in rng.choice(limbs.names, 5, replace=False)}
        speeds[str(rng.choice(limbs.names))] = 0.0
        contact = bool(rng.integers(2)) and name != "slider"  # whose links have no masses
        people = People(speeds=speeds, reaction_time=0.1, clearance=rng.uniform(0, 0.1), contact=contact)
        distances = PeopleDistances(robot, SCENE, people)
        curve, cells = random_curve(robot, rng)
        bounds = BodySpeeds(robot).bounds(curve, cells)
        soon, short = rng.uniform(0, 0.6), rng.uniform(-0.1, 0.3)
        found = distances.along(curve, cells, bounds, soon, short)
        for k in rng.integers(0, len(cells), 12):
            s = np.append(cells.centres[k], rng.uniform(cells.edges[k], cells.edges[k + 1], 3))
            exact = np.array([limbs.at(q) for q in curve.at(s).q])
            assert (found.distances[k] <= exact).all()
            assert (found.times[k] <= np.array([arrivals(distances, at, 0.0) for at in exact])).all()
            # In the middle of the cell nothing is lost but the motion of the nearest body.
            moved = bounds[k, found.nearest[k]] * cells.sizes[k] / 2
            sooner = arrivals(distances, exact[0], moved + _EXACT)
            moving = distances.speeds > 0
            first = np.where(moving, found.times[k], np.inf).min()
            settles = moving & (found.times[k] < soon) & (exact[0] > 0)  # coal says how deep bodies overlap
            settles &= (found.times[k] <= first) | (contact & (found.times[k] < short))
            assert (found.times[k] >= sooner)[settles].all()
            settled += settles.sum()
    assert settled > 30


def test_bodies_that_are_not_convex_are_measured_where_their_hulls_do_not_do(panda, rng, tmp_path, monkeypatch):
    """A frame about the arm: its hull holds the robot, and it does not."""
    width = 0.04
    bars = [((0, 1.4), (3.0, width)), ((0, -1.4), (3.0, width)), ((1.4, 0), (width, 3.0)), ((-1.4, 0), (width, 3.0))]
    faces, corners = [], []
    for (x, y), (a, b) in bars:
        box = np.array(
            [[sx * a / 2 + x, sy * b / 2 + y, sz * 0.05] for sx in (-1, 1) for sy in (-1, 1) for sz in (-1, 1)]
        )
        for quad in ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)):
            i, j, k, m = (c + len(corners) for c in quad)
            faces += [(i, j, k), (i, k, m)]
        corners += box.tolist()
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {i + 1} {j + 1} {k + 1}" for i, j, k in faces]
    (tmp_path / "frame.obj").write_text("\n".join(lines))
    frame = Obstacle("frame", Mesh(tmp_path / "frame.obj", convex=False), Pose((0.0, 0.0, 0.4)))
    scene = Scene([frame, Obstacle("box", Box((0.1, 0.1, 0.1)), Pose((0.9, 0.0, 0.4)))])
    people = People(who=("frame", "box"), speed=1.0)
    distances = PeopleDistances(panda, scene, people)
    limbs = {name: Limbs(panda, scene[name]) for name in people.who}
    curve, cells = random_curve(panda, rng)
    bounds = BodySpeeds(panda).bounds(curve, cells)
    found = distances.along(curve, cells, bounds, np.inf)
    asked, ask = [], pin.computeDistance
    monkeypatch.setattr(pin, "computeDistance", lambda *given: (asked.append(1), ask(*given))[1])
    for k in rng.integers(0, len(cells), 40):
        q = curve.at(cells.centres[k : k + 1]).q[0]
        exact = np.array([limbs[name].at(q)[0] for name in people.who])
        assert (found.distances[k] <= exact).all()
        first = int(found.times[k].argmin())
        if exact[first] <= 0:
            continue
        moved = bounds[k, found.nearest[k, first]] * cells.sizes[k] / 2
        assert found.times[k, first] >= arrivals(distances, exact, moved + _EXACT)[first]
    times = distances.times_at(curve.at(cells.centres[:5]).q)
    assert 0 < len(asked) <= 5 * len(distances.moving)  # the box is convex
    for q, time in zip(curve.at(cells.centres[:5]).q, times, strict=True):
        exact = np.array([limbs[name].at(q)[0] for name in people.who])
        assert exact.min() > 0
        assert time == pytest.approx(arrivals(distances, exact, DISTANCE_ERROR).min(), abs=_EXACT)


def test_bodies_without_bounds_are_measured(panda, rng):
    distances = PeopleDistances(panda, SCENE, People())
    curve, cells = random_curve(panda, rng)
    bounds = BodySpeeds(panda).bounds(curve, cells)
    by_bounds = distances.along(curve, cells, bounds, 0.5)
    distances._bounded = False
    measured = distances.along(curve, cells, bounds, 0.5)
    first = by_bounds.times.argmin(axis=1), measured.times.argmin(axis=1)
    rows = np.arange(len(cells))
    near = measured.times[rows, first[1]] < 0.5
    assert near.any()
    np.testing.assert_allclose(by_bounds.times[rows, first[0]][near], measured.times[rows, first[1]][near], atol=_EXACT)
