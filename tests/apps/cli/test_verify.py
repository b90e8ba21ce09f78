"""`safe-ompl verify`: certificates are checked where they were written, elsewhere, and against what has changed."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safe_ompl import RateLimits, Scenario
from safe_ompl.apps import main
from safe_ompl.apps.cli.verify import certificate_of
from safe_ompl.certificates import motion_certificate
from safe_ompl.collision import Separation
from safe_ompl.io.schema import digest
from safe_ompl.motions import Motion, check
from safe_ompl.planning import setup_scenario
from safe_ompl.scene import find_scenario


@pytest.fixture
def written(call, tmp_path, monkeypatch):
    """Return a folder with a scenario of its own and `proof.json`, the certificate of a path there."""
    source = find_scenario("planar3").resolve()
    folder = tmp_path / "here"
    (folder / "robots").mkdir(parents=True)
    shutil.copy(source, folder / "planar3.yaml")
    for file in (source.parent / "robots").glob("planar3.*"):
        shutil.copy(file, folder / "robots" / file.name)
    monkeypatch.chdir(folder)
    assert call("plan", "planar3.yaml", "--certificate", "proof.json")[0] == 0
    return folder


def changed(file, change, name="changed.json"):
    """Write a certificate that is changed, with the digest that belongs to it, and return its name."""
    content = json.loads(Path(file).read_text())
    change(content)
    Path(name).write_text(json.dumps({**content, "digest": digest(content)}))
    return name


def edited(file, old, new, name=None):
    """Write a file with other words, beside it or in its place, and return its path."""
    text = Path(file).read_text()
    assert old in text
    target = Path(file).with_name(name) if name else Path(file)
    target.write_text(text.replace(old, new))
    return target


def test_it_says_what_it_is_about_and_what_is_not_claimed(call, written):
    status, out, err = call("verify", "proof.json", "planar3.yaml")
    assert (status, err) == (0, "")
    first, second, third = out.splitlines()
    assert first.startswith("proof.json: every motion is free: ")
    assert second == "proof.json: robot planar3 and scene of planar3.yaml: person, machine, bin, post"
    assert third == "proof.json: not claimed: clearance, moving obstacles, tool"


def test_without_a_scenario_robot_and_scene_are_the_files_own_which_it_says(call, written, tmp_path, monkeypatch):
    shutil.copy(written / "proof.json", tmp_path / "proof.json")
    here = call("verify", "proof.json")
    shutil.rmtree(written)
    monkeypatch.chdir(tmp_path)
    status, out, err = call("verify", "proof.json")
    assert (status, out, err) == here
    assert (status, err) == (0, "")
    first, second, _ = out.splitlines()
    assert first.startswith(
        "proof.json: every motion is free, for the robot and the scene that the file itself carries: "
    )
    own = "robot planar3 and scene are the file's own, compared with no scenario"
    assert second == f"proof.json: {own}: person, machine, bin, post"


def test_what_has_changed_in_the_scenario_is_refused(call, written):
    edited("planar3.yaml", "position: [0.62, 0.62, 0.0]", "position: [0.62, 0.63, 0.0]")
    status, out, err = call("verify", "proof.json", "planar3.yaml")
    assert (status, out) == (1, "")
    assert err == "safe-ompl: proof.json: the scene has changed since it was written\n"
    assert call("verify", "proof.json")[0] == 0, "the scenario that the file names is not followed"


def test_where_the_file_says_that_it_comes_from_is_not_looked_at(call, written, tmp_path):
    secret = tmp_path / "secret.yaml"
    secret.write_text("do not tell")
    name = changed("proof.json", lambda content: content.update(source={"scenario": str(secret)}))
    status, out, err = call("verify", name)
    assert (status, err) == (0, "")
    assert "do not" not in out
    assert "secret" not in out
    assert call("verify", changed("proof.json", lambda content: content.update(source={})))[0] == 0


def test_what_is_carried_is_checked(call, written):
    name = changed("proof.json", lambda content: content["scene"]["content"]["obstacles"].pop())
    status, out, err = call("verify", name)
    assert (status, out) == (1, "")
    assert err == f"safe-ompl: {name}: the scene that it carries is not the one that it was written for\n"


# ------------------------------------------------------------------------------------------------- the robot


@pytest.fixture
def thinner(call, written):
    """Return the certificate of a path of a robot that is thinner than the scenario's: as planned, nothing forged."""
    urdf = edited("robots/planar3.urdf", 'radius="0.045"', 'radius="0.001"', "thinner.urdf")
    options = ("--urdf", urdf, "--srdf", "robots/planar3.srdf", "--tip", "tip")
    assert call("plan", "planar3.yaml", *options, "--certificate", "thin.json")[0] == 0
    return options


def test_the_robot_is_the_scenarios_whatever_the_file_says(call, thinner):
    status, out, err = call("verify", "thin.json", "planar3.yaml")
    assert (status, out) == (1, "")
    assert "the robot has changed: 'planar3' is not the one that it was written for" in err


def test_a_robot_that_the_file_names_is_not_taken_instead_of_the_scenarios(call, thinner):
    def claim(content):
        content["source"]["robot"] = {"urdf": "robots/thinner.urdf", "srdf": "robots/planar3.srdf", "tip": "tip"}

    assert call("verify", changed("thin.json", claim), "planar3.yaml")[0] == 1


def test_another_robot_is_named_by_the_user(call, thinner):
    status, out, err = call("verify", "thin.json", "planar3.yaml", *thinner)
    assert (status, err) == (0, "")
    assert f"robot planar3 of {thinner[1]} and scene of planar3.yaml: " in out
    assert call("verify", "proof.json", "planar3.yaml", *thinner)[0] == 1


def test_a_carried_robot_may_be_built_from_its_files(call, written, tmp_path):
    urdf = written / "robots" / "planar3.urdf"
    status, out, _ = call("verify", "proof.json", "--urdf", urdf)
    assert status == 0
    assert f"robot planar3 (with the URDF {urdf}) and scene are the file's own" in out
    thicker = edited(urdf, 'radius="0.045"', 'radius="0.046"', "thicker.urdf")
    status, _, err = call("verify", "proof.json", "--urdf", thicker)
    assert status == 1
    assert "the robot has changed: 'planar3'" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--urdf", "nothing.urdf"], "nothing.urdf' does not exist"),
        (["--package-dir", "nothing"], "package folder 'nothing' does not exist"),
        (["--tip", "link2"], "--tip: is for verification against a scenario: give the scenario, too"),
        (["nowhere.yaml"], "unknown scenario file or name 'nowhere.yaml'"),
    ],
)
def test_options_that_do_not_fit(call, written, options, message):
    status, out, err = call("verify", "proof.json", *options)
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


# --------------------------------------------------------------- people, options of the danger, limits of the motion


@pytest.fixture(scope="module")
def timed(tmp_path_factory):
    """Return a folder with `time.yaml` and `time.json`, the certificate of its timed path beside a person."""
    folder = tmp_path_factory.mktemp("timed")
    source = find_scenario("planar2").resolve()
    (folder / "robots").mkdir()
    for file in (source.parent / "robots").glob("planar2.*"):
        shutil.copy(file, folder / "robots" / file.name)
    text = source.read_text() + "motion: {acceleration: 4.0, tool_speed: 3.0}\n"
    text += "people: {who: [person], speed: 0.4, reaction_time: 0.1}\ndanger: {k1: 2.0, k2: 0.5}\n"
    (folder / "time.yaml").write_text(text)
    scenario, certificate_file = folder / "time.yaml", folder / "time.json"
    assert main(["plan", str(scenario), "--simplify", "--timed", "--certificate", str(certificate_file)]) == 0
    return folder


@pytest.fixture
def beside(timed, tmp_path, monkeypatch):
    shutil.copytree(timed, tmp_path / "beside")
    monkeypatch.chdir(tmp_path / "beside")


def test_a_timed_path_agrees_with_its_scenario(call, beside):
    status, out, err = call("verify", "time.json", "time.yaml")
    assert (status, err) == (0, "")
    assert "before anyone of person who moves no faster than 0.4 m/s comes nearer than 0 mm" in out
    assert "k1 2, k2 0.5, gamma 1" in out


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("k1: 2.0", "k1: 3.0", "danger: k1 is 2.0 in its claim, 3.0 is asked for"),
        ("k2: 0.5", "k2: 0.25", "danger in motion: k2 is 0.5 in its claim, 0.25 is asked for"),
        ("speed: 0.4", "speed: 0.5", "stops: speed is 0.4 in its claim, 0.5 is asked for"),
        ("reaction_time: 0.1", "reaction_time: 0.2", "stops: reaction_time is 0.1"),
        ("who: [person]", "who: [bin]", r"stops: who is ('person',) in its claim, ['bin'] is asked for"),
        ("people: {who: [person], speed: 0.4, reaction_time: 0.1}", "", "stops: it is claimed, but"),
        ("tool_speed: 3.0", "tool_speed: 2.5", "motion in time: tool_speed is 3.0 in its claim, 2.5 is asked for"),
        ("acceleration: 4.0", "acceleration: 3.0", "motion in time: acceleration is [4.0, 4.0] in its claim"),
    ],
)
def test_what_the_scenario_says_otherwise_is_refused(call, beside, old, new, message):
    edited("time.yaml", old, new)
    status, out, err = call("verify", "time.json", "time.yaml")
    assert (status, out) == (1, "")
    assert message in err


def test_danger_in_motion_is_compared_even_if_the_path_claims_none(call, beside):
    def weaker(content):
        content["danger"] = None
        content["trajectory"]["danger"]["k1"] = 1e-6

    name = changed("time.json", weaker)
    assert call("verify", name)[0] == 0, "it says itself of what kind it is"
    status, out, err = call("verify", name, "time.yaml")
    assert (status, out) == (1, "")
    assert "danger in motion: k1 is 1e-06 in its claim, 2.0 is asked for" in err


@pytest.mark.parametrize("limb", ["every limb", "head", "machine"])
def test_speeds_of_limbs_that_nobody_has_are_not_claimed(call, beside, limb):
    name = changed("time.json", lambda content: content["trajectory"]["stops"]["speeds"].update({limb: 50.0}))
    status, out, err = call("verify", name)
    assert (status, out) == (2, "")
    assert f"trajectory.stops.speeds: unknown limb '{limb}'; known: (none)" in err


# ------------------------------------------------------------------------------------------------- hostile text


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"danger": ', '"danger": null, "danger": ', "'danger': is there twice"),
        ('"danger": ', '"also_sampled": NaN, "danger": ', "NaN is not finite"),
        ('"danger": ', '"also_sampled": "a\\nproof.json: all is well", "danger": ', "must be text of one line"),
        ('"danger": ', '"also_\\nsampled": null, "danger": ', "must be text that can be printed"),
        ('"danger": ', '"also_sampled": ' + 100_000 * "[", "malformed JSON: nested too deeply"),
    ],
)
def test_text_that_would_mislead_a_reader(call, written, old, new, message):
    edited("proof.json", old, new)
    status, out, err = call("verify", "proof.json")
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_what_a_setup_proves_of_moving_obstacles_stands_in_its_certificate(call, written):
    scenario = Scenario.load(written / "planar3.yaml")
    setup = setup_scenario(scenario, scenario.build_robot())
    assert not setup.getConstraints().separation.speeds
    setup.setMovingObstacles({"person": 0.1}, 0.5)
    result = setup.plan("SafeRRTConnect", time=20, seed=0)
    content = certificate_of(result, setup, scenario, str(written / "moving.json"))
    assert content["moving_obstacles"] == {"speeds": {"person": 0.1}, "time": 0.5}
    Path("moving.json").write_text(json.dumps(content))
    status, out, err = call("verify", "moving.json")
    assert (status, err) == (0, "")
    assert "the same while obstacles move no faster than person 0.1 m/s, for 0.5 s" in out
    assert "not claimed: clearance, tool\n" in out


def test_a_robot_of_a_scenario_that_holds_something_travels(call, tmp_path, monkeypatch):
    """On a base, with a mesh in the gripper: nothing of it is left where it is verified."""
    here, there = tmp_path / "here", tmp_path / "there"
    for folder in (here, there):
        folder.mkdir()
    shutil.copy(Path(__file__).parents[2] / "data" / "wedge.obj", here / "wedge.obj")
    (here / "held.yaml").write_text(
        """
robot:
  example: ur5
  base: {position: [0, 0, 0.5]}
  attached:
    - {name: part, link: tool0, position: [0, 0, 0.1], mesh: {file: wedge.obj, scale: [0.05, 0.05, 0.05]}, danger: true}
scene:
  obstacles:
    - {name: post, position: [0.9, 0.9, 0.5], box: {size: [0.1, 0.1, 1]}, weight: 1}
start: [0, -1.5, 0.5, 0.3, 0.2, 0]
goal: {configuration: [0.4, -1.5, 0.6, 0.3, 0.2, 0]}
"""
    )
    monkeypatch.chdir(here)
    assert call("plan", "held.yaml", "--certificate", there / "proof.json")[0] == 0
    monkeypatch.chdir(there)
    shutil.rmtree(here)
    status, out, err = call("verify", "proof.json")
    assert (status, err) == (0, "")
    assert "robot ur5 and scene are the file's own, compared with no scenario: post" in out


def test_a_tube_and_a_motion_of_polynomials(call, written):
    scenario = Scenario.load(written / "planar3.yaml")
    setup = setup_scenario(scenario, scenario.build_robot())
    tube = (0.002,) * setup.robot.n
    setup.setConstraints(replace(setup.getConstraints(), separation=Separation(tube=tube)))
    result = setup.plan("SafeRRTConnect", time=20, seed=0)
    content = certificate_of(result, setup, scenario, str(written / "tube.json"))
    assert content["tube"] == list(tube)
    limits = RateLimits.of(setup.robot, scenario.motion.velocity, scenario.motion.acceleration)
    motion = Motion.through(result.path, 10.0 * len(result.path) * np.linspace(0, 1, len(result.path)))
    proven = check(motion, setup.robot, setup.scene, tube=tube)
    Path("tube.json").write_text(json.dumps(content))
    Path("motion.json").write_text(json.dumps(motion_certificate(proven)))
    for file in ("tube.json", "motion.json"):
        status, out, err = call("verify", file, "planar3.yaml")
        assert (status, err) == (0, "")
        assert "; the same with joints off by up to (0.002, 0.002, 0.002) [rad or m]" in out
    assert f"{motion.pieces} edges" in out
    faster = json.loads(Path("motion.json").read_text())
    faster["motion"]["velocity"] = (2 * limits.velocity).tolist()
    Path("faster.json").write_text(json.dumps({**faster, "digest": digest(faster)}))
    assert call("verify", "faster.json")[0] == 0
    status, _, err = call("verify", "faster.json", "planar3.yaml")
    assert status == 1
    assert "motion: velocity is" in err
