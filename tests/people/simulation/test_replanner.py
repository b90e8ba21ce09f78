"""What is executed is proven at every instant: adversaries never touch a robot that moves, and faults are answered."""

import logging
from itertools import pairwise

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import InputError, People, Pose, RateLimits, Replanner, UnknownNameError, time_path
from safe_ompl.geometry import STANDING
from safe_ompl.people.replanning import Doing, ReplanningOptions
from safe_ompl.people.simulation import limb_solids

FAR = (3.0, 0.0, 0.0)


def person_at(place, tracker):
    """Return the key points of COCO of a person who stands at a place."""
    head = STANDING["head"]
    return np.array([1.75 * STANDING.get(name, head) for name in tracker.skeleton.points]) + place


class World:
    """The robot's bodies and a body that runs at them, for the adversary."""

    def __init__(self, robot):
        self.robot, self.model, self.bodies = robot, robot.model, robot.collision_model
        self.kinematics, self.data = self.model.createData(), pin.GeometryData(self.bodies)

    def nearest(self, q, solids):
        """Return the smallest distance and the direction from the solids to the robot."""
        pin.updateGeometryPlacements(self.model, self.kinematics, self.bodies, self.data, q)
        best, way = np.inf, np.zeros(3)
        for k, part in enumerate(self.bodies.geometryObjects):
            if part.parentJoint == 0:
                continue
            at = self.data.oMg[k]
            where = coal.Transform3s(at.rotation, at.translation)
            for geometry, place in solids:
                there = coal.Transform3s(place.rotation, place.translation)
                result = coal.DistanceResult()
                distance = coal.distance(part.geometry, where, geometry, there, coal.DistanceRequest(), result)
                if distance < best:
                    best, way = distance, result.getNearestPoint1() - result.getNearestPoint2()
        return best, way / max(np.linalg.norm(way), 1e-12)


def attack(replanner, trajectory, begin, place, measure, solids, speed, latency=0.02, step=0.005, think=False):
    """Let a body stand, and from an instant on run at the nearest link; return the least distance in motion."""
    world, place = World(replanner.robot), np.array(place, dtype=float)
    replanner.start(trajectory)
    old = new = None
    least, moved = np.inf, 0
    for k in range(int((begin + 1.2) / step)):
        time = k * step
        if k % 10 == 0:
            replanner.update(*measure(place), time)
            old, new = new, replanner.command(time + latency)
            if think:
                replanner.think()
        command = new if old is None or time >= 10 * step * (k // 10) + latency - 1e-9 else old
        state = command.at(max(time, command.time))
        if np.abs(state.qd).max() > 1e-9 or time < begin:
            distance, way = world.nearest(state.q, solids(place))
            if np.abs(state.qd).max() > 1e-9:
                least, moved = min(least, distance), moved + 1
            if time >= begin:
                place = place + min(speed * step, max(distance, 0.0)) * way
        elif time >= begin:
            break
    assert moved > 3
    return least


def ball_attack(replanner, trajectory, begin, place, speed, **options):
    return attack(
        replanner,
        trajectory,
        begin,
        place,
        lambda at: ({}, {"ball": Pose(tuple(at))}),
        lambda at: [(coal.Sphere(0.1), pin.SE3(np.eye(3), at))],
        speed,
        **options,
    )


@pytest.mark.parametrize("seed", range(6))
def test_a_ball_never_touches_a_robot_that_moves(replanner_for, to_and_fro, seed):
    rng = np.random.default_rng(seed)
    replanner = replanner_for("ball")
    place = [0.9, 0.9, 0.5] * rng.uniform(0.6, 1.0, 3) * [1, rng.choice([-1, 1]), 1]
    least = ball_attack(replanner, to_and_fro(replanner)[0], rng.uniform(0.1, 1.0), place, 1.6)
    assert least > 0


@pytest.mark.parametrize("begin", [0.35, 0.7, 1.2])
def test_a_ball_never_touches_a_robot_on_other_ways_under_caps(replanner_for, to_and_fro, panda, begin):
    replanner = replanner_for("ball", ball=0.1)
    way = to_and_fro(replanner)[0]
    points = way.curve.at(np.array([0.0, 0.5, 1.0]) * way.curve.length).q
    slow = time_path(points, panda, way.limits, motion=replanner.prover, tool_speed=1.0, link_speed=1.5)
    assert ball_attack(replanner, slow, begin, (0.55, 0.0, 0.45), 0.1, think=True) > 0


def test_a_ball_that_is_faster_than_promised_can_win(replanner_for, to_and_fro):
    replanner = replanner_for("ball", ball=0.2)
    ways = to_and_fro(replanner)[0]
    least = [ball_attack(replanner_for("ball", ball=0.2), ways, t, (0.8, 0.2, 0.5), 4.0) for t in (0.3, 0.5, 0.7)]
    assert min(least) <= 0


def test_a_person_never_touches_a_robot_that_moves(replanner_for, to_and_fro, tracker):
    for begin, place in ((0.3, (1.0, -0.3, -0.9)), (0.6, (1.0, 0.4, -0.9)), (0.8, (-0.9, 0.2, -0.9))):
        replanner = replanner_for("anna")

        def solids(at):
            body = tracker.body
            ends = body.ends(body.completed(tracker.skeleton.keypoints(person_at(at, tracker)))[0])
            limbs = limb_solids("anna", body.limbs, ends, body.radii(ends))
            return [(solid.geometry, solid.placement) for solid in limbs]

        def measure(at):
            return {"anna": person_at(at, tracker)}, {}

        assert attack(replanner, to_and_fro(replanner)[0], begin, place, measure, solids, 1.6) > 0


def drive(replanner, trajectory, see, seconds, latency=0.02):
    """Drive with what is seen at each tick; return the commands."""
    replanner.start(trajectory)
    commands = []
    for k in range(round(seconds / replanner.tick)):
        time = k * replanner.tick
        seen = see(time)
        if seen is not None:
            replanner.update(*seen, time)
        commands.append(replanner.command(time + latency))
    return commands


def test_alone_it_is_as_fast_as_its_limits_let_it(replanner_for, to_and_fro):
    replanner = replanner_for("ball")
    way = to_and_fro(replanner)[0]
    commands = drive(replanner, way, lambda t: ({}, {"ball": Pose(FAR)}), 4.0)
    done = [command.doing for command in commands].index(Doing.DONE) * replanner.tick
    assert done < 1.35 * way.duration + 0.1
    assert {command.doing for command in commands} == {Doing.MOVING, Doing.DONE}
    limits = way.limits
    for before, after in pairwise(commands):
        np.testing.assert_allclose(before.at(after.time).q, after.at(after.time).q, atol=1e-9)
        np.testing.assert_allclose(before.at(after.time).qd, after.at(after.time).qd, atol=1e-6)
        for t in np.linspace(after.time, after.standstill, 20):
            state = after.at(t)
            assert (np.abs(state.qd) <= limits.velocity * (1 + 1e-9)).all()
            assert (np.abs(state.qdd) <= limits.acceleration * (1 + 1e-9)).all()


def test_after_a_stop_it_goes_on_by_itself_and_says_why(replanner_for, to_and_fro, caplog):
    replanner = replanner_for("ball")

    def see(time):
        return {}, {"ball": Pose((0.6, 0.1, 0.5) if 0.3 <= time < 1.8 else FAR)}

    with caplog.at_level(logging.INFO, "safe_ompl"):
        commands = drive(replanner, to_and_fro(replanner)[0], see, 6.0)
    doing = [command.doing for command in commands]
    assert Doing.STANDING in doing
    assert doing[-1] is Doing.DONE
    stood = commands[doing.index(Doing.STANDING)]
    assert "'ball'" in stood.reason
    assert "farther than promised" in caplog.text
    assert "standing: " in caplog.text


def test_the_same_updates_give_the_same_motion(replanner_for, to_and_fro, tracker):
    def see(time):
        return {"anna": person_at((0.9 + 0.3 * np.sin(2 * time), 0.3, -0.9), tracker)}, {}

    runs = []
    for _ in range(2):
        replanner = replanner_for("anna")
        commands = drive(replanner, to_and_fro(replanner)[0], see, 3.0)
        runs.append([np.concatenate(command.at(command.time + 0.03)) for command in commands])
    assert np.array_equal(*map(np.array, runs))


def test_who_was_never_seen_or_is_lost_stops_it(replanner_for, to_and_fro):
    replanner = replanner_for("ball")
    commands = drive(replanner, to_and_fro(replanner)[0], lambda t: ({}, {}), 0.5)
    assert {command.doing for command in commands} == {Doing.STANDING}
    assert commands[0].reason == "'ball' was not seen yet"
    replanner = replanner_for("ball")
    far = {}, {"ball": Pose(FAR)}
    commands = drive(replanner, to_and_fro(replanner)[0], lambda t: far if t < 0.3 else ({}, {}), 2.0)
    assert commands[-1].doing is Doing.STANDING
    assert "was not seen for" in commands[-1].reason


def test_a_late_answer_is_a_stop(replanner_for, to_and_fro):
    replanner = replanner_for("ball")
    replanner.start(to_and_fro(replanner)[0])
    for k in range(10):
        replanner.update({}, {"ball": Pose(FAR)}, 0.05 * k)
        command = replanner.command(0.05 * k)
    assert np.abs(command.at(0.5).qd).max() > 0.1
    assert command.standstill < 1.0
    np.testing.assert_array_equal(command.at(command.standstill + 1).qd, 0)
    replanner.update({}, {"ball": Pose(FAR)}, 0.8)
    after = replanner.command(0.8)
    np.testing.assert_allclose(after.at(0.8).q, command.at(0.8).q)
    assert after.doing is Doing.MOVING


def test_clearance_is_left(replanner_for, to_and_fro):
    distances = []
    for clearance in (0.0, 0.3):
        replanner = replanner_for("ball", ball=0.0, people=People(clearance=clearance))
        commands = drive(replanner, to_and_fro(replanner)[0], lambda t: ({}, {"ball": Pose((0.85, 0.0, 0.5))}), 3.0)
        distances.append(commands[-1].doing)
    assert distances == [Doing.DONE, Doing.STANDING]


def test_what_cannot_be_is_refused(replanner_for, to_and_fro, panda, table, tracker, ur5):
    replanner = replanner_for("anna", "ball")
    with pytest.raises(InputError, match="start a trajectory first"):
        replanner.command(0.0)
    there = to_and_fro(replanner)[0]
    replanner.start(there)
    here = person_at((1.0, 0, -0.9), tracker)
    with pytest.raises(UnknownNameError, match="unknown person 'bert'; known: anna"):
        replanner.update({"bert": here}, {}, 0.0)
    with pytest.raises(UnknownNameError, match="unknown object 'table'; known: ball"):
        replanner.update({}, {"table": Pose()}, 0.0)
    with pytest.raises(InputError, match=r"people.anna: key points of coco17 must have shape \(17, 3\)"):
        replanner.update({"anna": here[:5]}, {}, 0.0)
    broken = here.copy()
    broken[9, 1] = np.nan
    with pytest.raises(InputError, match=r"people\.anna: key point 'left_wrist'"):
        replanner.update({"anna": broken}, {}, 0.0)
    with pytest.raises(InputError, match=r"objects\.ball: pose"):
        replanner.update({}, {"ball": np.full((4, 4), np.nan)}, 0.0)
    with pytest.raises(InputError, match="time"):
        replanner.update({}, {}, np.nan)
    replanner.update({"anna": here + np.array([2.0, 0, 0])}, {"ball": Pose(FAR)}, 1.0)
    with pytest.raises(InputError, match=r"time must not go backwards: 0\.5 s after 1 s"):
        replanner.update({}, {}, 0.5)
    with pytest.raises(InputError, match="time must not go backwards"):
        replanner.command(0.9)
    replanner.command(1.0)
    with pytest.raises(InputError, match="the robot still moves"):
        replanner.start(there)
    arm = time_path([[0, -1.5, 1, 0, 0, 0], [1, -1.5, 1, 0, 0, 0]], ur5, RateLimits.of(ur5))
    with pytest.raises(InputError, match="the trajectory is of the joints"):
        replanner.start(arm)
    down = time_path([[0.0, 0.5, 0, -2.0, 0, 2.2, 0.785], [0.0, 1.6, 0, -1.0, 0, 2.2, 0.785]], panda)
    with pytest.raises(InputError, match="is not free of what stands still"):
        replanner_for("ball").start(down)
    with pytest.raises(UnknownNameError, match="unknown obstacle 'cube'"):
        Replanner(panda, table, {}, {"cube": 1.0})
    with pytest.raises(InputError, match="'ball' is a person and an object"):
        Replanner(panda, table, {"ball": tracker}, {"ball": 1.0})
    for wrong in ({"tick": 0.0}, {"lost_after": -1.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            ReplanningOptions(**wrong)
