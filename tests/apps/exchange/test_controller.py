"""A robot driven to goals beside people, with messages lost, late, out of order and broken; without ROS."""

from __future__ import annotations

import argparse
import copy
import gc
import os
import re
import subprocess
import sys
from concurrent.futures import Executor, Future
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numba.core.dispatcher import Dispatcher

from safe_ompl.apps import main
from safe_ompl.apps.cli.program import command_line
from safe_ompl.apps.cli.ros import cell_of, rehearse, trackers_of
from safe_ompl.apps.exchange import ControlOptions, LiveController
from safe_ompl.collision import CollisionChecker
from safe_ompl.common import InputError
from safe_ompl.geometry import STANDING, Obstacle, Person, Pose, Sphere
from safe_ompl.motions import Motion
from safe_ompl.people import CalibratedReach, TrackedBody
from safe_ompl.people.replanning import ReplanningOptions
from safe_ompl.people.simulation import ContactMonitor, Solid, limb_solids
from safe_ompl.scene import Scenario, Scene, find_scenario

GOAL = [-1.25, 0.4, 0.0, -2.1, 0.0, 2.5, 0.785]
START = [1.45, 0.1, 0.0, -1.7, 0.0, 3.37, 0.785]
AWAY = np.array([3.0, 0.0, -0.75])  # where a person stands who bars nothing
BODY = 1.75 * np.array(list(STANDING.values()))


class AtOnce(Executor):
    """Does what it is given at once."""

    def submit(self, fn, /, *args, **kwargs):
        done = Future()
        try:
            done.set_result(fn(*args, **kwargs))
        except Exception as error:
            done.set_exception(error)
        return done


OPTIONS = argparse.Namespace(
    people=None, skeleton=None, noise=0.0, time=None, seed=0, simplify=False, shield=False, reach=None
)


def panda(shield=False):
    """Return the Panda between shelf and table, and an operator who is tracked."""
    scenario, options = Scenario.load(find_scenario("panda_shelf")), copy.copy(OPTIONS)
    options.shield = shield
    control = ControlOptions(ReplanningOptions())
    return cell_of(scenario, scenario.build_robot(), trackers_of(scenario, options), options, control)


@pytest.fixture(scope="module")
def cell():
    return panda()


class Drive:
    """A controller, a robot that does what it is told, and a person, in simulated time."""

    def __init__(self, cell, **options):
        self.time = 10.0
        self.controller = LiveController(cell, lambda: self.time, ControlOptions(**options), AtOnce())
        self.robot, self.q, self.qd = cell.robot, np.array(START), np.zeros(7)
        self.person, self.told, self.ticks = AWAY.copy(), None, []
        self.joints = self.people = self.deaf = False

    def see(self):
        """Measure the robot and the person."""
        if not self.joints:
            self.controller.see_joints(self.time, self.robot.joint_names, self.q, self.qd)
        if not self.people:
            self.controller.see_people(self.time, {"operator": BODY + self.person})

    def run(self, seconds):
        """Go on, and return the ticks."""
        first = len(self.ticks)
        for _ in range(round(seconds / 0.05)):
            self.see()
            self.ticks.append(self.controller.tick())
            if self.controller.driving and not self.deaf:
                times, states = self.controller.stop()
                self.told = (times, states, self.told)
            self.controller.think()
            self.time += 0.05
            self.move()
        return self.ticks[first:]

    def move(self):
        """Be where the commands in force have the robot by now."""
        told = self.told
        while told is not None and told[0][0] > self.time:
            told = told[2]
        if told is None:
            return
        times, states, _ = told
        k = int(np.searchsorted(times, self.time, side="right")) - 1
        if k >= len(times) - 1:
            self.q, self.qd = states[-1].q, np.zeros(7)
        else:
            share = (self.time - times[k]) / (times[k + 1] - times[k])
            self.q = (1 - share) * states[k].q + share * states[k + 1].q
            self.qd = (1 - share) * states[k].qd + share * states[k + 1].qd

    def go(self, goal=GOAL):
        self.controller.go_to(self.robot.joint_names, goal)

    @property
    def last(self):
        return self.ticks[-1]["state"], self.ticks[-1]["reason"]


@pytest.fixture
def drive(cell):
    return Drive(cell)


def test_it_drives_to_a_goal_and_back(drive):
    assert drive.run(0.2)[-1]["reason"] == "no goal yet"
    for goal in (GOAL, START, START):
        drive.go(goal)
        ticks = drive.run(6.0)
        assert drive.last == ("done", "at the goal")
        np.testing.assert_allclose(drive.q, goal, atol=1e-9)
    assert {tick["state"] for tick in ticks} == {"done"}  # it is there already
    states = {tick["state"] for tick in drive.ticks}
    assert {"standing", "moving", "done"} <= states


def test_every_command_ends_in_a_stop_and_follows_the_one_before(drive):
    drive.go()
    drive.run(3.0)
    told, seen = drive.told, 0
    while told is not None and told[2] is not None:
        times, states, before = told
        assert np.abs(states[-1].qd).max() < 1e-9
        assert (np.diff(times) > 0).all()
        known = np.array([state.q for state in before[1]])
        expected = [np.interp(times[0], before[0], known[:, k]) for k in range(7)]
        np.testing.assert_allclose(states[0].q, expected, atol=2e-4)  # samples of 10 ms, between them lines
        told, seen = before, seen + 1
    assert seen > 10


def test_a_person_who_comes_is_never_touched_by_a_robot_that_moves(drive):
    monitor = ContactMonitor(drive.robot)
    drive.go()
    near = []
    for k in range(120):
        drive.person = np.array([0.75 + 1.5 * np.cos(0.4 * k * 0.05 * 2) ** 2, 0.0, -0.75])
        drive.run(0.05)
        if np.abs(drive.qd).max() > 1e-9:
            points = np.vstack([BODY + drive.person, np.zeros(3)])
            solids = limb_solids("operator", TrackedBody(), points)
            near.append(monitor.nearest(drive.q, solids).distance)
    assert min(near) > 0
    states = {tick["state"] for tick in drive.ticks}
    assert "moving" in states
    assert states & {"standing", "slowed", "braking"}


# ------------------------------------------------------------------------------------- lost, late, out of order, broken


def stopped(drive, seconds=1.0):
    """Assert that the robot stands after some time, and return the reasons that were said."""
    said = [tick["reason"] for tick in drive.run(seconds)]
    np.testing.assert_array_equal(drive.qd, 0.0)
    return " ".join(said)


def moving(cell, **options):
    """Return a drive that is under way."""
    drive = Drive(cell, **options)
    drive.go()
    drive.run(0.5)
    assert np.abs(drive.qd).max() > 0.05
    return drive


def goes_on(drive):
    """Assert that the robot gets to its goal after all."""
    drive.run(8.0)
    assert drive.last == ("done", "at the goal")


@pytest.mark.parametrize(
    ("fault", "why"),
    [("people", "'operator' was not seen for"), ("joints", "no joint states for"), ("deaf", "from where it should be")],
)
def test_what_is_lost_stops_the_robot_until_it_is_back(cell, fault, why):
    drive = moving(cell)
    setattr(drive, fault, True)
    assert why in stopped(drive, 1.5)
    setattr(drive, fault, False)
    goes_on(drive)


def test_a_clock_that_goes_back(cell):
    drive = moving(cell)
    drive.time, drive.told = 2.0, None
    drive.qd = np.zeros(7)
    drive.run(0.05)
    assert drive.ticks[-1]["reason"] == "the clock went back by 8.450 s"
    assert not drive.controller.driving
    goes_on(drive)


def test_a_clock_that_jumps_ahead(cell):
    drive = moving(cell)
    drive.time += 3600.0
    (tick,) = [drive.controller.tick()]
    assert tick["reason"].startswith("no joint states for 3600")
    drive.move()
    goes_on(drive)


def test_measurements_that_are_late_or_out_of_order_change_nothing(cell):
    drive = moving(cell)
    late = BODY + np.array([0.8, 0.0, -0.75])  # beside the robot, but long ago
    drive.controller.see_people(drive.time - 5.0, {"operator": late})
    drive.controller.see_joints(drive.time - 1.0, drive.robot.joint_names, START, np.zeros(7))
    tick = drive.run(0.05)[0]
    np.testing.assert_allclose(tick["people"]["operator"]["head"], (BODY + AWAY)[0], atol=1e-9)
    goes_on(drive)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c, t: c.see_joints(t, c.cell.robot.joint_names, [np.nan] * 7), "position: must be finite"),
        (lambda c, t: c.see_joints(t, c.cell.robot.joint_names[:6], [0.0] * 6), "name: panda_joint7 missing"),
        (lambda c, t: c.see_joints(t, c.cell.robot.joint_names, [0.0] * 3), "position: must be as many as the 7"),
        (lambda c, t: c.see_joints(t + 1, c.cell.robot.joint_names, [0.0] * 7), "stamp: is 1.000 s in the future"),
        (lambda c, t: c.see_people(t + 1, {"operator": BODY}), "stamp: 'operator' was measured 1.000 s in the future"),
        (lambda c, t: c.see_people(t, {"operator": BODY[:5]}), r"must have shape \(17, 3\)"),
        (lambda c, t: c.see_people(t, {"operator": BODY * [1, np.nan, 1]}), "must be finite, or NaN where"),
        (lambda c, t: c.see_object(t, "cart", Pose()), "unknown object 'cart'"),
        (lambda c, t: c.go_to(c.cell.robot.joint_names, [9.0] * 7), "position: is out of the limits of 'panda_joint1'"),
        (lambda c, t: c.go_to(["a"], [9.0]), "missing, but needed"),
        (lambda c, t: c.see_cloud(t - 9, np.zeros((4, 3))), "comes without joint states of its time"),
    ],
)
def test_what_cannot_be_used_is_refused_and_changes_nothing(cell, call, message):
    drive = moving(cell)
    with pytest.raises(InputError, match=message):
        call(drive.controller, drive.time)
    goes_on(drive)


def test_somebody_whom_nobody_tracks_stops_the_robot(cell):
    drive = moving(cell)
    with pytest.raises(InputError, match=r"unknown person 'stranger'"):
        drive.controller.see_people(drive.time, {"operator": BODY + AWAY, "stranger": BODY})
    assert "'stranger' is seen, but not tracked" in stopped(drive, 0.45)
    goes_on(drive)


def test_another_node_stops_the_robot(cell):
    drive = moving(cell)
    drive.controller.blocked = "2 nodes publish /command"
    assert "2 nodes publish /command" in stopped(drive)
    drive.controller.blocked = ""
    goes_on(drive)


def test_an_answer_that_comes_too_late_is_not_sent(cell):
    drive = moving(cell)
    told, calls = drive.controller.command, count()
    begin = drive.time
    drive.controller._clock = lambda: begin + 0.06 * next(calls)  # each answer takes 60 ms, and 50 are allowed
    assert drive.controller.tick()["reason"] == "the answer came 10 ms too late"
    assert not drive.controller.driving
    assert drive.controller.command is told
    drive.controller._clock = lambda: drive.time
    drive.time += 0.1
    drive.move()
    goes_on(drive)


def test_a_person_of_whom_only_a_hand_is_seen(cell):
    drive = Drive(cell)
    drive.people = True
    drive.go()
    hand = np.full((17, 3), np.nan)
    hand[list(STANDING).index("left_hand")] = [2.0, 0.0, 0.5]
    for _ in range(10):
        drive.controller.see_people(drive.time, {"operator": hand})
        drive.run(0.05)
    assert drive.last == ("standing", "'operator' was not seen yet")
    drive.people = False
    goes_on(drive)


def test_a_robot_that_is_moved_while_its_path_is_planned(cell):
    drive = Drive(cell)
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
    goes_on(drive)


def test_a_new_goal_on_the_way(cell):
    drive = moving(cell)
    drive.go(START)
    assert not drive.controller.driving
    drive.run(6.0)
    assert drive.last == ("done", "at the goal")
    np.testing.assert_allclose(drive.q, START, atol=1e-9)
    drive.go()
    drive.run(0.5)
    drive.controller.go_to([], [])
    assert stopped(drive, 2.0).endswith("no goal")


def test_a_goal_that_cannot_be_reached(drive):
    checker = CollisionChecker(drive.robot, Scenario.load(find_scenario("panda_shelf")).scene.without("operator"))
    rng = np.random.default_rng(0)
    drawn = (rng.uniform(drive.robot.lower, drive.robot.upper) for _ in range(100))
    drive.go(next(q for q in drawn if checker.in_collision(q)).tolist())
    drive.run(0.2)
    assert drive.last[0] == "standing"
    assert drive.last[1].startswith("no way to the goal: ")
    drive.go()
    goes_on(drive)


# ------------------------------------------------------------------------------------------------------- clouds


def ball(centre):
    """Points on a ball of 8 cm."""
    directions = np.random.default_rng(0).normal(size=(300, 3))
    return centre + 0.08 * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_points_of_robot_and_person_are_left_out_and_new_ones_stop_the_robot(cell):
    drive = Drive(cell)
    drive.run(0.1)
    drive.go()
    own = drive.robot.keypoints(drive.q)[-1] + np.zeros((200, 3))
    person = np.concatenate([ball(point + drive.person)[:30] * [1, 1, 1] for point in BODY[:3]])
    wall = ball([-0.6, -0.6, 0.3])
    drive.controller.see_cloud(drive.time, np.concatenate([own, wall]))
    drive.run(0.5)
    assert np.abs(drive.qd).max() > 0.05
    drive.controller.see_cloud(drive.time, np.concatenate([person, wall]))
    drive.run(0.05)
    assert np.abs(drive.qd).max() > 0.05
    assert drive.controller.driving
    thing = ball([0.45, 0.25, 0.6])
    drive.controller.see_cloud(drive.time, np.concatenate([wall, thing]))
    drive.run(0.05)
    assert drive.ticks[-1]["reason"] == "300 points of the cloud are new"
    drive.run(8.0)
    assert drive.last == ("done", "at the goal")  # round the thing
    solid = Solid("", "", Sphere(0.08).parts()[0].geometry, pin.SE3(np.eye(3), np.array([0.45, 0.25, 0.6])))
    way = [tick["q"] for tick in drive.ticks[-150:]]
    assert min(ContactMonitor(drive.robot).nearest(np.array(q), [solid]).distance for q in way) > 0


def test_a_calibrated_reach_comes_with_its_gate(tmp_path, monkeypatch, capsys):
    growth = {"torso": (0.5,), "right_hand": (1.0,)}
    reach = CalibratedReach("recording12", 2.0, 0.9, 20, (0.5,), growth, ("a",), ("b",))
    reach.save(tmp_path / "reach.yaml")
    monkeypatch.setattr("safe_ompl.apps.cli.output.need_extra", lambda extra: None)
    words = ["ros", "panda_shelf", "--reach", str(tmp_path / "reach.yaml"), "--skeleton"]
    options = command_line().parse_args([*words, "recording12"])
    scenario, trackers, control, _ = options.prepare(options).args
    assert trackers["operator"].gate == 2.0
    cell_of(scenario, scenario.build_robot(), trackers, options, control)
    trackers["operator"] = replace(trackers["operator"], gate=None)
    with pytest.raises(InputError, match="operator: the reach was calibrated with"):
        cell_of(scenario, scenario.build_robot(), trackers, options, control)
    assert main([*words[:3], str(tmp_path / "none.yaml")]) == 2
    assert "--reach: '" in " ".join(capsys.readouterr().err.split())


# ------------------------------------------------------------------------------------------- requests and shield


def test_a_whole_trajectory_on_request(drive):
    ask = partial(drive.controller.request, drive.robot.joint_names)
    with pytest.raises(InputError, match="no joint states"):
        ask(GOAL)
    drive.people = True
    drive.run(0.1)
    with pytest.raises(InputError, match="operator: was not seen yet"):
        ask(GOAL)
    drive.people, drive.person = False, np.array([0.9, 0.0, -0.75])
    drive.run(0.1)
    ask(GOAL)
    answer = drive.controller.answer()
    assert drive.controller.answer() is None
    assert re.match(r"proven free of contact, at least \d+ mm away; timed: ", answer.what)
    states = answer.trajectory.at(np.linspace(0.0, answer.trajectory.duration, 500))
    np.testing.assert_allclose(states.q[[0, -1]], [START, GOAL], atol=1e-9)
    assert np.abs(states.qd[[0, -1]]).max() < 1e-9
    person = Obstacle("operator", Person(1.75, dict(zip(STANDING, BODY + drive.person, strict=True))))
    scene = Scene((*Scenario.load(find_scenario("panda_shelf")).scene.without("operator"), person))
    checker = CollisionChecker(drive.robot, scene)
    assert not any(checker.in_collision(q) for q in states.q)
    ask(GOAL)
    drive.controller.see_joints(drive.time, drive.robot.joint_names, drive.q + 0.1, np.zeros(7))
    assert drive.controller.answer() == (None, "the robot has moved meanwhile")
    drive.person = np.array([0.35, 0.2, -0.75])  # about the robot
    drive.run(0.6)
    ask(GOAL)
    answer = drive.controller.answer()
    assert answer.trajectory is None
    assert "operator" in answer.what
    drive.person = AWAY
    drive.go()
    drive.run(0.6)
    with pytest.raises(InputError, match="the robot moves"):
        ask(START)


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
    drive.people = True
    drive.run(2.0)
    assert "was not seen" in drive.last[1]
    assert np.abs(drive.qd).max() == 0
    drive.people = False
    drive.joints = True
    drive.run(1.0)
    assert "no joint states" in drive.last[1]
    drive.joints = False
    drive.run(0.5)
    assert drive.last == ("standing", "nothing was proposed")


def kernels():
    """Return the kernels that this process has, with the types that they take."""
    found = [thing for thing in gc.get_objects() if isinstance(thing, Dispatcher)]
    own = [kernel for kernel in found if kernel.py_func.__module__.startswith("safe_ompl.")]
    return {(kernel.py_func.__qualname__, str(types)) for kernel in own for types in kernel.overloads}


def rehearse_and_drive(shield):
    """Fail if ticks call kernels that the rehearsal does not."""
    drive = Drive(panda(shield))
    rehearse(argparse.Namespace(**{**vars(OPTIONS), "shield": shield}), drive.controller.options)
    before = kernels()
    assert before
    assert shield or {"separating_axes", "chords_ahead"} <= {name for name, _ in before}  # of retreats
    if not shield:
        drive.go()
    for k in range(40):
        drive.person = np.array([3.0 - 2.0 * min(1.0, k / 30), 0.0, -0.75])
        if shield and drive.controller.driving:
            drive.controller.propose(Motion.hermite([0.0, 5.0], [drive.q, GOAL]))
        drive.run(0.05)
        if k == 30:
            drive.controller.see_cloud(drive.time - 0.05, np.full((20, 3), 1.5))
    assert {"moving", "slowed"} & {tick["state"] for tick in drive.ticks}
    new = {name for name, _ in kernels() - before}
    assert new <= {"extreme_vertices"}  # for hulls of meshes, made by the plan: compiled before any setup


@pytest.mark.parametrize("shield", [False, True])
def test_ticks_compile_nothing(shield):
    """Where kernels are on disk they are loaded when they are first called: a new process shows which were."""
    script = f"import test_controller; test_controller.rehearse_and_drive({shield})"
    own = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=own)
    assert done.returncode == 0, done.stderr
