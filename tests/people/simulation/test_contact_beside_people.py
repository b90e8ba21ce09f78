"""Where contact is allowed a robot that moves touches people only at speeds that they bear, and heads never."""

import dataclasses
from itertools import product

import numpy as np

from safe_ompl import Box, Obstacle, People, Pose, Replanner, Scene, Tracker
from safe_ompl.geometry import STANDING
from safe_ompl.people import TrackedBody, find_skeleton
from safe_ompl.people.replanning import Doing
from safe_ompl.people.replanning.replanner import contact_limits
from safe_ompl.people.simulation import ContactMonitor, limb_solids
from safe_ompl.trajectories import contact_speed

ARM = ("right_upper_arm", "right_forearm", "right_hand", "left_forearm", "left_hand")
SPEED = 1.6


def keypoints(place, skeleton):
    """Return the key points of a body that stands at a place and stretches its right arm out towards the base."""
    points = {name: 1.75 * np.array(at) for name, at in STANDING.items()}
    shoulder, ahead = points["right_shoulder"], np.array([-1.0, 0.0, -0.3]) / np.hypot(1.0, 0.3)
    points["right_elbow"], points["right_wrist"] = shoulder + 0.3 * ahead, shoulder + 0.55 * ahead
    points["right_hand"] = shoulder + 0.65 * ahead
    return np.array([points.get(name, points["head"]) for name in skeleton.points]) + place


def run_at(replanner, trajectory, tracker, begin, place, seconds=1.5, step=0.005):
    """Let a person stand, and from an instant on walk into the robot; return all touches and commands."""
    monitor, place, touches, commands = ContactMonitor(replanner.robot), np.array(place, float), [], []
    replanner.start(trajectory)
    old = new = None
    for k in range(int((begin + seconds) / step)):
        time = k * step
        if k % 10 == 0:
            replanner.update({"anna": keypoints(place, tracker.skeleton)}, {}, time)
            old, new = new, replanner.command(time + 0.02)
            commands.append(new)
        command = new if old is None or k % 10 >= 4 else old
        state = command.at(max(time, command.time))
        points = tracker.skeleton.keypoints(keypoints(place, tracker.skeleton))
        ends = tracker.body.ends(tracker.body.completed(points)[0])
        solids = limb_solids("anna", tracker.body.limbs, ends, tracker.body.radii(ends))
        if np.abs(state.qd).max() > 1e-9:
            touches += monitor.touches(state.q, state.qd, solids)
        if time >= begin and monitor.nearest(state.q, solids).distance > -0.02:
            place = place + SPEED * step * np.array([-1.0, 0.0, 0.0])
    return touches, commands


def replanner_beside(panda, table, body, **people):
    tracker = Tracker(find_skeleton("coco17"), body)
    replanner = Replanner(panda, table, {"anna": tracker}, people=People(speed=SPEED, **people))
    return replanner, tracker


def test_touches_are_borne_and_there_are_some(panda, table, to_and_fro):
    found = []
    for begin, shoulder in product((0.25, 0.5, 1.0), (-0.1, 0.3)):
        replanner, tracker = replanner_beside(panda, table, TrackedBody(1.75, ARM), contact=True)
        trajectory = to_and_fro(replanner)[0]
        touches, commands = run_at(replanner, trajectory, tracker, begin, (1.25, shoulder, -0.9))
        for touch in touches:
            assert touch.speed <= contact_speed(replanner.people.region_of(touch.limb)) * (1 + 1e-6)
        found += touches
        assert {command.rule for command in commands} <= {"", "separation", "contact", "clamping"}
    assert len(found) > 10
    assert max(touch.speed for touch in found) > 0.05


def test_what_contact_allows_is_only_asked_near_people_and_once_for_each_cell(panda, table, to_and_fro, monkeypatch):
    replanner, tracker = replanner_beside(panda, table, TrackedBody(1.75, ARM), contact=True)
    cells_asked, speeds = [], replanner.contact.speeds
    monkeypatch.setattr(replanner.contact, "speeds", lambda Q, *rest: cells_asked.append(len(Q)) or speeds(Q, *rest))
    replanner.start(to_and_fro(replanner)[0])
    replanner.update({"anna": keypoints(np.array([4.0, 0.0, -0.9]), tracker.skeleton)}, {}, 0.0)
    command = replanner.command(0.02)
    assert (command.doing, cells_asked) == (Doing.MOVING, [])
    replanner.update({"anna": keypoints(np.array([1.0, 0.0, -0.9]), tracker.skeleton)}, {}, 0.05)
    assert replanner.command(0.07).reason
    path, asked = replanner._path, sum(cells_asked)
    assert asked > 0
    slow = path.slowed(0.5 * np.sqrt(path.squares), path.brakes)
    np.testing.assert_array_equal(slow.squares, 0.25 * path.squares)
    cells = replanner._last.motion.cells
    for ours, theirs in zip(slow._borne(replanner.contact, cells), path._borne(replanner.contact, cells), strict=True):
        np.testing.assert_array_equal(ours[cells], theirs[cells])
    fresh = dataclasses.replace(path)._borne(replanner.contact, cells)
    np.testing.assert_array_equal(fresh[0][cells], slow._borne(replanner.contact, cells)[0][cells])
    assert sum(cells_asked) == asked + len(np.unique(cells))  # of the fresh path alone


def test_heads_stop_it(panda, table, to_and_fro):
    for begin in (0.3, 0.6):
        replanner, tracker = replanner_beside(panda, table, TrackedBody(1.75, ("head", "neck")), contact=True)
        there = to_and_fro(replanner)[0]
        touches, commands = run_at(replanner, there, tracker, begin, (0.95, 0.0, -1.1))
        assert not touches
        assert {command.rule for command in commands} <= {"", "separation"}
        assert Doing.STANDING in {command.doing for command in commands}


def test_in_a_narrow_gap_it_is_slower_than_in_the_open(panda, to_and_fro):
    """A wall beside the path: a hand may be clamped between it and the gripper."""
    wall = Obstacle("wall", Box((0.02, 1.2, 0.5)), Pose((0.63, 0.0, 0.5)))
    took, rules = [], []
    for scene in (Scene(()), Scene((wall,))):
        replanner, tracker = replanner_beside(panda, scene, TrackedBody(1.75, ("right_hand",)), contact=True)
        replanner.start(to_and_fro(replanner)[0])
        seen = keypoints((1.1, 0.0, -0.9), tracker.skeleton)
        rules.append(set())
        for k in range(100):
            replanner.update({"anna": seen}, {}, 0.05 * k)
            command = replanner.command(0.05 * k + 0.02)
            rules[-1].add(command.rule)
            if command.doing is Doing.DONE:
                break
        took.append(k)
    print(took, rules)
    assert took[1] > 1.1 * took[0]
    assert "clamping" in rules[1] - rules[0]


def test_objects_are_not_touched(replanner_for, to_and_fro):
    people = People(contact=True, regions={"head": (500.0, 4.4, 10.0)})
    replanner = replanner_for("anna", "ball", people=people)
    limits = contact_limits(replanner.robot, replanner.surroundings, people)
    assert limits.limbs[-1] == ("ball", "")
    assert limits.bears[-1] == 0 < limits.bears[0]
