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
def test_a_page_is_written(what, files, tmp_path, capsys):
    page = tmp_path / "view.html"
    assert main(["view", str(files.get(what, "planar2")), "--html", str(page)]) == 0
    assert "__VISER_EMBED_DATA__" in page.read_text(encoding="utf-8")
    captured = capsys.readouterr()
    assert captured.out == ""  # viser's banner, for one
    assert f"view in {page}" in captured.err.replace("\n", "")


def test_what_cannot_be_shown_is_refused(files, tmp_path, capsys):
    other = tmp_path / "other.json"
    other.write_text(json.dumps({"format": "something"}))
    for words, said in [
        (["nowhere"], "nowhere"),
        ([str(files["TRAJECTORY"]), str(files["RESULT"])], "either results or trajectories, not both"),
        ([str(other)], "format: must be 'safe-ompl'"),
        (["planar2", "planar3"], "one scenario at a time"),
        (["planar2", str(files["RESULT"])], "not both"),
        (["planar2", "--html", "-"], "--html: '-' must end in .html"),
        (["planar2", "--html", "x.pdf"], "--html: 'x.pdf' must end in .html"),
        (["planar2", "--animation", "x.mp4"], "--animation: 'x.mp4' must end in .webp or .gif"),
        (["planar2", "--port", "99999"], "--port: must be a port in [1, 65535], not '99999'"),
    ]:
        assert main(["view", *words]) == 2
        assert said in capsys.readouterr().err


def test_a_start_in_collision_can_be_looked_at(tmp_path, capsys):
    scenario = Scenario.load("planar2")
    block = Obstacle("block", Box((3.0, 3.0, 3.0)))
    file, page = tmp_path / "stuck.yaml", tmp_path / "view.html"
    dataclasses.replace(scenario, scene=scenario.scene.with_obstacles(block)).save(file)
    assert main(["view", str(file), "--html", str(page)]) == 2
    assert "is in collision" in capsys.readouterr().err
    assert main(["view", str(file), "--planners", "none", "--html", str(page)]) == 0
    assert page.is_file()
