"""`safe-ompl verify`: certificates are checked where they were written, elsewhere, and against what has changed."""

import json
import shutil
from pathlib import Path

import pytest

from safe_ompl.apps import main
from safe_ompl.io.schema import digest
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
    assert third == "proof.json: not claimed: clearance, moving obstacles, tool, tube"


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


OTHERWISE = [
    ("k1: 2.0", "k1: 3.0", "danger: k1 is 2.0 in its claim, 3.0 is asked for"),
    ("k2: 0.5", "k2: 0.25", "danger in motion: k2 is 0.5 in its claim, 0.25 is asked for"),
    ("speed: 0.4", "speed: 0.5", "stops: speed is 0.4 in its claim, 0.5 is asked for"),
    ("reaction_time: 0.1", "reaction_time: 0.2", "stops: reaction_time is 0.1"),
    ("who: [person]", "who: [bin]", r"stops: who is ('person',) in its claim, ['bin'] is asked for"),
    ("people: {who: [person], speed: 0.4, reaction_time: 0.1}", "", "stops: is claimed, but"),
    ("tool_speed: 3.0", "tool_speed: 2.5", "motion in time: tool_speed is 3.0 in its claim, 2.5 is asked for"),
    ("acceleration: 4.0", "acceleration: 3.0", "motion in time: acceleration is [4.0, 4.0] in its claim"),
]


@pytest.mark.parametrize(("old", "new", "message"), OTHERWISE)
def test_what_the_scenario_says_otherwise_is_refused(call, beside, old, new, message):
    edited("time.yaml", old, new)
    status, out, err = call("verify", "time.json", "time.yaml")
    assert (status, out) == (1, "")
    assert message in err


def test_danger_in_motion_is_compared_even_if_the_path_claims_none(call, beside):
    def weaker(content):
        (stretch,) = content["stretches"]
        stretch["danger"] = None
        stretch["trajectory"]["danger"]["k1"] = 1e-6

    name = changed("time.json", weaker)
    assert call("verify", name)[0] == 0, "it says itself of what kind it is"
    status, out, err = call("verify", name, "time.yaml")
    assert (status, out) == (1, "")
    assert "danger in motion: k1 is 1e-06 in its claim, 2.0 is asked for" in err
