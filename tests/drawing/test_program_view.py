"""A program in a view: one motion with its gripper; things go with the tip while it holds them."""

import dataclasses
import json

import numpy as np
import pytest
from matplotlib.image import imread

import safe_ompl
from safe_ompl import InputError
from safe_ompl.apps import main
from safe_ompl.certificates import program_certificate
from safe_ompl.drawing import ViewerContent, plots


@pytest.fixture(scope="module")
def result():
    found = safe_ompl.plan_program("panda_pick_place")
    assert found
    return found


@pytest.fixture(scope="module")
def certified(result):
    stretches = ((stretch.begin, stretch.check) for stretch in result.stretches)
    steps = [str(result.scenario.program.steps[stretch.step]) for stretch in result.stretches]
    return ViewerContent.of_certificate(program_certificate(stretches, steps=steps), "panda_pick_place")


@pytest.mark.parametrize("source", ["result", "certificate"])
def test_the_cube_goes_with_the_tip_while_it_is_held(source, result, certified):
    content = ViewerContent.of_program(result) if source == "result" else certified
    (shown,) = content.motions.values()
    assert shown.motion.duration == pytest.approx(result.duration)
    np.testing.assert_allclose(shown.motion.at(shown.motion.times), result.motion.at(shown.motion.times), atol=1e-9)
    assert content.movers.objects == {"cube"}
    held = [s for s in result.stretches if s.robot.attached]
    begin, end = held[0].begin, held[-1].begin + held[-1].motion.duration
    grasps = []
    for time in np.linspace(0.0, shown.motion.duration, 77):
        cube = content.movers.places_at(time)["cube"].se3
        tip = content.robot.tip_pose(shown.motion.at(np.array([time]))[0])
        if time <= begin:
            np.testing.assert_allclose(cube.translation, (0.45, 0.32, 0.025), atol=1e-9)
        elif time >= end:
            np.testing.assert_allclose(cube.translation[2], 0.335, atol=1e-3)
        else:
            grasps.append((tip.inverse() * cube).homogeneous)
            assert "holding cube" in shown.remark(time)
    np.testing.assert_allclose(grasps, np.broadcast_to(grasps[0], (len(grasps), 4, 4)), atol=1e-3)
    assert any("line grasp cube" in shown.remark(time) for time in np.linspace(0.0, begin, 60))
    assert {"move", "line", "gripper"} == set(shown.binding)


def test_nothing_planned_is_nothing_to_show(result):
    with pytest.raises(InputError, match="nothing was planned"):
        ViewerContent.of_program(dataclasses.replace(result, stretches=(), why="step 1: no"))


def test_the_picture_has_the_steps_in_time_beside_the_robot(result):
    (axes,) = plots.plot_program(result, None).axes
    words = [label.get_text() for label in axes.get_yticklabels()]
    steps = result.scenario.program.steps
    assert [word.split()[:2] for word in words] == [[str(k), step.kind] for k, step in enumerate(steps, 1)]
    for k, bars in enumerate(axes.collections):
        spans = [(s.begin, s.begin + s.motion.duration) for s in result.stretches if s.step == k]
        edges = np.sort([path.vertices[:, 0] for path in bars.get_paths()])[:, [0, -1]]
        before = max((s.begin + s.motion.duration for s in result.stretches if s.step < k), default=0.0)
        np.testing.assert_allclose(edges, spans or [(before, before)], atol=1e-9)


def test_the_command_draws_and_writes_a_motion_that_is_read_back(result, tmp_path, monkeypatch):
    monkeypatch.setattr("safe_ompl.tasks.plan_program", lambda *_, **__: result)
    words = ["--plot", str(tmp_path / "p.png"), "--json", str(tmp_path / "p.json")]
    assert main(["plan", "panda_pick_place", *words]) == 0
    shown = imread(tmp_path / "p.png")[..., :3]
    robots, timeline = shown[:, : len(shown) * 5 // 4], shown[:, len(shown) * 5 // 4 :]
    orange = [(np.abs(half - [0.85, 0.51, 0.13]).max(axis=2) < 0.15).sum() for half in (robots, timeline)]
    assert min(orange) > 100  # the cube and the clothes, and the steps of the gripper
    assert (timeline.mean(axis=2) > 0.99).mean() > 0.5
    safe_ompl.save(result, tmp_path / "saved.json")
    for file in ("p.json", "saved.json"):
        read, motion = safe_ompl.load(tmp_path / file), result.motion
        assert read.joint_names == motion.joint_names
        np.testing.assert_array_equal(read.coefficients, motion.coefficients)
        said = json.loads((tmp_path / file).read_text())
        assert said["steps"][0] == "move grasp cube back 0.12"
        assert said["stretches"][-1]["step"] == 10
    nothing = dataclasses.replace(result, stretches=(), why="step 1: no")
    with pytest.raises(InputError, match="nothing was planned"):
        safe_ompl.save(nothing, tmp_path / "none.json")


def test_a_certificate_is_shown_on_a_page(result, tmp_path):
    pytest.importorskip("viser")
    first = [(stretch.begin, stretch.check) for stretch in result.stretches[:1]]
    file, page = tmp_path / "proof.json", tmp_path / "proof.html"
    file.write_text(json.dumps(program_certificate(first)))
    assert main(["view", str(file), "--html", str(page)]) == 0
    assert page.stat().st_size > 100_000
