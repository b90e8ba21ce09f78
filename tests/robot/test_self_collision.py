"""Self pairs that are always in contact: sampled as long as undecided, and remembered on disk."""

import json

import pinocchio as pin
import pytest

from safe_ompl import Robot
from safe_ompl.common import cache
from safe_ompl.robot.loading import collision as self_collision
from safe_ompl.robot.loading.collision import always_in_contact, remembered_contacts, sample_configurations


def every_pair(robot):
    geometry = robot.collision_model.copy()
    geometry.addAllCollisionPairs()
    return geometry


def count_all(model, geometry, samples):
    """Pairs in contact in over 95 % of the samples, all of them asked at all samples."""
    data, contacts, hits = model.createData(), pin.GeometryData(geometry), [0] * len(geometry.collisionPairs)
    for q in samples:
        pin.computeCollisions(model, data, geometry, contacts, q, False)
        hits = [n + result.isCollision() for n, result in zip(hits, contacts.collisionResults, strict=True)]
    pairs = [(pair.first, pair.second) for pair in geometry.collisionPairs]
    return [pair for pair, n in zip(pairs, hits, strict=True) if n > 0.95 * len(samples)]


@pytest.mark.parametrize("name", ["ur10", "so101", "twin_arm"])
def test_deciding_early_changes_no_decision(robot_named, name):
    robot = robot_named(name)
    geometry, samples = every_pair(robot), sample_configurations(robot.model)
    expected = count_all(robot.model, geometry, samples)
    assert expected, "the case is worth nothing without one"
    found = always_in_contact(robot.model, geometry, samples)
    assert [(pair.first, pair.second) for pair in found] == expected


@pytest.fixture
def cache_folder(tmp_path, monkeypatch):
    folder = tmp_path / "kept"
    monkeypatch.setenv(cache.VARIABLE, str(folder))
    return folder


def pairs_of(robot):
    return [(pair.first, pair.second) for pair in robot.collision_model.collisionPairs]


def test_the_second_time_nothing_is_sampled(cache_folder, data_folder, monkeypatch):
    first = Robot.from_urdf(data_folder / "twin_arm.urdf")
    assert len(list(cache_folder.iterdir())) == 1

    def refuse(*_):
        raise AssertionError("sampled again")

    monkeypatch.setattr(self_collision, "always_in_contact", refuse)
    assert pairs_of(Robot.from_urdf(data_folder / "twin_arm.urdf")) == pairs_of(first)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('radius="0.05"', 'radius="0.051"'),  # a shape
        ('xyz="0.4 0 0"', 'xyz="0.41 0 0"'),  # the place of a joint
        ('upper="2.6"', 'upper="2.5"'),  # a limit
        ('xyz="0 0.6 0.8"', 'xyz="0 0.8 0.6"'),  # an axis
        ('scale="0.1 0.1 0.1"', 'scale="0.1 0.1 0.11"'),  # a mesh
    ],
)
def test_what_changes_the_robot_is_sampled_anew(cache_folder, data_folder, tmp_path, old, new):
    Robot.from_urdf(data_folder / "twin_arm.urdf")
    text = (data_folder / "twin_arm.urdf").read_text()
    assert old in text
    (tmp_path / "wedge.obj").write_bytes((data_folder / "wedge.obj").read_bytes())
    (tmp_path / "same.urdf").write_text(text)
    Robot.from_urdf(tmp_path / "same.urdf")
    assert len(list(cache_folder.iterdir())) == 1, "the same robot elsewhere is the same robot"
    (tmp_path / "other.urdf").write_text(text.replace(old, new))
    Robot.from_urdf(tmp_path / "other.urdf")
    assert len(list(cache_folder.iterdir())) == 2


@pytest.mark.parametrize("value", ["", "{", '{"value": [0, 1]}', '{"key": "KEY", "value": [-1]}', '{"key": "KEY"}'])
def test_what_cannot_be_believed_is_sampled_anew(cache_folder, robot_named, value):
    robot = robot_named("twin_arm")
    geometry, samples = every_pair(robot), sample_configurations(robot.model)
    expected = remembered_contacts(robot.model, geometry, samples)
    (file,) = cache_folder.iterdir()
    right = file.read_text()
    file.write_text(value.replace("KEY", json.loads(right)["key"]))
    again = remembered_contacts(robot.model, geometry, samples)
    assert [(p.first, p.second) for p in again] == [(p.first, p.second) for p in expected]
    assert file.read_text() == right
