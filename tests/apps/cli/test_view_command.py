"""`safe-ompl view` from scenarios, results and certificates to a page."""

import dataclasses
import json

import pytest

from safe_ompl import Box, Obstacle, Scenario
from safe_ompl.apps import main

pytest.importorskip("viser")


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("view")
    result, proof, motion = (folder / f"{name}.json" for name in ("result", "proof", "motion"))
    written = ["--json", str(result), "--certificate", str(proof), "--trajectory", str(motion)]
    assert main(["plan", "planar2", *written]) == 0
    return {"RESULT": result, "CERTIFICATE": proof, "TRAJECTORY": motion}


@pytest.mark.parametrize("what", ["SCENARIO", "RESULT", "CERTIFICATE", "TRAJECTORY"])
def test_a_page_is_written(says, what, files, tmp_path):
    page = tmp_path / "view.html"
    out = says(f"view {files.get(what, 'planar2')} --html {page}", notes=[f"view in {page}"])
    assert out == ""  # viser's banner, for one
    assert "__VISER_EMBED_DATA__" in page.read_text(encoding="utf-8")


NOT_SHOWN = [
    ("nowhere", "nowhere"),
    ("{TRAJECTORY} {RESULT}", "either results or trajectories, not both"),
    ("other.json", "format: must be 'safe-ompl'"),
    ("planar2 planar3", "one scenario at a time"),
    ("planar2 {RESULT}", "either a scenario or files of results, not both"),
    ("planar2 --html -", "--html: '-' must end in .html"),
    ("planar2 --html x.pdf", "--html: 'x.pdf' must end in .html"),
    ("planar2 --animation x.mp4", "--animation: 'x.mp4' must end in .webp or .gif"),
    ("planar2 --port 99999", "--port: must be a port in [1, 65535], not '99999'"),
    ("stuck.yaml --html view.html", "is in collision"),
]


@pytest.fixture
def stuck(tmp_path, monkeypatch):
    """Begin in a folder with a scenario whose start is in collision."""
    monkeypatch.chdir(tmp_path)
    scenario, block = Scenario.load("planar2"), Obstacle("block", Box((3.0, 3.0, 3.0)))
    dataclasses.replace(scenario, scene=scenario.scene.with_obstacles(block)).save("stuck.yaml")


@pytest.mark.parametrize(("words", "said"), NOT_SHOWN)
@pytest.mark.usefixtures("stuck")
def test_what_cannot_be_shown_is_refused(refuses, files, tmp_path, words, said):
    (tmp_path / "other.json").write_text(json.dumps({"format": "something"}))
    refuses(f"view {words.format(**files)}", said)


@pytest.mark.usefixtures("stuck")
def test_a_start_in_collision_can_be_looked_at(says, tmp_path):
    says("view stuck.yaml --planners none --html view.html")
    assert (tmp_path / "view.html").is_file()
