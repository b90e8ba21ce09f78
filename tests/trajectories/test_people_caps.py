"""Trajectories beside people: they stop in time, whatever happens, and say where they cannot."""

import logging
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from limbs import Limbs

from safe_ompl import (
    InputError,
    Obstacle,
    People,
    Person,
    Pose,
    RateLimits,
    Scenario,
    Scene,
    StandstillError,
    UnknownNameError,
    time_path,
)
from safe_ompl.certificates.issue import trajectory_claim
from safe_ompl.collision import CollisionChecker, MotionProver, Separation
from safe_ompl.geometry import LIMBS
from safe_ompl.people import CalibratedReach
from safe_ompl.scene import BodyRegion, find_scenario
from safe_ompl.scene.people import CONTACT_TABLE
from safe_ompl.trajectories import BodySpeeds, contact_speed


def adversary(trajectory, limbs, people, number):
    """Return the least that is left when people run at the robot while it stops, over stops from many instants [m]."""
    reach = None if people.reach is None else CalibratedReach.load(people.reach)

    def grown(name, time):
        calibrated = reach is not None and name in reach.limbs
        return reach.grown(name, time) if calibrated else people.speed_of(name) * time

    least = np.inf
    for begin in np.random.default_rng(0).uniform(0, trajectory.duration, number):
        stop = trajectory.stop_from(begin)
        moving = np.linspace(0, stop.duration, 5)[:-1] if stop.duration > 1e-6 else []
        for t in [*moving, stop.duration * (1 - 1e-6)]:
            q, qd, _ = stop.at(t)
            if np.abs(qd).max(initial=0) > 1e-9:
                gone = [grown(name, people.reaction_time + t) for name in limbs.names]
                least = min(least, (limbs.at(q) - gone).min() - people.clearance)
    return least


@pytest.mark.parametrize(
    "people",
    [
        People(),
        People(speed=1.2, reaction_time=0.05, clearance=0.05),
        People(speed=1.0, speeds={"right_hand": 2.0, "head": 0.3}),
    ],
)
def test_nobody_is_reached_whenever_she_begins_to_run(panda, shelf, shelf_path, shelf_motion, panda_limits, people):
    trajectory = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=people)
    limbs = Limbs(panda, shelf.scene["operator"])
    left = adversary(trajectory, limbs, people, 150)
    assert 0 < left < 0.1
    reckless = People(speed=0.8 * people.speed, speeds=people.speeds, reaction_time=0.0)
    faster = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=reckless)
    assert adversary(faster, limbs, people, 150) < 0  # the adversary can win


def reach_file(folder, growth, gate=4.0):
    """Return a reach file of the limbs of a person, with horizons of 0.05, 0.1 and 0.4 s."""
    reach = CalibratedReach("recording12", gate, 0.9, 20, (0.05, 0.1, 0.4), growth, ("a",), ("b",))
    reach.save(folder / "reach.yaml")
    return folder / "reach.yaml"


def test_nobody_who_keeps_to_a_calibrated_reach_is_reached(
    panda, shelf, shelf_path, shelf_motion, panda_limits, tmp_path
):
    growth = dict.fromkeys(LIMBS, (0.06, 0.1, 0.28)) | {"right_hand": (0.15, 0.25, 0.5), "head": (0.01, 0.02, 0.1)}
    del growth["left_foot"]
    people = People(speed=0.5, reaction_time=0.05, clearance=0.02, reach=reach_file(tmp_path, growth))
    trajectory = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=people)
    limbs = Limbs(panda, shelf.scene["operator"])
    assert 0 < adversary(trajectory, limbs, people, 150) < 0.1
    # A bound of the speed that is never less costs more time, one that is too low does not stop in time.
    slow, fast = (replace(people, reach=None, speed=speed) for speed in (0.5, 3.0))
    with pytest.raises(StandstillError):
        time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=replace(fast, speed=8.0))
    rash = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=slow)
    assert adversary(rash, limbs, people, 150) < 0
    assert time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=fast).duration > trajectory.duration


def test_a_reach_that_is_a_speed_gives_the_trajectory_of_that_speed(
    panda, shelf_path, shelf_motion, panda_limits, tmp_path
):
    file = reach_file(tmp_path, dict.fromkeys(LIMBS, (0.05, 0.1, 0.4)))
    reached, fast = (
        time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=people)
        for people in (People(reach=file), People(speed=1.0))
    )
    assert reached.duration == pytest.approx(fast.duration, rel=1e-9)
    with pytest.raises(InputError, match=r"people\.reach: a certificate states speeds of people"):
        trajectory_claim(reached, panda, shelf_motion.checker.scene)


def test_nobody_is_reached_beside_another_robot(ur5):
    scenario = Scenario.load(find_scenario("ur5_handover"))
    motion = MotionProver(CollisionChecker(ur5, scenario.scene))
    start, goal = scenario.start_configuration(ur5), scenario.goal_configurations(ur5)[0]
    path = [start, [0.6, -1.9, 2.2, -2.0, -1.57, 0], [-0.8, -1.9, 2.2, -2.0, -1.57, 0], goal]
    people = People(speed=0.8, reaction_time=0.05)
    limits = RateLimits.of(ur5, acceleration=8.0)
    trajectory = time_path(path, ur5, limits, motion=motion, people=people)
    assert trajectory.duration > time_path(path, ur5, limits, motion=motion).duration
    assert adversary(trajectory, Limbs(ur5, scenario.scene["colleague"]), people, 100) > 0


def test_limits_hold_and_stops_keep_them_too(panda, shelf_path, shelf_motion, panda_limits):
    trajectory = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=People())
    for motion in (trajectory, *(trajectory.stop_from(t) for t in np.linspace(0, trajectory.duration, 40))):
        state = motion.at(np.linspace(0, motion.duration, 2000))
        assert (abs(state.qd) <= panda_limits.velocity * (1 + 1e-9)).all()
        assert (abs(state.qdd) <= panda_limits.acceleration * (1 + 1e-9)).all()


def test_stops_begin_where_the_trajectory_is_and_end_at_rest(panda, shelf_path, shelf_motion, panda_limits):
    trajectory = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=People())
    for t in np.linspace(0, trajectory.duration, 30):
        stop = trajectory.stop_from(t)
        np.testing.assert_allclose(stop.at(0).q, trajectory.at(t).q, atol=1e-9)
        np.testing.assert_allclose(stop.at(0).qd, trajectory.at(t).qd, atol=1e-6)
        assert abs(stop.at(stop.duration).qd).max() < 1e-6
    with pytest.raises(InputError, match="time must be"):
        trajectory.stop_from(-1)
    with pytest.raises(InputError, match="made without people"):
        time_path(shelf_path, panda, panda_limits).stop_from(0.1)


def test_slower_people_and_a_path_that_keeps_away_mean_faster_motions(panda, shelf_path, shelf_motion, panda_limits):
    def duration(path, **people):
        return time_path(path, panda, panda_limits, motion=shelf_motion, people=People(**people)).duration

    assert duration(shelf_path) > 1.5 * duration(shelf_path, speed=0.8)
    assert duration(shelf_path, speed=0) == pytest.approx(duration(shelf_path, speed=0.01), rel=0.05)
    nearer = [shelf_path[0], [0.7, -0.5, 0, -2.2, 0, 3.0, 0.785], *shelf_path[2:]]
    assert duration(nearer, speed=1.3) > duration(shelf_path, speed=1.3)


def test_cells_are_fine_enough(panda, shelf_path, shelf_motion, panda_limits, monkeypatch):
    found = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=People()).duration
    monkeypatch.setattr("safe_ompl.trajectories.timing.CELL_LENGTH", 0.001)
    fine = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=People()).duration
    assert fine * (1 - 1e-6) <= found <= 1.05 * fine


def test_where_nothing_allows_motion_it_says_where_and_who_and_what(panda, shelf_path, shelf_motion, panda_limits):
    with pytest.raises(StandstillError, match="nothing allows the robot to move at") as caught:
        time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=People(reaction_time=0.5))
    still = caught.value.standstill
    assert still.person == "operator"
    assert still.link in shelf_motion.checker.links
    assert still.limb is not None
    assert "shorten the reaction time" in still.reason
    assert still.configuration.shape == (7,)
    allowed = People(reaction_time=0.5, contact=True, regions={"head": (100, 4.4, 150)})
    assert time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=allowed).duration < 60


def test_contact_lets_the_robot_be_slow_where_separation_would_stop_it(panda, shelf_path, shelf_motion, panda_limits):
    apart = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=People())
    touching = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=People(contact=True))
    assert touching.duration < 0.9 * apart.duration
    least = {cap.name: cap.least for cap in touching.caps[2:]}
    assert list(least) == ["separation", "contact", "clamping"]
    assert np.isfinite(least["clamping"])


def test_speed_of_a_contact_is_that_of_the_formula():
    chest = CONTACT_TABLE["chest"]
    assert contact_speed(chest, 10.0) == pytest.approx(280 / np.sqrt(8.0 * 25e3))
    assert contact_speed(CONTACT_TABLE["head"], 10.0) == 0
    people = People(regions={"hand": [100, 0.6, 75]})
    assert people.region_of("left_hand") == BodyRegion(100, 0.6, 75)
    assert people.region_of("right_shank") == CONTACT_TABLE["lower_leg"]
    assert people.region_of("") == CONTACT_TABLE["head"]


@pytest.mark.parametrize("name", ["panda", "slider"])
def test_no_point_of_a_body_is_faster_than_its_bound(robot_named, name, shelf_path, panda_limits):
    robot = robot_named(name)
    path = shelf_path if name == "panda" else [[0.1, -1, 0.05, 0.5], [0.3, 1.2, 0.2, -1.0]]
    limits = RateLimits.of(robot, 1.0, 1.0)
    curve = time_path(path, robot, limits).curve
    cells = curve.cells(0.05)
    bounds = BodySpeeds(robot).bounds(curve, cells)
    model, data = robot.model, robot.model.createData()
    rng = np.random.default_rng(0)
    for j in rng.integers(0, len(cells), 40):
        s = rng.uniform(cells.edges[j] + 1e-5, cells.edges[j + 1] - 1e-5)
        points = []
        for side in (-1e-6, 1e-6):
            q = robot.pinocchio_configuration(curve.at(np.array([s + side])).q[0])
            pin.framesForwardKinematics(model, data, q)
            at = [data.oMf[robot.tip_frame].translation.copy()[None]]
            for body in robot.collision_model.geometryObjects:
                body.geometry.computeLocalAABB()
                middle = np.array(body.geometry.aabb_local.center()).ravel()
                at.append((data.oMi[body.parentJoint] * body.placement).act(middle)[None])
            points.append(np.concatenate(at))
        speeds = np.linalg.norm(points[1] - points[0], axis=1) / 2e-6
        assert (speeds <= np.roll(bounds[j], 1) * (1 + 1e-5) + 1e-8).all()


def test_speeds_of_tool_and_links_are_kept(panda, shelf_path, shelf_motion, panda_limits):
    for kind in ("tool_speed", "link_speed"):
        trajectory = time_path(shelf_path, panda, panda_limits, motion=shelf_motion, **{kind: 0.25})
        t = np.linspace(0, trajectory.duration, 500)
        tips = np.array([panda.tip_pose(q).translation for q in trajectory.at(t).q])
        speed = np.linalg.norm(np.diff(tips, axis=0), axis=1) / np.diff(t)
        assert speed.max() <= 0.25 * (1 + 1e-9)
        if kind == "tool_speed":
            assert speed.max() > 0.24
        with pytest.raises(InputError, match=kind.replace("_", " ") + " must be a finite number"):
            time_path(shelf_path, panda, panda_limits, **{kind: 0})


def test_what_cannot_be_is_refused(panda, shelf, shelf_path, shelf_motion, panda_limits):
    with pytest.raises(InputError, match="motion: give a motion"):
        time_path(shelf_path, panda, panda_limits, people=People())
    with pytest.raises(InputError, match=r"'operator' .* mm from the robot where it starts"):
        time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=People(clearance=0.9))
    with pytest.raises(UnknownNameError, match="unknown obstacle 'nobody'"):
        time_path(shelf_path, panda, panda_limits, motion=shelf_motion, people=People(who=("nobody",)))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"speed": -1}, "speed: must be"),
        ({"speed": np.nan}, "speed: must be"),
        ({"reaction_time": -0.1}, "reaction_time: must be"),
        ({"speeds": {"right_hand": -2}}, "speeds.right_hand: must be"),
        ({"speeds": {"tail": 2}}, "speeds"),
        ({"regions": {"hand": [1, 0, 1]}}, r"regions.hand\[1\]: must be"),
        ({"who": []}, "who: name one"),
        ({"contact": "yes"}, "contact: must be"),
        ({"robot_mass": 5}, "robot_mass: unknown key"),
    ],
)
def test_people_that_are_none(given, message):
    with pytest.raises(InputError, match=message):
        People.from_mapping(given)


def test_people_as_a_document():
    people = People(who=("operator",), speeds={"left_hand": 2.0}, contact=True, regions={"hand": (1, 2, 3)})
    assert People.from_mapping(people.to_mapping()) == people
    assert People().to_mapping() == {}


def test_a_robot_that_stops_in_corners_is_told(panda, shelf_path, panda_limits, caplog):
    with caplog.at_level(logging.INFO):
        time_path(shelf_path, panda, panda_limits)
    assert "stops in 2 of 2 corners" in caplog.text


def test_in_a_tube_people_are_nearer_by_what_the_joints_may_be_off(panda):
    scene = Scene([Obstacle("person", Person(height=1.75), Pose((1.1, 0.0, -0.75)), weight=1.0)])
    start = np.array([-0.8, 0.3, 0.0, -2.0, 0.0, 2.3, 0.8])
    path = np.array([start, start * [-1, 1, 1, 1, 1, 1, 1]])
    motion = MotionProver(CollisionChecker(panda, scene))
    tube = Separation(tube=(0.01,) * 7)
    swing = tube.swing(motion.checker)
    assert 0.005 < swing < 0.06
    timed = {
        clearance: time_path(path, panda, motion=proof, people=People(speed=1.2, clearance=clearance))
        for clearance, proof in ((0.0, motion.with_separation(tube)), (swing, motion), (1e-6, motion))
    }
    assert timed[0.0].duration == timed[swing].duration > timed[1e-6].duration
    with pytest.raises(InputError, match="velocities"):
        time_path(path, panda, motion=motion.with_separation(tube), tool_speed=0.5)
