"""What is executed is proven at every instant: adversaries never touch a robot that moves, and faults are answered."""

import logging
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
from swinging import JERKS, drive_replanner

from safe_ompl import (
    Box,
    InputError,
    Obstacle,
    People,
    PointCloud,
    Pose,
    RateLimits,
    Replanner,
    Scene,
    Sphere,
    Surroundings,
    UnknownNameError,
    time_path,
)
from safe_ompl.geometry import STANDING
from safe_ompl.live import TrackedBody
from safe_ompl.live.replanning import Action, ReplanningOptions
from safe_ompl.live.replanning.commands import contact_limits
from safe_ompl.live.simulation import ContactMonitor, limb_solids, part_solids
from safe_ompl.motions import contact_speed

WAYS = [[-1.2, 0.0, 0, -2.0, 0, 2.2, 0.785], [1.2, 0.0, 0, -2.0, 0, 2.2, 0.785]]

FAR = {}, {"ball": Pose((3.0, 0.0, 0.0))}
ARM = ("right_upper_arm", "right_forearm", "right_hand", "left_forearm", "left_hand")


def person_at(place, tracker, *, stretched=False):
    """Return the key points of COCO of a person who stands at a place, the right arm stretched out to the base."""
    points = {name: 1.75 * np.array(at) for name, at in STANDING.items()}
    if stretched:
        ahead = np.array([-1.0, 0.0, -0.3]) / np.hypot(1.0, 0.3)
        points["right_elbow"] = points["right_shoulder"] + 0.3 * ahead
        points["right_wrist"] = points["right_shoulder"] + 0.55 * ahead
    return np.array([points.get(name, points["head"]) for name in tracker.skeleton.points]) + place


class Attack(NamedTuple):
    """A ball or a person who stands, and from an instant [s] on runs at the robot."""

    begin: float
    place: tuple
    speed: float = 1.6
    limbs: tuple = ()  # of a person; none: a ball
    contact: bool = False
    promised: float = 1.6
    limit: float | None = None  # of tool and links
    jerk: list | None = None

    def run(self, replanner, trajectory, tracker):
        """Return the least distance while the robot moves, all touches, and the commands."""
        monitor, robot, place = ContactMonitor(replanner.robot), replanner.robot, np.array(self.place, float)
        replanner.start(trajectory)
        old = new = None
        least, touches, commands = np.inf, [], []
        for k in range(int((self.begin + 1.2) / 0.005)):
            time = 0.005 * k
            points = person_at(place, tracker, stretched=self.contact) if self.limbs else None
            if k % 10 == 0:
                seen = ({"anna": points}, {}) if self.limbs else ({}, {"ball": Pose(tuple(place))})
                replanner.update(*seen, time)
                old, new = new, replanner.command(time + 0.02)
                commands.append(new)
                replanner.think()
            command = new if old is None or k % 10 >= 4 else old
            state = command.at(max(time, command.time))
            moving = bool(np.abs(state.qd).max() > 1e-9) and command.action is not Action.RETREATING
            if time < self.begin and not moving:
                continue
            solids = part_solids("ball", Sphere(0.1), pin.SE3(np.eye(3), place))
            if self.limbs:
                body = tracker.body
                solids = limb_solids("anna", body, body.completed(tracker.skeleton.keypoints(points))[0])
            distance = monitor.nearest(state.q, solids).distance
            if moving:
                least = min(least, distance)
                touches += monitor.touches(state.q, state.qd, solids) if distance <= 0 else []
            if time >= self.begin and distance > -0.02:
                middle = place + np.array([0.0, 0.0, 1.3 if self.limbs else 0.0])
                ways = robot.keypoints(state.q)[1:] - middle
                way = ways[np.linalg.norm(ways, axis=1).argmin()] * ([1.0, 1.0, 0.0] if self.limbs else 1.0)
                place = place + self.speed * 0.005 * way / max(np.linalg.norm(way), 1e-9)
        assert len({command.action for command in commands}) > 1
        return least, touches, commands


ATTACKS = (
    Attack(0.2, (0.8, 0.7, 0.45)),
    Attack(0.6, (0.6, -0.8, 0.4)),
    Attack(0.9, (0.75, 0.75, 0.3)),
    Attack(0.7, (0.55, 0.0, 0.45), speed=0.1, promised=0.1, limit=1.0),
    Attack(0.3, (1.0, -0.3, -0.9), limbs=("head", "torso", "right_forearm")),
    Attack(0.8, (-0.9, 0.2, -0.9), limbs=("head", "torso", "right_forearm")),
    Attack(0.3, (1.25, -0.1, -0.9), limbs=ARM, contact=True),
    Attack(0.9, (1.25, 0.3, -0.9), limbs=ARM, contact=True),
    Attack(0.3, (1.25, -0.1, -0.9), limbs=ARM, contact=True, jerk=JERKS[2]),
    Attack(0.4, (0.95, 0.0, -1.1), limbs=("head", "neck"), contact=True),
)


@pytest.mark.parametrize("attack", ATTACKS)
def test_no_adversary_touches_a_robot_that_moves_but_where_that_is_borne(panda, table, tracker, to_and_fro, attack):
    people = People(speed=1.6, contact=attack.contact)
    tracker = type(tracker)(tracker.skeleton, TrackedBody(1.75, attack.limbs))
    who = ({"anna": tracker}, {}) if attack.limbs else ({}, {"ball": attack.promised})
    replanner = Replanner(panda, Surroundings(table, *who, people))
    speeds = {} if attack.limit is None else {"tool_speed": attack.limit, "link_speed": 1.5 * attack.limit}
    least, touches, commands = attack.run(replanner, to_and_fro(replanner, attack.jerk, **speeds)[0], tracker)
    rules = {command.rule for command in commands}
    if attack.limbs != ARM:
        assert least > 0
        assert rules <= {"", "separation"}
        return
    assert len(touches) > 3
    assert rules <= {"", "separation", "contact", "clamping"}
    for touch in touches:
        borne = contact_speed(people.region_of(touch.limb))
        assert touch.speed <= borne * (1 + 1e-6)


def test_a_ball_that_is_faster_than_promised_can_win(replanner_for, to_and_fro, tracker):
    fast = [Attack(begin, (0.8, 0.2, 0.5), speed=4.0) for begin in (0.3, 0.5, 0.7)]
    replanners = [replanner_for("ball", ball=0.2) for _ in fast]
    assert min(a.run(r, to_and_fro(r)[0], tracker)[0] for a, r in zip(fast, replanners, strict=True)) <= 0


def test_alone_it_is_as_fast_as_its_limits_let_it_and_no_detour_is_searched(replanner_for, to_and_fro):
    replanner = replanner_for("ball")
    way = to_and_fro(replanner)[0]
    commands = drive_replanner(replanner, way, lambda t: FAR, 6.0)
    assert commands[-1].time < 1.35 * way.duration + 0.1
    assert {command.action for command in commands} == {Action.MOVING, Action.DONE}
    assert len({id(command.path) for command in commands}) == 1


def test_after_a_stop_it_goes_on_by_itself_and_says_why(replanner_for, to_and_fro, caplog):
    def see(time):
        return {}, {"ball": Pose((0.6, 0.1, 0.5) if 0.3 <= time < 1.8 else (3.0, 0.0, 0.0))}

    replanner = replanner_for("ball")
    with caplog.at_level(logging.INFO, "safe_ompl"):
        commands = drive_replanner(replanner, to_and_fro(replanner)[0], see, 6.0, think=False)
    actions = [command.action for command in commands]
    assert actions[-1] is Action.DONE
    assert "'ball'" in commands[actions.index(Action.STANDING)].reason
    assert "farther than promised" in caplog.text
    assert "standing: " in caplog.text


def far_away(time, lost, away):
    return ({}, {}) if lost <= time else ({}, {"ball": Pose((30.0 + (away if time >= 0.3 else 0.0), 0.0, 0.0))})


@pytest.mark.parametrize(
    ("lost", "away", "begin", "why"), [(0.1, 0.0, 0.57, "was not seen for"), (9.0, 5.0, 0.32, "farther than promised")]
)
def test_who_is_lost_or_too_fast_stops_it_from_however_far_away(replanner_for, to_and_fro, lost, away, begin, why):
    replanner = replanner_for("ball")
    commands = drive_replanner(replanner, to_and_fro(replanner)[0], lambda t: far_away(t, lost, away), 0.7, think=False)
    (first, *_) = [command for command in commands if command.action is Action.BRAKING]
    assert first.time == pytest.approx(begin)
    assert why in first.reason


def test_clearance_is_left(replanner_for, to_and_fro):
    still = {}, {"ball": Pose((0.85, 0.0, 0.5))}
    for clearance, end in ((0.0, Action.DONE), (0.3, Action.STANDING)):
        replanner = replanner_for("ball", ball=0.0, people=People(clearance=clearance))
        assert drive_replanner(replanner, to_and_fro(replanner)[0], lambda t: still, 3.0, think=False)[-1].action is end


# ------------------------------------------------------------------------------------------------------- contact


def test_in_a_narrow_gap_it_is_slower_than_in_the_open(panda, tracker, to_and_fro):
    """A wall beside the path: a hand may be clamped between it and the gripper."""
    wall = Obstacle("wall", Box((0.02, 1.2, 0.5)), Pose((0.63, 0.0, 0.5)))
    hand, took, rules = type(tracker)(tracker.skeleton, TrackedBody(1.75, ("right_hand",))), [], []
    for scene in (Scene(()), Scene((wall,))):
        replanner = Replanner(panda, Surroundings(scene, {"anna": hand}, people=People(speed=1.6, contact=True)))
        seen = {"anna": person_at((1.1, 0.0, -0.9), hand, stretched=True)}, {}
        commands = drive_replanner(replanner, to_and_fro(replanner)[0], lambda t, seen=seen: seen, 5.0, think=False)
        took.append(len(commands))
        rules.append({command.rule for command in commands})
    assert took[1] > 1.1 * took[0]
    assert "clamping" in rules[1] - rules[0]


def test_objects_are_not_touched(replanner_for):
    people = People(contact=True, regions={"head": (500.0, 4.4, 10.0)})
    replanner = replanner_for("anna", "ball", people=people)
    limits = contact_limits(replanner.robot, replanner.surroundings)
    assert limits.limbs[-1] == ("ball", "")
    assert limits.bears[-1] == 0 < limits.bears[0]


@pytest.mark.parametrize("contact", [False, True])
def test_a_cloud_that_moves_is_where_its_points_are_and_its_new_ones_are_no_faster(panda, table, tracker, contact):
    rng = np.random.default_rng(0)
    blob = rng.uniform(-0.1, 0.1, (3000, 3))
    scene = table.with_obstacles(Obstacle("blob", PointCloud(0.01, points=blob), Pose((1.0, 0, 0.4))))
    people = People(speed=1.6, contact=contact)
    pilot = Replanner(panda, Surroundings(scene, {"anna": tracker}, {"blob": 1.0}, people))
    pilot.start(time_path(WAYS, panda, RateLimits.of(panda, acceleration=10.0), motion=pilot.prover))
    anna, commands = person_at((3.0, 0, -0.9), tracker), []
    for k in range(40):
        t = 0.05 * k
        seen = rng.choice(blob, 500 + 10 * k, replace=False) + np.array([1.0 - 0.2 * t, 0, 0.4])
        assert not pilot.update({"anna": anna}, {"blob": seen}, t)
        sets = pilot.surroundings.sets
        mine = [s for s, (who, _) in enumerate(sets.names) if who == "blob"]
        assert len(mine) <= 256
        assert mine[0] == len(sets.names) - len(mine)
        away = np.linalg.norm(seen[:, None] - sets.points[sets.first[mine]], axis=2).min(axis=1)
        assert away.max() + 0.01 <= sets.radii[mine[0]] + 1e-12
        commands.append(pilot.command(t + 0.02))
        pilot.think()
    assert {"moving", "standing"} <= {command.action for command in commands}
    assert "'blob' may come " in commands[-1].reason
    (jump,) = pilot.update({"anna": anna}, {"blob": blob + np.array([1.6, 0, 0.4])}, 2.01)
    assert 0.7 < jump.excess < 1.0
    with pytest.raises(InputError, match=r"objects\.blob: points: must have shape"):
        pilot.update({}, {"blob": blob[:, :2]}, 2.1)


# ------------------------------------------------------------------------------------------------------- refusals


def test_what_cannot_be_is_refused(replanner_for, to_and_fro, panda, table, tracker, ur5):
    replanner = replanner_for("anna", "ball")
    with pytest.raises(InputError, match="start a trajectory first"):
        replanner.command(0.0)
    with pytest.raises(InputError, match="there was no command yet"):
        replanner.log_tick()
    there = to_and_fro(replanner)[0]
    replanner.start(there)
    here = person_at((1.0, 0, -0.9), tracker)
    broken = np.where(np.arange(17)[:, None] == 9, [0.0, np.nan, 0.0], here)
    for people, objects, time, message in (
        ({"bert": here}, {}, 0.0, "unknown person 'bert'; known: anna"),
        ({}, {"table": Pose()}, 0.0, "unknown object 'table'; known: ball"),
        ({"anna": here[:5]}, {}, 0.0, r"people.anna: key points of coco17: must have shape \(17, 3\)"),
        ({"anna": broken}, {}, 0.0, r"people\.anna: key point 'left_wrist'"),
        ({}, {"ball": np.full((4, 4), np.nan)}, 0.0, r"objects\.ball: pose"),
        ({}, {}, np.nan, "time"),
    ):
        with pytest.raises(InputError, match=message):
            replanner.update(people, objects, time)
    replanner.update({"anna": here + np.array([2.0, 0, 0])}, FAR[1], 1.0)
    with pytest.raises(InputError, match=r"time must not go backwards: 0\.5 s after 1 s"):
        replanner.update({}, {}, 0.5)
    with pytest.raises(InputError, match="time must not go backwards"):
        replanner.command(0.9)
    replanner.command(1.0)
    with pytest.raises(InputError, match="the robot still moves"):
        replanner.start(there)
    arm = time_path([[0, -1.5, 1, 0, 0, 0], [1, -1.5, 1, 0, 0, 0]], ur5, RateLimits.of(ur5))
    down = time_path([[0.0, 0.5, 0, -2.0, 0, 2.2, 0.785], [0.0, 1.6, 0, -1.0, 0, 2.2, 0.785]], panda)
    slow = to_and_fro(replanner, tool_speed=0.5)[0]
    for limit in slow.velocity_limits:
        object.__setattr__(limit, "point_speed", None)
    for trajectory, message in (
        (arm, "the trajectory has the joints"),
        (down, "is not proven free of still obstacles"),
        (slow, "trajectory: the limit 'tool speed' is proven on the trajectory's own curve only"),
    ):
        with pytest.raises(InputError, match=message):
            replanner_for("ball").start(trajectory)
    with pytest.raises(UnknownNameError, match="unknown obstacle 'cube'"):
        Surroundings(table, {}, {"cube": 1.0})
    with pytest.raises(InputError, match="'ball' is both a person and an object"):
        Surroundings(table, {"ball": tracker}, {"ball": 1.0})
    for wrong in ({"tick": 0.0}, {"lost_after": -1.0}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            ReplanningOptions(**wrong)
