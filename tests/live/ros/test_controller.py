"""A robot driven to goals beside people, with messages lost, late, out of order and broken; without ROS."""

from dataclasses import replace
from itertools import count

import numpy as np
import pinocchio as pin
import pytest
from driving import AWAY, BODY, GOAL, START, Drive, ball, panda

from safe_ompl import CollisionChecker, InputError, Motion
from safe_ompl.geometry import STANDING, Pose, Sphere
from safe_ompl.live.replanning import ReplanningOptions
from safe_ompl.live.ros import ControlOptions
from safe_ompl.live.simulation import ContactMonitor, part_solids
from safe_ompl.scene import Scenario, Wait

LATE = "the command was computed 60 ms after its tick, and a latency of 50 ms is allowed"


@pytest.fixture(scope="module")
def cell():
    return panda()


@pytest.fixture
def drive(cell):
    return Drive(cell)


@pytest.fixture
def moving(cell):
    """Return a drive that is under way."""
    drive = Drive(cell)
    drive.go()
    drive.run(0.5)
    assert np.abs(drive.qd).max() > 0.05
    return drive


def test_it_drives_to_a_goal_and_back(drive):
    assert drive.run(0.2)[-1]["reason"] == "no goal yet"
    for goal in (GOAL, START, START):
        first = len(drive.ticks)
        drive.go(goal)
        drive.arrives(goal)
    assert {tick["state"] for tick in drive.ticks[first:]} == {"done"}  # it is there already
    assert {"standing", "moving", "done"} <= {tick["state"] for tick in drive.ticks}


# ----------------------------------------------------------------------------------------------------------- programs


def work(finger=0.04):
    """Return a drive of the Panda that carries a cube, and waits after it has it, beside a person who is tracked."""
    given = Scenario.load("panda_pick_place")
    steps = given.program.steps
    rest = Wait(time=0.5, touching=(("cube", "table"),))
    given = replace(given, program=replace(given.program, steps=(*steps[:4], rest, *steps[4:])))
    return Drive(
        panda(given, control=ControlOptions(tolerance=0.02)), [*given.start_configuration(given.build_robot()), finger]
    )


def test_a_program_goes_on_where_it_stopped():
    drive = work()
    assert drive.run(0.2)[-1]["reason"] == "the program was not started yet"
    with pytest.raises(InputError, match="has a program, which is run"):
        drive.go(drive.q.tolist())
    drive.controller.run(True)
    while drive.time < 40.0 and (drive.ticks[-1].get("step", 0) < 6 or drive.last[0] != "moving"):
        drive.run(0.05)
    waited = [tick for tick in drive.ticks if tick.get("step") == 5]
    assert len(waited) in (10, 11)
    assert {tick["holds"] for tick in waited} == {"cube"}
    assert {tick["state"] for tick in waited} == {"standing"}
    drive.controller.run(False)
    assert drive.run(1.5)[-1]["reason"] == "stopped"
    assert not drive.qd.any()
    drive.controller.run(True)
    drive.q[0] += 0.2
    drive.run(0.5)
    assert drive.last == ("standing", "'panda_joint1' is 0.200 from where the program goes on, and 0.05 is allowed")
    drive.q[0] -= 0.2
    done = 0
    while drive.time < 60.0 and drive.last[0] != "done":
        drive.run(0.05)
        if drive.controller.segments.done > done:  # the first answer for each segment comes too late
            drive.see()
            done, calls = drive.controller.segments.done, count()
            drive.controller._clock = lambda calls=calls: drive.time + 0.06 * next(calls)
            drive.ticks.append(drive.controller.tick())
            drive.controller._clock = lambda: drive.time
    assert sum(tick["reason"] == LATE for tick in drive.ticks) > 3
    assert drive.last == ("done", "at the goal")
    np.testing.assert_allclose(drive.q, [0.0, -0.6, 0.0, -2.2, 0.0, 1.7, 0.785, 0.04], atol=1e-9)
    held = [tick["holds"] for tick in drive.ticks if tick.get("step")]
    assert [name for k, name in enumerate(held) if k == 0 or name != held[k - 1]] == ["", "cube", ""]
    steps = [tick["step"] for tick in drive.ticks if tick.get("step")]
    assert steps == sorted(steps)
    assert {1, 2, 3, 5, 6, 7, 8, 10, 11, 12} <= set(steps)


def test_a_program_begins_with_its_gripper_and_is_not_taken_up_after_the_clock_went_back():
    drive = work(finger=0.01)
    drive.controller.run(True)
    why = "the program cannot be executed: 'panda_finger_joint1' is at 0.01, and the program begins at 0.04"
    assert why in [tick["reason"] for tick in drive.run(0.5)]
    drive.q[-1] = 0.04
    drive.controller.run(True)
    drive.run(1.0)
    assert drive.last[0] == "moving"
    drive.time, drive.told, drive.qd = 5.0, None, np.zeros(8)
    assert drive.controller.tick()["reason"].startswith("the clock went back by")
    drive.run(1.0)
    assert not drive.controller.driving
    assert drive.last[0] == "standing"


# ------------------------------------------------------------------------------------- lost, late, out of order, broken


def stranger(drive):
    with pytest.raises(InputError, match=r"unknown person 'stranger'"):
        drive.controller.receive_people(drive.time, {"operator": BODY + AWAY, "stranger": BODY})


def into_the_shelf(drive):
    checker = CollisionChecker(drive.robot, Scenario.load("panda_shelf").scene.without("operator"))
    rng = np.random.default_rng(0)
    drawn = (rng.uniform(drive.robot.lower, drive.robot.upper) for _ in range(100))
    drive.go(next(q for q in drawn if checker.in_collision(q)).tolist())


STOPS = {  # what goes wrong, why the robot stands then, for how long at least [s], and how it is mended
    "'operator' was not seen for": (lambda d: setattr(d, "people", True), 1.5, lambda d: setattr(d, "people", False)),
    "no joint states for": (lambda d: setattr(d, "joints", True), 1.5, lambda d: setattr(d, "joints", False)),
    "from where it should be": (lambda d: setattr(d, "deaf", True), 1.5, lambda d: setattr(d, "deaf", False)),
    "'stranger' is seen, but not tracked": (stranger, 0.45, lambda d: None),
    "2 nodes publish /command": (
        lambda d: setattr(d.controller, "blocked", "2 nodes publish /command"),
        1.0,
        lambda d: setattr(d.controller, "blocked", ""),
    ),
    "no goal": (lambda d: d.controller.go_to([], []), 2.0, Drive.go),
    "no way to the goal: ": (into_the_shelf, 2.0, Drive.go),
    "a new goal": (lambda d: d.go([0.5, *START[1:]]), 0.05, Drive.go),
}


@pytest.mark.parametrize("why", STOPS)
def test_whatever_is_wrong_stops_the_robot_until_it_is_mended(moving, why):
    broken, seconds, mended = STOPS[why]
    broken(moving)
    assert why in " ".join(tick["reason"] for tick in moving.run(seconds))
    assert seconds < 0.1 or not moving.qd.any()
    mended(moving)
    moving.arrives()


class Late(Drive):
    """A drive of a robot that is where it was told to be two ticks later."""

    def move(self):
        super().move()
        self.done = [*getattr(self, "done", [self.q] * 2), self.q]

    def see(self):
        now, self.q = self.q, self.done[-3] if hasattr(self, "done") else self.q
        super().see()
        self.q = now


@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_in_a_tube_a_robot_is_late_by_no_more_than_the_lag(lag):
    given = Scenario.load("panda_shelf")
    given = replace(given, limits=replace(given.limits, tube=0.005))
    control = ControlOptions(ReplanningOptions(lag=lag))
    drive = Late(panda(given, control=control), control=control)
    drive.go()
    reasons = " ".join(tick["reason"] for tick in drive.run(2.0))
    assert ("from where it should be, and 0.005 is allowed" in reasons) == (lag == 0.0)
    assert np.abs(drive.q - START).max() > (0.3 if lag else 0.02)


@pytest.mark.parametrize(("now", "why"), [(2.0, "the clock went back by 8.450 s"), (3610.0, "no joint states for 35")])
def test_a_clock_that_jumps(moving, now, why):
    if now < moving.time:
        moving.told, moving.qd = None, np.zeros(7)
    moving.time = now
    assert moving.controller.tick()["reason"].startswith(why)
    assert not moving.controller.driving
    moving.move()
    moving.arrives()


def test_what_is_late_out_of_order_or_cannot_be_used_changes_nothing(moving):
    controller, now, names = moving.controller, moving.time, moving.robot.joint_names
    controller.receive_people(now - 5.0, {"operator": BODY + np.array([0.8, 0.0, -0.75])})  # beside the robot, long ago
    controller.receive_joints(now - 1.0, names, START, np.zeros(7))
    for call, message in (
        (lambda: controller.receive_joints(now, names, [np.nan] * 7), "position: must be finite"),
        (lambda: controller.receive_joints(now, names[:6], [0.0] * 6), "name: panda_joint7 missing"),
        (lambda: controller.receive_joints(now, names, [0.0] * 3), "position: must be as many as the 7"),
        (lambda: controller.receive_joints(now + 1, names, [0.0] * 7), "stamp: is 1.000 s in the future"),
        (lambda: controller.receive_people(now + 1, {"operator": BODY}), "stamp: 'operator' was measured 1.000 s in"),
        (lambda: controller.receive_people(now, {"operator": BODY[:5]}), r"must have shape \(17, 3\)"),
        (lambda: controller.receive_people(now, {"operator": BODY * [1, np.nan, 1]}), "must be finite, or NaN where"),
        (lambda: controller.receive_object(now, "cart", Pose()), "unknown object 'cart'"),
        (lambda: controller.go_to(names, [9.0] * 7), "position: is out of the limits of 'panda_joint1'"),
        (lambda: controller.go_to(["a"], [9.0]), "missing, but needed"),
        (lambda: controller.receive_cloud(now - 9, np.zeros((4, 3))), "comes without joint states of its time"),
    ):
        with pytest.raises(InputError, match=message):
            call()
    tick = moving.run(0.05)[0]
    np.testing.assert_allclose(tick["people"]["operator"]["head"], (BODY + AWAY)[0], atol=1e-9)
    assert tick["state"] == "moving"
    moving.arrives()


def test_an_answer_that_comes_too_late_is_not_sent(moving):
    told, calls, begin = moving.controller.command, count(), moving.time
    moving.controller._clock = lambda: begin + 0.06 * next(calls)  # each answer takes 60 ms, and 50 are allowed
    assert moving.controller.tick()["reason"] == LATE
    assert not moving.controller.driving
    assert moving.controller.command is told
    moving.controller._clock = lambda: moving.time
    moving.time += 0.1
    moving.move()
    moving.arrives()


def test_a_person_of_whom_only_a_hand_is_seen(drive):
    drive.people = True
    drive.go()
    hand = np.full((17, 3), np.nan)
    hand[list(STANDING).index("left_hand")] = [2.0, 0.0, 0.5]
    for _ in range(10):
        drive.controller.receive_people(drive.time, {"operator": hand})
        drive.run(0.05)
    assert drive.last == ("standing", "'operator' was not seen yet")
    drive.people = False
    drive.arrives()


def test_a_robot_that_is_moved_while_its_path_is_planned(drive):
    drive.run(0.1)
    drive.go()
    drive.see()
    drive.controller.tick()  # plans
    drive.time += 0.05
    drive.q = drive.q + 0.1
    drive.see()
    assert drive.controller.tick()["state"] == "planning"  # anew
    assert not drive.controller.driving
    drive.time += 0.05
    drive.run(0.1)
    np.testing.assert_allclose(drive.ticks[-1]["stop"]["q"][0], drive.q, atol=0.01)
    drive.arrives()


def test_points_of_robot_and_person_are_left_out_and_new_ones_stop_the_robot(drive):
    drive.run(0.1)
    drive.go()
    own, place = drive.robot.keypoints(drive.q)[-1] + np.zeros((200, 3)), np.array([0.45, 0.25, 0.6])
    person = np.concatenate([ball(point + drive.person)[:30] for point in BODY[:3]])
    wall, thing = ball([-0.6, -0.6, 0.3]), ball(place)
    for seen, seconds in ((own, 0.5), (person, 0.05)):
        drive.controller.receive_cloud(drive.time, np.concatenate([seen, wall]))
        drive.run(seconds)
        assert np.abs(drive.qd).max() > 0.05
        assert drive.controller.driving
    drive.controller.receive_cloud(drive.time, np.concatenate([wall, thing]))
    drive.run(0.05)
    assert drive.ticks[-1]["reason"] == "300 points of the cloud are new"
    drive.arrives()  # round the thing
    solids, monitor = part_solids("", Sphere(0.08), pin.SE3(np.eye(3), place)), ContactMonitor(drive.robot)
    assert min(monitor.nearest(np.array(tick["q"]), solids).distance for tick in drive.ticks[-150:]) > 0


def test_behind_a_shield_the_jerk_of_the_scenario_is_kept():
    given = Scenario.load("panda_shelf")
    given = replace(given, motion=replace(given.motion, jerk=500.0))
    cell = panda(given, shield=True)
    start = given.start_configuration(cell.robot)
    shield = cell.plan(start, start, None)
    np.testing.assert_array_equal(shield.limits.joints.jerk, 500.0)


def test_behind_a_shield_proposals_are_followed_as_far_as_they_are_proven():
    drive = Drive(panda(shield=True))
    with pytest.raises(InputError, match="is not followed: nothing was proposed yet"):
        drive.controller.propose(np.zeros(7))
    drive.run(0.2)
    assert drive.last == ("standing", "nothing was proposed")
    drive.controller.propose(np.array([0.2, 0, 0, 0, 0, 0, 0]))
    drive.run(0.1)
    assert drive.q[0] > START[0]
    drive.run(1.0)
    assert drive.last == ("done", "")
    goal = drive.q + np.array([0.0, 0.1, 0.0, 0.1, 0.0, 0.0, 0.0])
    drive.controller.propose(Motion.hermite([0.0, 1.0], [drive.q, goal]), drive.time + 0.1)
    drive.run(3.0)
    np.testing.assert_allclose(drive.q, goal, atol=1e-6)
    drive.controller.propose(Motion.hermite([0.0, 5.0], [goal, GOAL]))
    drive.run(0.5)
    for lost, why in (("people", "was not seen"), ("joints", "no joint states")):
        setattr(drive, lost, True)
        drive.run(2.0)
        assert why in drive.last[1]
        assert not drive.qd.any()
        setattr(drive, lost, False)
    drive.run(0.5)
    assert drive.last == ("standing", "nothing was proposed")


@pytest.mark.parametrize("shield", [False, True])
def test_a_robot_slightly_outside_its_limits_is_driven_from_the_limit(shield, caplog):
    """By at most 0.05 rad, which the controller's own tolerance allows; farther outside nothing is planned."""
    cell, start = panda(shield=shield), np.array(START)
    start[5] = cell.robot.upper[5] + 0.04
    pilot = cell.plan(start, np.array(GOAL), None)
    pilot.update({}, {}, 0.0)
    assert pilot.command(0.0).at(0.0).q[5] == cell.robot.upper[5]
    assert "joint 'panda_joint6' = 3.7925 is outside its limit 3.7525" in caplog.text
    start[5] += 0.02
    with pytest.raises(InputError, match=r"'panda_joint6' = 3\.8125 is outside its limits"):
        cell.plan(start, np.array(GOAL), None)
