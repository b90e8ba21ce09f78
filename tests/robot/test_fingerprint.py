"""Fingerprints of robots: another body is another robot, the same body in another order is not."""

import shutil

import pytest

from safe_ompl import Robot
from safe_ompl.robot import robot_hash


@pytest.fixture
def hash_with(data_folder, tmp_path):
    """Return a function from the lines of a mesh to the hash of a robot with such hands."""
    shutil.copy(data_folder / "twin_arm.urdf", tmp_path)

    def fingerprint(lines, *, hulls=False):
        (tmp_path / "wedge.obj").write_text("\n".join(lines))
        return robot_hash(Robot.from_urdf(tmp_path / "twin_arm.urdf", hulls=hulls))

    return fingerprint


@pytest.fixture
def wedge(data_folder):
    return (data_folder / "wedge.obj").read_text().splitlines()


def test_the_triangles_of_a_mesh_count(hash_with, wedge):
    usual = hash_with(wedge)
    assert hash_with(wedge[:-1]) != usual, "a face is missing, no vertex"
    *rest, last = wedge
    word, first, *others = last.split()
    assert hash_with([*rest, " ".join([word, *others, first])]) == usual, "the same triangle"
    assert hash_with([*rest, " ".join([word, first, *others[::-1]])]) != usual, "its other side"


def test_the_order_of_a_mesh_does_not_count(hash_with, wedge):
    faces = [line for line in wedge if line.startswith("f ")]
    assert hash_with([*(line for line in wedge if line not in faces), *faces[::-1]]) == hash_with(wedge)


def test_of_convex_hulls_the_vertices_count(hash_with, wedge):
    usual = hash_with(wedge, hulls=True)
    assert hash_with(wedge[:-1], hulls=True) == usual
    assert hash_with([line.replace("1.2", "1.21") for line in wedge], hulls=True) != usual
