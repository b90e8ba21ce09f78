"""`safe-ompl verify`: certificates are checked where they were written, elsewhere, and against what has changed."""

import json
import re
import shutil
from pathlib import Path

import pytest
from signing import replaced, tampered

from safe_ompl.apps import main


@pytest.fixture
def written(call, copied, tmp_path, monkeypatch):
    """Return a folder with a scenario of its own and `proof.json`, the certificate of a path there."""
    folder = tmp_path / "here"
    copied("planar3", folder)
    monkeypatch.chdir(folder)
    assert call("plan", "planar3.yaml", "--certificate", "proof.json")[0] == 0
    return folder


def changed(file, change):
    """Write a certificate that is changed and signed anew, and return its name."""
    Path("changed.json").write_text(json.dumps(tampered(json.loads(Path(file).read_text()), change)))
    return "changed.json"


def edit(file, old, new):
    text = Path(file).read_text()
    assert old in text
    Path(file).write_text(text.replace(old, new))


@pytest.mark.usefixtures("written")
def test_it_says_what_it_is_about_and_what_is_not_claimed(says):
    first, second, third = says("verify proof.json planar3.yaml").splitlines()
    assert first.startswith("proof.json: every motion is free: ")
    content = json.loads(Path("proof.json").read_text())
    assert content["source"] == {"scenario": "planar3.yaml"}
    danger = content["stretches"][0]["danger"]
    kind = f"{danger['aggregate']}, {danger['weighting']}, k1 {danger['k1']:g}, points {danger['spacing']:g} m apart"
    said = re.search(rf"danger at most (\S+) \({re.escape(kind)}\)", first)
    assert danger["bound"] <= float(said[1]) < 1.01 * danger["bound"]
    assert second == "proof.json: robot planar3 and scene of planar3.yaml: person, machine, bin, post"
    assert third == "proof.json: not claimed: clearance, moving obstacles, tool, tube"


def test_without_a_scenario_robot_and_scene_are_the_files_own_which_it_says(call, written, tmp_path, monkeypatch):
    shutil.copy(written / "proof.json", tmp_path / "proof.json")
    here = call("verify", "proof.json")
    shutil.rmtree(written)
    monkeypatch.chdir(tmp_path)
    status, out, err = call("verify", "proof.json")
    assert (0, out, "") == (status, out, err) == here
    first, second, _ = out.splitlines()
    assert first.startswith(
        "proof.json: every motion is free, for the robot and the scene that the file itself carries: "
    )
    own = "robot planar3 and scene are the file's own, compared with no scenario"
    assert second == f"proof.json: {own}: person, machine, bin, post"


@pytest.mark.usefixtures("written")
def test_what_has_changed_in_the_scenario_is_refused(says, refuses):
    edit("planar3.yaml", "position: [0.62, 0.62, 0.0]", "position: [0.62, 0.63, 0.0]")
    refuses("verify proof.json planar3.yaml", "proof.json: the scene has changed since it was written", status=1)
    says("verify proof.json")  # the scenario that the file names is not followed


@pytest.mark.usefixtures("written")
def test_where_the_file_says_that_it_comes_from_is_not_looked_at(call, tmp_path):
    (tmp_path / "secret.yaml").write_text("do not tell")
    for source in ({"scenario": str(tmp_path / "secret.yaml")}, {}):
        status, out, err = call("verify", changed("proof.json", replaced("source", by=source)))
        assert (status, err) == (0, "")
        assert "do not" not in out
        assert "secret" not in out


# --------------------------------------------------------------- people, options of the danger, limits of the motion


@pytest.fixture(scope="module")
def timed(copied, tmp_path_factory):
    """Return a folder with `time.yaml` and `time.json`, the certificate of its timed path beside a person."""
    folder = tmp_path_factory.mktemp("timed")
    text = copied("planar2", folder) + "motion: {acceleration: 4.0, tool_speed: 3.0}\n"
    text += "people: {who: [person], speed: 0.4, reaction_time: 0.1}\ndanger: {k1: 2.0, k2: 0.5}\n"
    (folder / "time.yaml").write_text(text)
    scenario, certificate_file = folder / "time.yaml", folder / "time.json"
    assert main(["plan", str(scenario), "--simplify", "--timed", "--certificate", str(certificate_file)]) == 0
    return folder


@pytest.fixture
def beside(timed, tmp_path, monkeypatch):
    shutil.copytree(timed, tmp_path / "beside")
    monkeypatch.chdir(tmp_path / "beside")


@pytest.mark.usefixtures("beside")
def test_a_timed_path_agrees_with_its_scenario(says):
    stops = "before anyone of person who moves no faster than 0.4 m/s comes nearer than 0 mm"
    says("verify time.json time.yaml", stops, "k1 2, k2 0.5, gamma 1")


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
@pytest.mark.usefixtures("beside")
def test_what_the_scenario_says_otherwise_is_refused(refuses, old, new, message):
    edit("time.yaml", old, new)
    refuses("verify time.json time.yaml", message, status=1)


@pytest.mark.usefixtures("beside")
def test_danger_in_motion_is_compared_even_if_the_path_claims_none(says, refuses):
    def weaker(content):
        (stretch,) = content["stretches"]
        stretch["danger"] = None
        stretch["trajectory"]["danger"]["k1"] = 1e-6

    name = changed("time.json", weaker)
    says(("verify", name))  # the file says itself of what kind its danger is
    words = "danger in motion: k1 is 1e-06 in its claim, 2.0 is asked for"
    refuses(("verify", name, "time.yaml"), words, status=1)
