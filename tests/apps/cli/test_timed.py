"""`safe-ompl plan --timed`, `PlanResult.timed`, and the keys of the scenario that they read."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pytest

from safe_ompl import InputError, KinetostaticField, People, Scenario, Trajectory, plan, read_motion
from safe_ompl.scene import MotionLimits


@pytest.fixture(scope="module")
def beside_her():
    scenario = Scenario.load("panda_shelf")
    accelerations = (15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0)
    return replace(
        scenario,
        motion=MotionLimits(acceleration=accelerations, tool_speed=1.0),
        people=People(speed=0.2, reaction_time=0.05),
    )


@pytest.fixture(scope="module")
def scenario_file(beside_her, tmp_path_factory):
    file = tmp_path_factory.mktemp("timed") / "beside_her.yaml"
    beside_her.save(file)
    return file


def test_where_people_allow_no_motion_the_command_says_so(call, beside_her, tmp_path):
    file = tmp_path / "crowded.yaml"
    replace(beside_her, people=People(reaction_time=2.0)).save(file)
    status, _, err = call("plan", file, "--timed")
    assert status == 2
    assert "nothing allows the robot to move at" in err


def test_the_command_times_and_writes_joint_trajectories(says, scenario_file, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    plan = f"plan {scenario_file} --time 5 --rate 50 --trajectory"
    says(f"{plan} trajectory.csv")
    assert 0.019 < np.diff(read_motion("trajectory.csv").times).max() < 0.02 * 1.001
    says(f"check trajectory.csv --scenario {scenario_file}")
    says(f"{plan} trajectory.json --certificate proof.json --timed-plot motion.png", "timed: ")
    assert (tmp_path / "motion.png").stat().st_size > 10_000
    told = json.loads((tmp_path / "trajectory.json").read_text())
    assert {"joint_names", "points", "duration", "limits", "velocity_limits"} <= set(told)
    assert [limit["name"] for limit in told["velocity_limits"]] == [
        "joint velocity",
        "blends beside people",
        "separation",
        "tool speed",
    ]
    times = [point["time_from_start"] for point in told["points"]]
    assert 0.019 < np.diff(times).max() < 0.02 * 1.001
    says(f"check trajectory.json --scenario {scenario_file}", "stops beside people")
    says("verify proof.json", "it stands before anyone of operator who moves no faster than 0.2 m/s")


def test_points_that_are_not_proven_are_not_written(says, scenario_file, tmp_path, monkeypatch):
    file = tmp_path / "trajectory.json"
    original = Trajectory.points

    def sampled(trajectory, rate):  # as they were once
        times = original(trajectory, rate)[0]
        return times, dict(zip(("positions", "velocities", "accelerations"), trajectory.at(times), strict=True))

    monkeypatch.setattr(Trajectory, "points", sampled)
    notes = "nothing is written to", "acceleration at"
    says(f"plan {scenario_file} --time 5 --trajectory {file}", status=1, notes=notes)
    assert not file.exists()


def test_results_are_timed_where_they_were_made(beside_her):
    result = plan(beside_her, time=5.0, seed=0)
    trajectory = result.timed(tool_speed=0.5)
    np.testing.assert_allclose(trajectory.at(0.0).q, result.path[0], atol=1e-9)
    sent = pickle.loads(pickle.dumps(result))
    with pytest.raises(InputError, match="call time_path"):
        sent.timed()
    with pytest.raises(InputError, match="there is no path to time"):
        replace(result, path=None).timed()


def test_danger_in_motion_is_told_and_kept(says, beside_her, tmp_path):
    result = plan(beside_her, time=5.0, seed=0)
    free = result.timed()
    field = result.danger_field()
    assert field.gamma == 1
    limit = 0.5 * (free.danger(KinetostaticField(field)).peak + field.values(free.at(free.law.times).q).max())
    limited = result.timed(max_danger=limit)
    assert limited.duration > free.duration
    assert limited.danger(KinetostaticField(field)).peak <= limit
    file = tmp_path / "dangerous.yaml"
    motion = replace(beside_her.motion, max_danger=limit)
    replace(beside_her, motion=motion, people=None, danger={"gamma": 0.0}).save(file)
    assert Scenario.load(file).motion.max_danger == limit
    says(f"plan {file} --timed", "danger in motion: mean")
    with pytest.raises(InputError, match="danger: give both danger"):
        replace(result, danger=None).timed(max_danger=limit)
    with pytest.raises(InputError, match="has no danger field"):
        replace(result, danger=None).danger_field()
