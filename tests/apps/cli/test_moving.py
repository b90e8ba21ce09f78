"""Obstacles that may move, on the command line and in scenarios: paths are free whatever they do."""

import json

import pytest

from safe_ompl import InputError, Scenario, load, plan
from safe_ompl.apps import main
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import MovingObstacles, find_scenario
from safe_ompl.scene.constraints import PathLimits


@pytest.fixture
def call(capfd, tmp_path, monkeypatch):
    """Return a function that runs the command line in a folder of its own, and returns status, output and errors."""
    planar3 = find_scenario("planar3").resolve()
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        capfd.readouterr()
        try:
            status = main(["plan", str(planar3), *arguments])
        except SystemExit as end:
            status = end.code
        out, err = capfd.readouterr()
        return status, " ".join(out.split()), " ".join(err.split())

    return run


def test_the_path_keeps_what_obstacles_may_come_nearer(call):
    given = ("--moving", "person=0.2,post=0.05", "--moving-time", "0.5")
    status, out, err = call(*given, "--json", "result.json", "--certificate", "proof.json")
    assert (status, err) == (0, "")
    assert "free whatever they do for 0.5 s: person up to 0.2 m/s, post up to 0.05 m/s" in out
    claimed = {"speeds": {"person": 0.2, "post": 0.05}, "time": 0.5}
    with open("result.json") as result, open("proof.json") as proof:
        told, content = json.load(result), json.load(proof)
    assert told["moving_obstacles"] == content["moving_obstacles"] == claimed
    assert told["clearance"]["obstacles"]["person"] >= 0.1
    assert load("result.json").moving_obstacles == claimed


def test_a_scenario_says_it_and_options_say_it_instead(call, tmp_path):
    scenario = Scenario.load(find_scenario("planar3"))
    limits = PathLimits.from_mapping({"moving": {"speeds": {"person": 0.2}, "time": 0.5}})
    assert PathLimits.from_mapping(limits.to_mapping()) == limits
    moving = Scenario(**{**vars(scenario), "limits": limits})
    assert setup_scenario(moving).getConstraints().separation.speeds == {"person": 0.2}
    assert plan(moving).moving_obstacles == {"speeds": {"person": 0.2}, "time": 0.5}
    assert plan(scenario).moving_obstacles is None


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["--moving", "person"], "must have the form NAME=SPEED[,NAME=SPEED…], not 'person'"),
        (["--moving", "person=-1", "--moving-time", "1"], "must be a speed >= 0 [m/s] for 'person', not '-1'"),
        (["--moving", "person=1,person=2"], "'person' is given twice"),
        (["--moving", "persn=1", "--moving-time", "1"], "--moving: unknown obstacle 'persn'; did you mean 'person'? "),
        (["--moving", "person=1"], "--moving: needs how long they move: give --moving-time SECONDS, too"),
        (["--moving-time", "1"], "--moving-time: needs the obstacles that move: give --moving, too"),
        (["--moving", "person=9", "--moving-time", "9"], "'person' may move 81000 mm, and come to"),
    ],
)
def test_mistakes_are_one_clear_line(call, options, why):
    status, _, err = call(*options)
    assert status == 2
    assert why in err


@pytest.mark.parametrize(
    ("data", "why"),
    [
        ({"speeds": {}, "time": 1}, "speeds: must name one obstacle"),
        ({"speeds": {"person": -1}, "time": 1}, "speeds.person: must be"),
        ({"speeds": {"person": 1}, "time": 0}, "time: must be"),
        ({"speeds": {"person": 1}}, "time"),
        ({"speeds": {"person": 1}, "time": 1, "tme": 1}, "tme: unknown key"),
    ],
)
def test_scenarios_with_mistakes(data, why):
    with pytest.raises(InputError, match=why):
        MovingObstacles.from_mapping(data)
