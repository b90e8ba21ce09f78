"""Pictures of configuration spaces and of the danger field; the surface they are drawn with."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "bench"))

from _paper import figures, planar
from _paper.planar import isosurface, plot_bubbles, plot_cspace_path, plot_field

from safe_ompl import CollisionChecker, InputError, Scenario
from safe_ompl.scene import find_scenario


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    monkeypatch.setattr(planar, "_GRID_PIXELS", 31)
    monkeypatch.setattr(planar, "_VOXELS", 13)


def checker_of(name):
    scenario = Scenario.load(find_scenario(name))
    return CollisionChecker(scenario.build_robot(), scenario.scene)


@pytest.fixture(scope="module")
def planar2():
    return checker_of("planar2")


@pytest.fixture(scope="module")
def planar3():
    return checker_of("planar3")


# --------------------------------------------------------------------------------------------- isosurfaces


def test_a_ball_has_the_surface_of_a_ball():
    line = np.linspace(-1.0, 1.0, 31)
    x, y, z = np.meshgrid(line, line, line, indexing="ij")
    vertices, faces = isosurface(np.sqrt(x**2 + y**2 + z**2) - 0.7, np.full(3, -1.0), np.full(3, 1.0))
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.7, atol=5e-3)
    assert len(vertices) - len(faces) == 2  # Euler: closed, of genus 0, with 2 F edges


def test_what_reaches_the_border_is_closed_there():
    x = np.broadcast_to(np.linspace(0.0, 2.0, 9)[:, None, None], (9, 7, 5))
    vertices, faces = isosurface(x - 0.5, np.array([0.0, 10.0, -1.0]), np.array([2.0, 20.0, 1.0]))
    assert len(vertices) - len(faces) == 2
    np.testing.assert_allclose(vertices.min(axis=0), [0.0, 10.0, -1.0])
    np.testing.assert_allclose(vertices.max(axis=0), [0.5, 20.0, 1.0])


def test_free_space_has_no_surface():
    vertices, faces = isosurface(np.ones((4, 4, 4)), np.zeros(3), np.ones(3))
    assert (len(vertices), len(faces)) == (0, 0)


# ------------------------------------------------------------------------------------------------ pictures


def test_bubbles_lie_in_free_space(planar2, tmp_path):
    start = np.array([1.2, -0.5])
    figure = plot_bubbles(planar2, [start], tmp_path / "bubbles.png")
    assert (tmp_path / "bubbles.png").stat().st_size > 10_000
    diamonds = [line.get_xydata() for line in figure.axes[1].lines if len(line.get_xydata()) == 5]
    assert len(diamonds) == 3
    for corners in diamonds:
        for corner in corners:
            assert not planar2.in_collision(start + 0.99 * (corner - start))


def test_a_path_is_drawn_from_start_to_goal(planar3, tmp_path):
    path = [[1.25, -0.35, 0.2], [2.0, 0.0, 0.0], [1.0, 1.0, 1.0]]
    figure = plot_cspace_path(planar3, {"SafeRRTConnect": path}, tmp_path / "path.png")
    lines = [np.transpose(line.get_data_3d()) for line in figure.axes[0].lines]
    assert any(np.array_equal(line, path) for line in lines)
    assert (tmp_path / "path.png").is_file()


def test_the_ideas_of_the_paper_are_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(planar, "_FIELD_PIXELS", 21)
    captions = figures.draw_ideas(tmp_path)
    assert {file.name for file in tmp_path.iterdir()} == set(captions)


def test_the_field_is_strongest_at_the_arm(planar2, tmp_path):
    figure = plot_field(planar2.robot, [[0.6, 0.9], [1.4, -2.0]], tmp_path / "field.png")
    assert len(figure.axes) == 3  # two panels and a scale
    levels = figure.axes[0].collections[0].levels
    assert (np.diff(levels) > 0).all()


# ----------------------------------------------------------------------------------------------- bad input


def test_robots_with_other_joints_are_refused(planar2, planar3, tmp_path):
    with pytest.raises(InputError, match="needs a robot of 2 joints, 'planar3' has 3"):
        plot_bubbles(planar3, [[0.0, 0.0, 0.0]], tmp_path / "a.png")
    with pytest.raises(InputError, match="needs a robot of 3 joints, 'planar2' has 2"):
        plot_cspace_path(planar2, {"RRT": [[0.0, 0.0]]}, tmp_path / "a.png")


def test_a_configuration_in_collision_has_no_bubble(planar2, tmp_path):
    with pytest.raises(InputError, match="has no bubble: 'link2' touches 'person'"):
        plot_bubbles(planar2, [[0.0, 0.0]], tmp_path / "a.png")


def test_nothing_to_draw_is_refused(planar2, planar3, tmp_path):
    with pytest.raises(InputError, match="at least one"):
        plot_bubbles(planar2, [], tmp_path / "a.png")
    with pytest.raises(InputError, match="at least one"):
        plot_field(planar2.robot, [], tmp_path / "a.png")
    with pytest.raises(InputError, match="at least one"):
        plot_cspace_path(planar3, {}, tmp_path / "a.png")
    assert not list(tmp_path.iterdir())
