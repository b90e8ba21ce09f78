"""Convex pieces of concave meshes: what is returned contains the mesh, and what does not is refused."""

import coal
import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import InputError, Mesh
from safe_ompl.apps.exchange import proven_pieces
from safe_ompl.geometry import hull_planes, surfaces

MARGIN = 0.002
BOXES = {"floor": ((0.4, 0.2, 0.05), (0, 0, 0.025)), "left": ((0.05, 0.2, 0.2), (-0.175, 0, 0.15))}
BOXES["right"] = (BOXES["left"][0], (0.175, 0, 0.15))


def corners(name):
    size, centre = BOXES[name]
    return surfaces.box_triangles(np.array(size))[0] + centre


@pytest.fixture
def channel(tmp_path):
    """Return the file of a channel: the outline of a U, extruded along y."""
    outline = [(-0.2, 0), (0.2, 0), (0.2, 0.25), (0.15, 0.25), (0.15, 0.05), (-0.15, 0.05), (-0.15, 0.25), (-0.2, 0.25)]
    points = [(x, y, z) for y in (-0.1, 0.1) for x, z in outline]
    flat = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (0, 4, 5), (0, 5, 7), (5, 6, 7)]
    faces = [*flat, *(tuple(8 + k for k in face[::-1]) for face in flat)]
    for k in range(8):
        after = (k + 1) % 8
        faces += [(k, 8 + after, after), (k, 8 + k, 8 + after)]
    lines = ["v {} {} {}".format(*(1000 * x for x in point)) for point in points]
    lines += ["f {} {} {}".format(*(k + 1 for k in face)) for face in faces]
    file = tmp_path / "channel.obj"
    file.write_text("\n".join(lines) + "\n")
    return file


def with_coacd(channel):
    coacd = pytest.importorskip("coacd")
    coacd.set_log_level("error")
    found = coacd.run_coacd(coacd.Mesh(*Mesh(channel, [1, 1, 1], convex=False).surface), max_ch_vertex=64)
    return [vertices for vertices, _ in found]


@pytest.mark.parametrize("pieces", [lambda _: [1000 * corners(name) for name in BOXES], with_coacd])
def test_pieces_contain_the_mesh_and_leave_what_is_hollow(channel, pieces, tmp_path):
    scale = 3 * [0.001]
    meshes = proven_pieces(channel, pieces(channel), tmp_path / "pieces", scale=scale, margin=MARGIN)
    points = surfaces.mesh_points(*Mesh(channel, scale, convex=False).surface, 0.01)
    planes = [hull_planes(mesh.parts()[0].geometry) for mesh in meshes]
    assert all(any((normals @ p <= offsets).all() for normals, offsets in planes) for p in points)
    ball, place = coal.Sphere(0.1), pin.SE3(np.eye(3), np.array([0, 0, 0.2]))
    question, here = coal.DistanceRequest(), pin.SE3.Identity()

    def distance(geometry):
        return coal.distance(ball, place, geometry, here, question, coal.DistanceResult())

    near = min(distance(mesh.parts()[0].geometry) for mesh in meshes)
    assert 0.05 - 2 * MARGIN * np.sqrt(3) < near < 0.05  # of which a wall is away; the floor is as far
    assert distance(Mesh(channel, scale).parts()[0].geometry) < 0


@pytest.mark.parametrize("left_out", BOXES)
def test_what_is_missing_is_named(channel, left_out, tmp_path):
    pieces = [1000 * corners(name) for name in BOXES if name != left_out]
    with pytest.raises(InputError, match=r"channel\.obj: not in the pieces at \(.* m: take a larger margin") as raised:
        proven_pieces(channel, pieces, tmp_path, scale=3 * [0.001], margin=MARGIN)
    at = np.array([float(x) for x in str(raised.value).split("(")[1].split(")")[0].split(",")])
    size, centre = BOXES[left_out]
    assert (np.abs(at - centre) <= np.array(size) / 2 + MARGIN).all()


def test_a_piece_that_is_too_small_is_refused(channel, tmp_path):
    pieces = [999 * corners(name) for name in BOXES]  # 0.2 mm less at the ends
    proven_pieces(channel, pieces, tmp_path, scale=3 * [0.001], margin=MARGIN)
    with pytest.raises(InputError, match="not in the pieces"):
        proven_pieces(channel, pieces, tmp_path, scale=3 * [0.001], margin=1e-4)
