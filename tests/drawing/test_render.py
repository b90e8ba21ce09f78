"""Pictures of robots: what they show, where they are taken from, and what they refuse."""

import re
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("matplotlib")

import coal
from matplotlib.image import imread

from safe_ompl import (
    Box,
    CollisionChecker,
    InputError,
    Obstacle,
    PathReport,
    Person,
    PlanResult,
    Pose,
    Robot,
    Scenario,
    Scene,
    Sphere,
)
from safe_ompl.drawing import pictures, render_comparison, render_path
from safe_ompl.drawing.drawn_scene import Camera, DrawnScene, best_view, in_picture
from safe_ompl.drawing.light import Light
from safe_ompl.drawing.renderer import Renderer, tone_mapped
from safe_ompl.drawing.rendering import nearest_triangles
from safe_ompl.drawing.surfaces import RobotBody, Surface, tessellate
from safe_ompl.geometry import surfaces

SMALL = (96, 72)
PATH = np.array([[-1.2, 0.3], [-0.4, 1.0], [0.9, 0.5]])


def planned(path, before=None):
    """Return the result of a planner that found a path."""
    return PlanResult("Exact solution", path, None, "SafeRRTConnect", 0, ("a", "b"), 0.1, planned_path=before)


def choose_camera(robot, scene, paths):
    """Return the camera that shows paths best."""
    return best_view(DrawnScene(robot, scene, list(paths.values())), (900, 700))


@pytest.fixture(scope="module")
def planar():
    return Scenario.load("planar2").build_robot()


@pytest.fixture(scope="module")
def scene():
    box = Obstacle("box", Box((0.1, 0.1, 0.1)), Pose((0.6, 0.6, 0.0)))
    return Scene((box, Obstacle("ball", Sphere(0.08), Pose((-0.4, 0.4, 0.0)), weight=1.0)))


# ---------------------------------------------------------------------------------------------- triangles


def _volume(vertices, faces):
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def _mesh():
    vertices, faces = surfaces.box_triangles(np.array([1.0, 2.0, 3.0]))
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(faces), len(vertices))
    mesh.addVertices(vertices)
    mesh.addTriangles(faces.astype(np.int64))
    mesh.endModel()
    mesh.buildConvexHull(True, "Qt")
    return mesh


VOLUMES = [
    (coal.Box(1.0, 2.0, 3.0), 6.0),
    (coal.Sphere(0.5), np.pi / 6),
    (coal.Cylinder(0.5, 2.0), np.pi / 2),
    (coal.Capsule(0.5, 2.0), np.pi / 2 + np.pi / 6),
    (coal.Cone(0.5, 3.0), np.pi / 4),
    (_mesh(), 6.0),
    (_mesh().convex, 6.0),
]


@pytest.mark.parametrize(("shape", "volume"), VOLUMES)
def test_tessellated_shapes_are_closed_and_face_outwards(shape, volume):
    assert _volume(*tessellate(shape)) == pytest.approx(volume, rel=0.03)


def test_unknown_geometry_is_named():
    with pytest.raises(InputError, match=r"Halfspace.*known: mesh"):
        tessellate(coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0))


# ------------------------------------------------------------------------------------------------- camera


def test_the_camera_holds_all_points_tightly():
    points = np.random.default_rng(0).normal(size=(50, 3))
    camera = Camera.framing(points, 0.7, 0.4, (150, 100))
    places = in_picture(camera, points, (150, 100))[:, :2] - (74.5, 49.5)
    assert np.abs(places / (75.0, 50.0)).max() == pytest.approx(0.9)


# ------------------------------------------------------------------------------------------------ renderer


def _ball(radius, at):
    return Surface.from_triangles(*tessellate(coal.Sphere(radius))).moved(np.eye(3), np.array(at))


@pytest.mark.parametrize("turned", [False, True])
def test_a_z_buffer_does_not_care_which_way_triangles_turn(turned):
    points = np.random.default_rng(0).uniform(-5, 45, (60, 3))
    faces = np.arange(60).reshape(20, 3)
    nearness, owner = nearest_triangles(points, np.ascontiguousarray(faces[:, ::-1] if turned else faces), 40, 30)
    y, x = np.mgrid[:30, :40]
    best = np.full((30, 40), -np.inf)
    nearest = np.full((30, 40), -1)
    for k, (a, b, c) in enumerate(points[faces]):
        shares = np.linalg.solve([*np.column_stack([a, b, c])[:2], np.ones(3)], [x.ravel(), y.ravel(), np.ones(1200)])
        z = (shares * np.array([a[2], b[2], c[2]])[:, None]).sum(axis=0)
        z[(shares < 0).any(axis=0)] = -np.inf
        z = z.reshape(30, 40)
        best, nearest = np.maximum(best, z), np.where(z > best, k, nearest)
    np.testing.assert_allclose(nearness, best, rtol=1e-4)
    assert (owner == nearest).mean() > 0.999
    assert (owner[np.isinf(best)] == -1).all()


def test_what_is_behind_the_camera_is_not_drawn():
    camera = Camera.framing(np.eye(3), 0.3, 0.5, SMALL)
    behind = _ball(0.3, tuple(camera.eye + (camera.eye - camera.target)))
    assert (nearest_triangles(in_picture(camera, behind.vertices, SMALL), behind.faces, *SMALL)[1] == -1).all()


# -------------------------------------------------------------------------------------------- robot and scene


def test_a_robot_is_drawn_by_its_visual_shapes_or_as_it_collides(tmp_path):
    file, text = tmp_path / "arm.urdf", Scenario.load("planar2").robot.urdf.read_text()
    visuals, half = re.compile("<visual>.*</visual>"), text.index('<link name="link2">')
    for written in (visuals.sub("", text), text[:half] + visuals.sub("", text[half:])):
        file.write_text(written)
        body = RobotBody(Robot.from_urdf(file, tip="tip"))
        extent = np.ptp(body.posed(np.zeros(2)).vertices, axis=0)
        assert len(body.links) >= 2
        assert extent[0] > 0.69
        assert extent[1] < 0.2


SLAB = Obstacle("slab", Box((4.0, 4.0, 0.02)), Pose((0.0, 0.0, -0.5)))
WORKER = Obstacle("worker", Person(height=1.7), Pose((1.5, 0.0, -0.49)), weight=1.0)
BALLS = [Obstacle(f"ball {k}", Sphere(0.1), Pose((0.6, 0.2 * k, 0.4)), weight=1.0) for k in (0, 1)]
# Obstacles, which of them are dangerous beside others, and the height of the floor.
DANGEROUS = [
    ((SLAB, WORKER), ["worker"], -0.49),
    ((WORKER, *BALLS), ["worker", "ball 0", "ball 1"], -0.49),
    ((SLAB, *BALLS), ["ball 0", "ball 1"], -0.49),
    (BALLS, [], -0.15),
]


@pytest.mark.parametrize(("obstacles", "hazards", "floor"), DANGEROUS)
def test_a_large_slab_is_the_floor_and_dangerous_things_are_marked_beside_others(planar, obstacles, hazards, floor):
    drawn = DrawnScene(planar, Scene(obstacles), [PATH])
    assert drawn.hazards == hazards
    assert [*drawn.groups] == [obstacle.name for obstacle in obstacles if obstacle != SLAB]
    assert drawn.floor == pytest.approx(floor, abs=1e-4)


def test_the_shares_of_all_lights_are_the_light_of_the_open_floor_and_of_the_key_light():
    lights = Light.around(np.eye(3), 0.0, np.array([0.6, 0.0, 0.8])).lights
    assert lights[:, 2:].sum(axis=0) == pytest.approx([1.0, 1.0])


# --------------------------------------------------------------------------------------------------- pictures


def test_one_posture_of_a_result_is_where_it_is_closest(planar, scene, monkeypatch):
    monkeypatch.setattr(pictures, "_postures", lambda drawn, renderer, samples, shares, *more: shares)
    report = PathReport.of(PATH, CollisionChecker(planar, scene), None)
    shares = pictures.render_path(planar, scene, replace(planned(PATH), report=report), size=SMALL)
    assert len(shares) == pictures.GHOSTS
    assert report.clearance.at in shares
    assert report.clearance.at not in np.linspace(0.0, 1.0, len(shares) + 2), "the test shows nothing"


def test_the_robot_shows_in_the_picture(planar, scene):
    camera = choose_camera(planar, scene, {"a": PATH})
    drawn = render_path(planar, scene, PATH, size=SMALL, camera=camera, ghosts=1)
    drawn_scene = DrawnScene(planar, scene, [PATH])
    empty = tone_mapped(Renderer(drawn_scene.floor, camera, SMALL).render(drawn_scene.surroundings()))
    assert drawn.shape == (72, 96, 3)
    assert drawn.dtype == np.uint8
    changed = np.abs(drawn - 255.0 * empty).max(axis=2) > 40
    assert 0.03 < changed.mean() < 0.5
    blue = (drawn[..., 2].astype(int) - drawn[..., 0]) > 80
    assert blue.any()  # goal and trace have the accent colour


def test_a_comparison_is_saved_with_a_panel_per_planner(planar, scene, tmp_path):
    file = tmp_path / "new" / "paths.png"
    render_comparison(planar, scene, {"SafePRM": PATH, "SafeRRTConnect": planned(PATH[::2], PATH)}, file, panel=SMALL)
    image = imread(file)
    head, foot = 48, 28
    assert image.shape[:2] == (72 + head + foot, 2 * 96 + 3 * 14)
    left, right = image[head : head + 72, 14:110], image[head : head + 72, 124:220]
    assert ((left[..., 1] - left[..., 0]) > 0.3).any()
    assert ((right[..., 2] - right[..., 0]) > 0.3).any()


def test_of_many_paths_two_are_large(planar, scene, tmp_path):
    names = ("OMPL RRTConnect + OMPL's simplifier", "SafeRRTConnect", "SafePRM", "ClassicPRM", "RRT")
    render_comparison(planar, scene, dict.fromkeys(names, PATH), tmp_path / "paths.png", panel=SMALL, words="a b")
    image = imread(tmp_path / "paths.png")
    words, head, foot = 24, 48, 28
    assert image.shape[:2] == (words + 2 * head + 72 + 30 + foot, 2 * 96 + 3 * 14)  # the others are 41 by 30
    baseline = image[words + head : words + head + 72, 14:110]
    assert ((baseline[..., 0] - baseline[..., 1:3].max(axis=2)) > 0.3).any(), "the baseline is red"
    third = image[words + 2 * head + 72 :, 14:55][:30]
    assert ((third[..., 1] - third[..., 0]) > 0.2).any(), "SafePRM is green"


# ------------------------------------------------------------------------------------------------- bad input


UNDRAWABLE = [
    (np.empty((0, 2)), SMALL, "at least one configuration"),
    (np.zeros((3, 5)), SMALL, r"shape \(any, 2\), got \(3, 5\)"),
    (np.array([[0.0, np.nan]]), SMALL, "finite"),
    (PATH, (0, 72), "at least 1 pixel"),
]


@pytest.mark.parametrize(("path", "size", "message"), UNDRAWABLE)
def test_a_path_that_cannot_be_drawn_says_why(planar, path, size, message):
    with pytest.raises(InputError, match=message):
        render_path(planar, Scene(), path, size=size)
