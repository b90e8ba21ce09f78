"""Trajectories of others behind a guard: driven on their own path, stopped, resumed, and ended as the action says."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from driving import AWAY, BODY, GOAL, START, Drive, ball, panda

from safe_ompl import Motion, RateLimits, time_path
from safe_ompl.live.ros import Code, Execution, GoalError
from safe_ompl.live.simulation import ContactMonitor, limb_solids

WAY = [START, [0.7, -0.6, 0, -2.2, 0, 3.0, 0.785], [-0.7, -0.6, 0, -2.4, 0, 2.6, 0.785], GOAL]
NEAR = np.array([0.6, 0.0, -0.75])  # where a person bars the way
TOLERANCE = 0.05


def seconds(time):
    return SimpleNamespace(sec=int(np.floor(time)), nanosec=round(1e9 * (time - np.floor(time))))


def tolerances(**given):
    return [SimpleNamespace(**{"name": name, "position": 0.0, "velocity": 0.0, "acceleration": 0.0, **limits})
            for name, limits in given.items()]  # fmt: skip


def goal(robot, times, rows, **changes):
    """Return a goal of the action; rows are positions, velocities and accelerations."""
    keys = ("positions", "velocities", "accelerations")
    values = [dict(zip(keys, each, strict=False)) for each in zip(*rows, strict=True)]
    points = [
        SimpleNamespace(time_from_start=seconds(time), **{key: list(value.get(key, ())) for key in keys})
        for time, value in zip(times, values, strict=True)
    ]
    header = SimpleNamespace(stamp=seconds(changes.pop("stamp", 0.0)))
    names = changes.pop("names", list(robot.joint_names))
    return SimpleNamespace(
        trajectory=SimpleNamespace(header=header, joint_names=names, points=points),
        multi_dof_trajectory=SimpleNamespace(joint_names=changes.pop("bases", [])),
        component_path_tolerance=[],
        component_goal_tolerance=[],
        path_tolerance=changes.pop("path", []),
        goal_tolerance=changes.pop("end", []),
        goal_time_tolerance=seconds(changes.pop("late", 0.0)),
    )


@pytest.fixture(scope="module")
def cell():
    return panda()


@pytest.fixture(scope="module")
def there(cell):
    """Return times of the way to the goal, and positions, velocities and accelerations, as planners send them."""
    limits = RateLimits.of(cell.robot, acceleration=4.0)
    timed = time_path(WAY, cell.robot, limits)
    times = np.linspace(0.0, timed.duration, 60)
    return times, [np.array(rows) for rows in timed.at(times)[:3]]


@pytest.fixture
def drive(cell):
    return Drive(cell, guarded=True)


def send(drive, times, rows, **changes):
    """Give a trajectory to the guard; return it, and the list that its outcome comes to."""
    execution, outcomes = Execution.of(goal(drive.robot, times, rows, **changes), drive.robot, TOLERANCE), []
    execution.report = outcomes.append
    drive.pilot.take(execution)
    return execution, outcomes


def arrives(drive, outcomes):
    """Go on until a trajectory has an outcome, and assert that the robot was driven to its end."""
    end = drive.time + 60.0
    while not outcomes and drive.time < end:
        drive.run(0.05)
    assert outcomes == [(Code.SUCCESSFUL, "", False)]


def off_path(drive, motion):
    """Return how far the robot was from the motion, at most, wherever it was on it."""
    fine = motion.at(np.linspace(*motion.times[[0, -1]], 20000))
    return max(np.abs(fine - tick["q"]).max(axis=1).min() for tick in drive.ticks)


def test_it_drives_a_trajectory_on_its_own_path_in_its_own_time(drive, there):
    drive.run(0.2)
    execution, outcomes = send(drive, *there)
    arrives(drive, outcomes)
    np.testing.assert_allclose(drive.q, GOAL, atol=1e-6)
    assert drive.time - execution.began < there[0][-1] + 0.5
    assert off_path(drive, Motion.hermite(there[0], *there[1])) < 2e-3
    drive.run(0.3)
    assert not drive.controller.driving  # silent without a goal


def test_it_stops_on_the_path_for_a_person_and_goes_on_when_the_way_is_free(drive, there):
    execution, outcomes = send(drive, *there)
    drive.run(0.8)
    assert np.abs(drive.qd).max() > 0.05
    person, monitor = drive.person.copy(), ContactMonitor(drive.robot)
    limbs = drive.controller.cell.trackers["operator"]
    for k in range(100):  # walks at 1.6 m/s, stays, and walks away
        share = np.clip(min(k, 80 - k) / 31, 0.0, 1.0)
        drive.person = person + share * (NEAR - AWAY)
        drive.run(0.05)
        if np.abs(drive.qd).max() > 1e-9:
            points, _ = limbs.body.completed(limbs.skeleton.keypoints(BODY + drive.person))
            assert monitor.nearest(drive.q, limb_solids("operator", limbs.body, points)).distance > 0
        if k == 50:
            assert not drive.qd.any()
            assert 0 < execution.done < execution.duration
            assert "of 'operator' may come " in drive.last[1]
    arrives(drive, outcomes)
    assert off_path(drive, execution.motion) < 2e-3


def test_what_is_not_free_is_aborted_with_pair_and_time(drive, there):
    times, rows = [0.0, 3.0], [[START, [1.45, 1.7, *START[2:]]], np.zeros((2, 7))]
    _, outcomes = send(drive, times, rows)
    drive.run(0.2)
    ((code, reason, _),) = outcomes
    assert code == Code.INVALID_GOAL
    assert reason.startswith("not proven free of collision at ")
    assert " s: panda_" in reason
    assert " and shelf_" in reason


def test_cancel_stops_on_the_path(drive, there):
    execution, outcomes = send(drive, *there)
    drive.run(0.8)
    drive.pilot.cancel()
    drive.run(0.05)
    assert not outcomes  # it still moves
    drive.run(1.0)
    assert outcomes == [(Code.SUCCESSFUL, "cancelled", True)]
    assert not drive.qd.any()
    assert 0 < execution.done < execution.duration
    assert off_path(drive, execution.motion) < 2e-3


def test_a_new_trajectory_takes_the_place_of_the_old_one(drive, there):
    first, outcomes = send(drive, *there)
    drive.run(0.8)
    stop = first.motion.at(first.done)
    _, also = send(drive, [0.0, 2.0], [[stop, START], np.zeros((2, 7))])
    assert outcomes == [(Code.INVALID_GOAL, "a new trajectory took its place", False)]
    arrives(drive, also)
    np.testing.assert_allclose(drive.q, START, atol=1e-6)
    _, third = send(drive, *there)
    drive.run(0.5)
    _, elsewhere = send(drive, [0.0, 2.0], [[START, GOAL]])
    drive.run(1.5)
    assert third[0].code == Code.INVALID_GOAL
    assert elsewhere[0].code == Code.INVALID_GOAL
    assert "from where 'panda_joint1' stands, and 0.05 is allowed" in elsewhere[0].reason


def obstruct(drive, present):
    """Let a cloud show a wall, and perhaps a thing on the way."""
    wall, thing = ball([-0.6, -0.6, 0.3]), ball(drive.robot.keypoints(np.array(WAY[2]))[-1])
    drive.controller.receive_cloud(drive.time, np.concatenate([wall, thing]) if present else wall)


def lose(*names):
    return lambda drive, lost: vars(drive).update(dict.fromkeys(names, lost))


@pytest.mark.parametrize(
    ("fault", "rejected"),
    [
        (lose("people"), ""),
        (lose("joints"), ""),
        (lose("people", "joints"), ""),
        (obstruct, "not proven free of collision at "),
    ],
)
def test_a_fault_stops_it_on_the_path_until_it_is_gone(drive, there, fault, rejected):
    drive.run(0.05)
    fault(drive, False)
    execution, outcomes = send(drive, *there)
    drive.run(0.6)
    fault(drive, True)
    drive.run(2.0)
    assert not drive.qd.any()
    assert 0 < execution.done < execution.duration
    assert execution.rejection.startswith(rejected)
    fault(drive, False)
    arrives(drive, outcomes)
    assert off_path(drive, execution.motion) < 2e-3


# ----------------------------------------------------------------------------------------------------- tolerances


PATH, END = Code.PATH_TOLERANCE_VIOLATED, Code.GOAL_TOLERANCE_VIOLATED
# The tolerances of a goal, what is wrong with the robot or the person, and how the trajectory ends.
ENDS = [
    ({"path": tolerances(panda_joint1={"position": 0.02})}, {"deaf": True}, PATH, r"1' is off by .* more than 0\.02"),
    ({"late": 1.0}, {"person": NEAR}, END, "later than allowed .* of 'operator' may come "),
    ({"end": tolerances(panda_joint2={"position": 1e-3})}, {"off": 0.002}, END, "2' is off by 0.002, more than 0.001"),
]


@pytest.mark.parametrize(("changes", "wrong", "code", "said"), ENDS)
def test_a_trajectory_that_is_not_followed_within_its_tolerances(drive, there, changes, wrong, code, said):
    _, outcomes = send(drive, *there, **changes)
    vars(drive).update(wrong)
    drive.run(there[0][-1] + 3.0)
    assert outcomes[0].code == code
    assert re.search(said, outcomes[0].reason)


def test_when_it_begins(drive, there):
    times, rows = there
    _, outcomes = send(drive, times, rows, stamp=0.5)
    assert outcomes[0].code == Code.OLD_HEADER_TIMESTAMP
    execution, outcomes = send(drive, times, rows, stamp=drive.time + 1.0)
    drive.run(0.9)
    assert drive.q.tolist() == START
    drive.run(0.4)
    assert execution.done > 0
    drive.pilot.cancel()
    drive.run(1.0)
    _, outcomes = send(drive, [1.0], [[START]])  # from where it stands
    arrives(drive, outcomes)
    np.testing.assert_allclose(drive.q, START, atol=1e-6)
    aside = np.array(START) + 0.01
    _, outcomes = send(drive, [0.0, 1.0], [[aside, START]])
    arrives(drive, outcomes)


@pytest.mark.parametrize(
    ("changes", "code", "said"),
    [
        ({"names": ["finger"]}, Code.INVALID_JOINTS, "joint_names: 'finger' is not one of"),
        ({"names": [f"panda_joint{k}" for k in range(1, 7)]}, Code.INVALID_JOINTS, "must be as many as the 6 names"),
        ({"bases": ["base"]}, Code.INVALID_JOINTS, "multi-DOF joints"),
        ({"path": tolerances(joint={})}, Code.INVALID_JOINTS, "path_tolerance: 'joint' is not one of"),
        ({"path": tolerances(panda_joint1={"position": 0.2})}, Code.INVALID_GOAL, "must be at most 0.05"),
        ({"path": tolerances(panda_joint1={"position": -1.0})}, Code.INVALID_GOAL, "must be at most 0.05"),
        ({"end": tolerances(panda_joint1={"acceleration": 1.0})}, Code.INVALID_GOAL, "accelerations are not measured"),
        ({"times": [0.0, 0.0]}, Code.INVALID_GOAL, "time_from_start: must increase from 0 on"),
        ({"rows": [[START, [np.nan] * 7]]}, Code.INVALID_GOAL, "must be finite"),
        ({"rows": [[[], []]]}, Code.INVALID_GOAL, "points: must have at least one point, and positions"),
        ({"times": [], "rows": [[]]}, Code.INVALID_GOAL, "points: must have at least one point, and positions"),
    ],
)
def test_goals_that_cannot_be_taken(cell, changes, code, said):
    changes = {"times": [0.0, 1.0], "rows": [[START, GOAL]], **changes}
    with pytest.raises(GoalError, match=said) as caught:
        Execution.of(goal(cell.robot, changes.pop("times"), changes.pop("rows"), **changes), cell.robot, TOLERANCE)
    assert caught.value.code == code
