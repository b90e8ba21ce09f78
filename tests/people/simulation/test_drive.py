"""The report of a drive: known figures from small logs, and the command."""

import json
from pathlib import Path

import numpy as np
import pytest

from safe_ompl import Obstacle, People, Pose, Robot, Scene, Sphere, Surroundings, Tracker
from safe_ompl.apps.cli.program import main
from safe_ompl.geometry import STANDING
from safe_ompl.io import TicksFile, ticks_header
from safe_ompl.people import TrackedBody
from safe_ompl.people.simulation import ALL_KEYPOINTS, DriveReport

BODY = TrackedBody(1.75)
PLACES = {**STANDING, "pelvis": np.full(3, None)}  # as recordings without it have it


@pytest.fixture(scope="module")
def robot():
    return Robot.from_example("ur5")


@pytest.fixture(scope="module")
def header(robot):
    scene = Scene((Obstacle("cube", Sphere(0.1), Pose((3.0, 0.0, 0.0))),))
    people = People(speed=1.6, speeds={"head": 1.0}, clearance=0.02)
    around = Surroundings(scene, {"anna": Tracker(ALL_KEYPOINTS, BODY)}, {"cube": 0.5}, people)
    return json.loads(json.dumps(ticks_header(0.1, robot, around.scene, around.description())))


def tick(robot, time, qd=0.0, stop=(), at=(2.0, 0.0, 0.0), **more):
    """Return a tick in which all joints go at `qd` and come to rest after `stop` [rad] of each, 0.2 s later."""
    q = [0.3] * robot.n
    rows = [q, *([0.3 + turn] * robot.n for turn in stop)]
    points = {
        name: (place if place[0] is None else 1.75 * np.array(place) + at).tolist() for name, place in PLACES.items()
    }
    nearest = {"distance": 0.5, "link": "forearm_link", "who": "anna", "limb": "head"}
    return {
        "time": time,
        "q": q,
        "qd": [qd] * robot.n,
        "stop": {"times": [time, time + 0.2][: len(rows)], "q": rows, "qd": rows},
        "people": {"anna": points},
        "objects": {"cube": {"position": [3.0, 0.0, 0.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}},
        "state": "moving" if qd else "standing",
        "margin": 0.1,
        "reason": "",
        "rule": None,
        "measured": time - 0.05,
        **nearest,
        **more,
    }


def test_the_protective_distance_is_what_limb_and_link_do_until_the_robot_stands(robot, header):
    report = DriveReport.of(header, [tick(robot, 0.1, 0.5, stop=[0.05]), tick(robot, 0.2)], robot)
    links = [part.name.rsplit("_", 1)[0] for part in robot.shared.collision_model.geometryObjects]
    radii = robot.bounds.displacement_radii[[k for k, link in enumerate(links) if link == "forearm_link"]]
    assert report.protective[0] == pytest.approx(1.0 * 0.25 + 0.05 * radii.sum(axis=1).max() + 0.02)
    assert np.isnan(report.protective[1])  # it stands
    h = 1e-4
    apart = robot.keypoints([0.3 + 0.5 * h] * robot.n) - robot.keypoints([0.3 - 0.5 * h] * robot.n)
    np.testing.assert_allclose(report.speed, [np.linalg.norm(apart, axis=1).max() / (2 * h), 0.0], rtol=1e-6)
    assert report.distance.tolist() == [0.5, 0.5]


def test_objects_have_their_speeds_and_logs_without_distances_are_measured(robot, header):
    unknown = dict.fromkeys(("distance", "link", "who", "limb"))
    things = [tick(robot, 0.1, 0.5, stop=[0.0], who="cube", limb=""), tick(robot, 0.2, **unknown, at=(9.0, 0.0, 0.0))]
    report = DriveReport.of(header, things, robot)
    assert report.protective[0] == pytest.approx(0.5 * 0.25 + 0.02)
    assert 0.5 < report.distance[1] < 3.0  # the cube


def test_stops_have_their_causes_and_broken_assumptions_their_limbs(robot, header):
    said = "head of 'anna' may come to panda_link5 before it stands (-{} mm)"
    ticks = [
        tick(robot, 0.1, 0.5, reaction=0.004),
        tick(robot, 0.2, reason=said.format(8), rule="separation", reaction=None),
        tick(robot, 0.3, 0.5, reaction=0.002),
        tick(robot, 0.4, reason=said.format(11), rule="separation", reaction=0.002),
        tick(robot, 0.5, at=(2.0, 0.13, 0.0), reaction=0.002),  # head at 1.3 m/s, others may be as fast
    ]
    report = DriveReport.of(header, ticks, robot)
    assert [(halt.begin, pytest.approx(halt.end)) for halt in report.halts] == [(0.2, 0.3), (0.4, 0.6)]
    assert report.causes() == [
        ("head of 'anna' may come to panda_link5 before it stands (… mm)", 2, pytest.approx(0.3))
    ]
    assert [(broken.begin, broken.what) for broken in report.broken] == [(0.4, "'anna' (head)")]
    assert report.missed == [0.2]
    assert report.as_dict()["reaction"] == {"median": 0.002, "p99": pytest.approx(0.00394)}
    assert report.shares == {"standing": 0.6, "moving": 0.4}
    by_region = [(region["nearer_than"], region["share"]) for region in report.regions()]
    assert by_region == [(0.25, 0.0), (0.5, 0.0), (1.0, 1.0), (2.0, 0.0), (np.inf, 0.0)]
    assert report.assumed == "limbs are no faster than 1.6 m/s"
    assert report.made_by["robot (hash)"] == header["robot"]["hash"]
    ticks[1]["obeyed"] = False  # the simulation knows it
    assert [broken.begin for broken in DriveReport.of(header, ticks, robot).broken] == [0.2, 0.4]


def test_the_command_writes_page_and_figures(robot, header, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    log = TicksFile(tmp_path / "ticks.jsonl", header)
    for one in (tick(robot, 0.1, 0.5, stop=[0.05]), tick(robot, 0.2, reason="<b>")):
        log.write(one)
    log.close()
    page, figures = tmp_path / "report.html", tmp_path / "report.json"
    assert main(["report", str(tmp_path), "--html", str(page), "--json", str(figures)]) == 0
    assert "while it moved: the least distance 500 mm" in capsys.readouterr().out
    text = page.read_text(encoding="utf-8")
    assert "<svg" in text
    assert "&lt;b&gt;" in text
    assert "ISO 10218-2:2025" in text
    assert json.loads(figures.read_text())["over_time"]["distance"] == [0.5, 0.5]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("ticks.txt", "", "LOG: 'ticks.txt' must end in .jsonl or .mcap"),
        ("ticks.jsonl", "{", "ticks.jsonl"),
        ("ticks.jsonl", '{"format": "safe-ompl ticks", "version": 2}', "ticks.jsonl: holds no tick"),
    ],
)
def test_the_command_refuses_in_one_line(tmp_path, monkeypatch, capsys, name, text, message):
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(text, encoding="utf-8")
    assert main(["report", name]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert len(said.strip().splitlines()) == 1
