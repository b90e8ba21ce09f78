"""Shapes: danger points lie on the surface and cover it, collision and drawing agree with geometry."""

import math

import coal
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from oracles.coal_distances import coal_distance
from oracles.differences import slopes

from safe_ompl import Box, Capsule, Cylinder, InputError, Mesh, Person, Sphere
from safe_ompl.geometry import LIMBS, placed

LENGTH = st.floats(0.02, 1.0)
PRIMITIVES = st.one_of(
    st.builds(Box, st.tuples(LENGTH, LENGTH, LENGTH)),
    st.builds(Sphere, LENGTH),
    st.builds(Cylinder, LENGTH, LENGTH),
    st.builds(Capsule, LENGTH, LENGTH),
)

CUBE_CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
CUBE_QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def signed_distance(shape, points):
    """Distance to the surface in closed form, negative inside."""
    if isinstance(shape, Sphere):
        return np.linalg.norm(points, axis=1) - shape.radius
    if isinstance(shape, Capsule):
        axis = np.zeros_like(points)
        axis[:, 2] = np.clip(points[:, 2], -shape.length / 2, shape.length / 2)
        return np.linalg.norm(points - axis, axis=1) - shape.radius
    if isinstance(shape, Box):
        beyond = np.abs(points) - np.array(shape.size) / 2
    else:
        assert isinstance(shape, Cylinder)
        radial = np.linalg.norm(points[:, :2], axis=1) - shape.radius
        beyond = np.column_stack([radial, np.abs(points[:, 2]) - shape.length / 2])
    return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)


def surface_samples(shape, count):
    """Feet of the perpendiculars from points all around a convex shape."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    points *= 2.0 / np.linalg.norm(points, axis=1)[:, None]
    slope = slopes(lambda away: signed_distance(shape, points + away), np.zeros(3))
    return points - signed_distance(shape, points)[:, None] * slope.T


def distance_to_nearest(samples, points):
    return np.linalg.norm(samples[:, None] - points[None], axis=2).min(axis=1)


def volume(shape, resolution):
    vertices, faces = shape.triangles(resolution)
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def write_cube(path):
    corners = [f"v {x} {y} {z}" for x, y, z in CUBE_CORNERS]
    faces = ["f " + " ".join(str(k + 1) for k in quad) for quad in CUBE_QUADS]
    path.write_text("\n".join(corners + faces) + "\n")
    return path


# ---------------------------------------------------------------------------------------------- primitives


@settings(max_examples=30)
@given(PRIMITIVES, st.floats(0.05, 0.6))
def test_danger_points_lie_on_the_surface_and_cover_it(shape, spacing):
    points = shape.danger_points(spacing)
    assert np.abs(signed_distance(shape, points)).max() < 1e-9
    assert distance_to_nearest(surface_samples(shape, 200), points).max() <= spacing + 1e-6
    assert len(np.unique(points.round(9), axis=0)) == len(points)


@settings(max_examples=20)
@given(PRIMITIVES)
def test_collision_geometry_has_the_same_surface(shape):
    (part,) = shape.parts()
    probes = np.random.default_rng(1).uniform(-1.5, 1.5, (20, 3))
    for probe, expected in zip(probes, signed_distance(shape, probes), strict=True):
        distance = coal_distance(coal.Sphere(1e-4), probe, part.geometry, part.placement)
        if expected > 0:
            assert distance == pytest.approx(expected - 1e-4, abs=1e-4)
        else:
            assert distance <= 0


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (Box((0.2, 0.3, 0.4)), 0.024),
        (Sphere(0.5), math.pi / 6),
        (Cylinder(0.5, 2.0), math.pi / 2),
        (Capsule(0.5, 2.0), math.pi * 2 / 3),
    ],
)
def test_triangles_face_outwards_and_enclose_the_volume(shape, expected):
    assert volume(shape, 96) == pytest.approx(expected, rel=5e-3)


# -------------------------------------------------------------------------------------------------- meshes


@pytest.mark.parametrize("convex", [True, False])
def test_mesh_is_read_scaled_and_covered(tmp_path, convex):
    mesh = Mesh(write_cube(tmp_path / "cube.obj"), (0.2, 0.3, 0.4), convex)
    assert volume(mesh, 8) == pytest.approx(0.024)
    points = mesh.danger_points(0.1)
    box = Box((0.2, 0.3, 0.4))
    centred = points - np.array(box.size) / 2
    assert np.abs(signed_distance(box, centred)).max() < 1e-6
    assert distance_to_nearest(surface_samples(box, 300), centred).max() <= 0.1
    with pytest.raises(InputError, match="scale: must be a positive number, got 0"):
        Mesh(tmp_path / "cube.obj", (1, 0, 1))


def test_hull_is_solid_and_triangles_are_hollow(tmp_path):
    file = write_cube(tmp_path / "cube.obj")
    inside = coal.Transform3s(np.eye(3), np.full(3, 0.5))
    hits = []
    for convex in (True, False):
        (part,) = Mesh(file, convex=convex).parts()
        request, result = coal.CollisionRequest(), coal.CollisionResult()
        hits.append(bool(coal.collide(part.geometry, coal.Transform3s(), coal.Sphere(0.01), inside, request, result)))
    assert hits == [True, False]


# -------------------------------------------------------------------------------------------------- people


@pytest.mark.parametrize("height", [1.2, 1.75, 2.0])
def test_a_person_is_as_tall_as_asked(height):
    vertices, _ = Person(height).triangles(24)
    assert vertices[:, 2].min() == pytest.approx(0.0, abs=0.01)
    assert vertices[:, 2].max() == pytest.approx(height, rel=0.01)
    assert np.ptp(vertices[:, 1]) == pytest.approx(0.3 * height, rel=0.15)
    assert [part.name for part in Person(height).parts()] == list(LIMBS)


def depth(limb, points):
    """Return how deep inside a limb each of `points`, shape (M, 3), lies; negative outside [m]."""
    axis = limb.end - limb.start
    along = np.clip((points - limb.start) @ axis / max(float(axis @ axis), 1e-300), 0.0, 1.0)
    return limb.radius - np.linalg.norm(points - limb.start - along[:, None] * axis, axis=1)


@pytest.mark.parametrize("spacing", [0.04, 0.1, 0.25])
def test_danger_points_of_a_person_are_those_of_its_limbs_that_are_not_deep_inside_others(spacing):
    person = Person(keypoints={"right_hand": (0.5, -0.2, 1.2), "head": (0.0, 0.0, 1.6)})
    limbs, expected = person.limbs(), []
    for limb in limbs:
        own = placed(limb.placement, limb.shape.danger_points(spacing))
        others = [depth(other, own) for other in limbs if other is not limb]
        expected.append(own[np.max(others, axis=0) <= spacing])
    np.testing.assert_allclose(person.danger_points(spacing), np.concatenate(expected), rtol=0, atol=1e-12)


@settings(max_examples=30)
@given(st.sampled_from(["left", "right"]), st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1))
def test_an_arm_reaches_a_given_wrist_with_its_own_lengths(side, x, y, z):
    def length(person, name):
        return next(limb.length for limb in person.limbs() if limb.name == f"{side}_{name}")

    direction = np.array([x, y, z + 1e-3]) / max(1.0, np.linalg.norm([x, y, z + 1e-3]))
    shoulder = next(limb.start for limb in Person().limbs() if limb.name == f"{side}_upper_arm")
    upper, fore = (length(Person(), name) for name in ("upper_arm", "forearm"))
    reach = abs(upper - fore) + 1e-6 + (2 * min(upper, fore) - 2e-6) * np.linalg.norm(direction)
    wrist = shoulder + reach * direction / np.linalg.norm(direction)
    person = Person(keypoints={f"{side}_wrist": wrist})
    for name in ("upper_arm", "forearm", "hand"):
        assert length(person, name) == pytest.approx(length(Person(), name), rel=1e-6)


def test_the_arm_follows_a_hand_and_a_hand_may_be_alone():
    person = Person(keypoints={"right_hand": (0.6, -0.2, 1.2)})
    limbs = {limb.name: limb for limb in person.limbs()}
    assert limbs["right_hand"].end == pytest.approx((0.6, -0.2, 1.2))
    assert limbs["right_forearm"].start == pytest.approx(limbs["right_upper_arm"].end)
    upper, fore = limbs["right_upper_arm"], limbs["right_forearm"]
    assert upper.end[2] < (upper.start[2] + fore.end[2]) / 2 - 0.01, "the elbow hangs"
    (part,) = Person(keypoints=person.keypoints, only=["right_hand"]).parts()
    assert part.name == ""
