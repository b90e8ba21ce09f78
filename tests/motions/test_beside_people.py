"""Trajectories beside people: they stop in time, whatever happens, and say where they cannot."""

from dataclasses import replace

import numpy as np
import pytest
from limbs import Limbs, left_beside

from safe_ompl import (
    InputError,
    Obstacle,
    People,
    Person,
    Pose,
    RateLimits,
    Scene,
    StandstillError,
    UnknownNameError,
    time_path,
)
from safe_ompl.collision import CollisionChecker, MotionProver, Separation
from safe_ompl.motions import BodySpeeds, PeopleDistances
from safe_ompl.scene import BodyRegion
from safe_ompl.scene.constraints import CONTACT_TABLE

SCENE = Scene([Obstacle("person", Person(height=1.75), Pose((0.75, 0.1, -0.75)), weight=1.0)])
_EXACT = 1e-4  # [m]


@pytest.fixture(scope="session")
def timed(panda, shelf_path, shelf_motion, panda_limits):
    """Return a function that times the path past the operator."""

    def time(people, limits=panda_limits, **options):
        return time_path(shelf_path, panda, limits, motion=shelf_motion, people=people, **options)

    return time


@pytest.fixture(scope="session")
def operator(panda, shelf):
    return Limbs(panda, shelf.scene["operator"])


@pytest.mark.parametrize(
    ("people", "jerk"),
    [
        (People(), None),
        (People(speed=1.2, reaction_time=0.05, clearance=0.05), None),
        (People(speed=1.0, speeds={"right_hand": 2.0, "head": 0.3}), None),
        (People(speed=1.0), 7500.0),
        (People(speed=1.0), 1000.0),
    ],
)
def test_nobody_is_reached_whenever_she_begins_to_run(
    timed, operator, panda_limits, people, jerk, assert_within_limits
):
    """Limits hold in the motion and in its stops, which begin where it is and end at rest."""
    limits = replace(panda_limits, jerk=None if jerk is None else np.full(7, jerk))
    trajectory = timed(people, limits)
    assert 0 < left_beside(trajectory, operator, people, 80) < 0.1
    if jerk is None:
        reckless = replace(people, speed=0.8 * people.speed, reaction_time=0.0)
        assert left_beside(timed(reckless), operator, people, 80) < 0  # the adversary can win
    else:
        assert timed(people).duration < trajectory.duration < 1.3 * timed(people).duration
    assert_within_limits(trajectory)
    pushed = 0.0
    for begin in np.linspace(0, trajectory.duration, 25):
        stop, now = trajectory.stop_from(begin), trajectory.at(begin)
        np.testing.assert_allclose(stop.at(0.0).q, now.q, atol=1e-9)
        np.testing.assert_allclose(stop.at(0.0).qd, now.qd, atol=1e-6)
        if jerk is not None:
            np.testing.assert_allclose(stop.at(0.0).qdd, now.qdd, atol=1e-6)
        pushed = max(pushed, abs(now.qdd).max())
        assert_within_limits(stop)
        assert abs(stop.at(stop.duration).qd).max() < 1e-6
    assert pushed > 2


def test_where_nothing_allows_motion_it_says_where_and_who_and_what(timed, shelf_motion):
    with pytest.raises(StandstillError, match="nothing allows the robot to move at") as caught:
        timed(People(reaction_time=0.5))
    still = caught.value.standstill
    assert (still.person, still.configuration.shape) == ("operator", (7,))
    assert still.link in shelf_motion.checker.links
    assert still.limb is not None
    assert "shorten the reaction time" in still.reason
    allowed = People(reaction_time=0.5, contact=True, regions={"head": (100, 4.4, 150)})
    assert timed(allowed).duration < 60


@pytest.mark.parametrize("name", ["panda", "ur5", "slider"])
def test_no_limb_arrives_earlier_and_the_first_is_exact(robot_named, name, rng):
    robot = robot_named(name)
    limbs, settled = Limbs(robot, SCENE["person"]), 0

    def arrivals(distances, found, shift):
        """Return when limbs (M,) at distances [m] arrive that are met `shift` [m] sooner."""
        left, people = found - shift - distances.people.clearance, distances.people
        with np.errstate(divide="ignore"):
            times = left / distances.speeds
        return np.where(distances.speeds > 0, times, np.where(left > 0, np.inf, -np.inf)) - people.reaction_time

    for _ in range(4):
        speeds = {limb: float(rng.uniform(0, 2)) for limb in rng.choice(limbs.names, 5, replace=False)}
        speeds[str(rng.choice(limbs.names))] = 0.0
        contact = bool(rng.integers(2)) and name != "slider"  # whose links have no masses
        people = People(speeds=speeds, reaction_time=0.1, clearance=rng.uniform(0, 0.1), contact=contact)
        distances = PeopleDistances(robot, SCENE, people)
        curve = time_path(rng.uniform(np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5), (4, robot.n)), robot)
        curve = curve.curve
        cells = curve.cells(rng.choice([0.02, 0.1, 0.3]))
        bounds = BodySpeeds(robot).bounds(curve, cells)
        soon, short = rng.uniform(0, 0.6), rng.uniform(-0.1, 0.3)
        found = distances.along(curve, cells, BodySpeeds(robot), soon, short)
        for k in rng.integers(0, len(cells), 12):
            s = np.append(cells.centres[k], rng.uniform(cells.edges[k], cells.edges[k + 1], 3))
            exact = np.array([limbs.at(q) for q in curve.places(s).q])
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
    assert settled > 20


@pytest.mark.parametrize("name", ["panda", "slider"])
def test_no_point_of_a_body_is_faster_than_its_bound(robot_named, body_points, name, shelf_path):
    robot = robot_named(name)
    path = shelf_path if name == "panda" else [[0.1, -1, 0.05, 0.5], [0.3, 1.2, 0.2, -1.0]]
    curve = time_path(path, robot, RateLimits.of(robot, 1.0, 1.0)).curve
    cells = curve.cells(0.05)
    bounds, bodies = BodySpeeds(robot).bounds(curve, cells), body_points(robot)
    rng = np.random.default_rng(0)
    for j in rng.integers(0, len(cells), 40):
        s = rng.uniform(cells.edges[j] + 1e-5, cells.edges[j + 1] - 1e-5)
        before, after = curve.places(s + np.array([-1e-6, 1e-6])).q
        moved = [
            np.linalg.norm(new - old, axis=1).max()
            for old, new in zip(bodies.at(before), bodies.at(after), strict=True)
        ]
        tip = np.linalg.norm(robot.tip_pose(after).translation - robot.tip_pose(before).translation)
        assert (np.array([*moved, tip]) / 2e-6 <= bounds[j] * (1 + 1e-5) + 1e-8).all()


@pytest.mark.parametrize("jerk", [None, 1000.0])
@pytest.mark.parametrize("kind", ["tool_speed", "link_speed"])
def test_speeds_of_tool_and_links_are_kept(panda, timed, panda_limits, kind, jerk, assert_within_limits):
    limits = replace(panda_limits, jerk=None if jerk is None else np.full(7, jerk))
    trajectory = timed(None, limits, **{kind: 0.25})
    assert_within_limits(trajectory)
    t = np.linspace(0, trajectory.duration, 500)
    tips = np.array([panda.tip_pose(q).translation for q in trajectory.at(t).q])
    speed = np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(t)
    assert speed.max() <= 0.25 * (1 + 1e-9)
    assert kind == "link_speed" or speed.max() > 0.24


def test_in_a_tube_people_are_nearer_by_what_the_joints_may_be_off(panda):
    scene = Scene([Obstacle("person", Person(height=1.75), Pose((1.1, 0.0, -0.75)), weight=1.0)])
    start = np.array([-0.8, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8])
    path = np.array([start, start * [-1, 1, 1, 1, 1, 1, 1]])
    motion = MotionProver(CollisionChecker(panda, scene))
    tube = Separation(tube=(0.01,) * 7)
    displacement = tube.tube_displacement(motion.checker)
    assert 0.005 < displacement < 0.06
    timed = {
        clearance: time_path(path, panda, motion=proof, people=People(speed=1.2, clearance=clearance))
        for clearance, proof in ((0.0, replace(motion, separation=tube)), (displacement, motion), (1e-6, motion))
    }
    assert timed[0.0].duration == timed[displacement].duration > timed[1e-6].duration
    with pytest.raises(InputError, match="velocities"):
        time_path(path, panda, motion=replace(motion, separation=tube), tool_speed=0.5)


def test_what_cannot_be_is_refused(timed, panda, shelf_path, panda_limits):
    with pytest.raises(InputError, match="motion: give a motion"):
        time_path(shelf_path, panda, panda_limits, people=People())
    with pytest.raises(InputError, match=r"'operator' .* mm from the robot where it starts"):
        timed(People(clearance=0.9))
    with pytest.raises(UnknownNameError, match="unknown obstacle 'nobody'"):
        timed(People(who=("nobody",)))
    with pytest.raises(InputError, match=r"^people.contact: contact cannot be proven .* leave one of them out"):
        timed(People(contact=True), replace(panda_limits, jerk=np.full(7, 1e3)))
    with pytest.raises(InputError, match="time: must be"):
        timed(People()).stop_from(-1)
    with pytest.raises(InputError, match="computed without people"):
        timed(None).stop_from(0.1)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"speed": -1}, "speed: must be"),
        ({"reaction_time": -0.1}, "reaction_time: must be"),
        ({"speeds": {"right_hand": -2}}, "speeds.right_hand: must be"),
        ({"speeds": {"tail": 2}}, "speeds"),
        ({"regions": {"hand": [1, 0, 1]}}, r"regions.hand\[1\]: must be"),
        ({"who": []}, "who: must contain at least one obstacle"),
        ({"contact": "yes"}, "contact: must be"),
        ({"robot_mass": 5}, "robot_mass: unknown key"),
    ],
)
def test_people_that_are_none(given, message):
    with pytest.raises(InputError, match=message):
        People.from_mapping(given)


def test_people_as_a_document():
    people = People(who=("operator",), speeds={"left_hand": 2.0}, contact=True, regions={"hand": (100, 0.6, 75)})
    assert People.from_mapping(people.to_mapping()) == people
    assert People().to_mapping() == {}
    assert people.region_of("left_hand") == BodyRegion(100, 0.6, 75)
    assert people.region_of("right_shank") == CONTACT_TABLE["lower_leg"]
    assert people.region_of("") == CONTACT_TABLE["head"]
    assert "as if it were infinitely heavy, the person's is not counted" in people.contact_sentence
    assert "no compliance" in people.contact_sentence
    assert People().contact_sentence == ""
