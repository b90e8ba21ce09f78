"""Regions of the tip, held against dense samples of themselves."""

import numpy as np
import pinocchio as pin
import pytest
from oracles.differences import slopes

from safe_ompl import GoalRegion, InputError, Pose
from safe_ompl.robot import METRES_PER_RADIAN, RegionTarget

FRAME = Pose.from_rpy([0.4, -0.1, 0.3], [0.3, -0.5, 1.2])
REGIONS = {
    "box": GoalRegion(FRAME, x=(-0.1, 0.2), y=(-0.3, 0.1), z=(0.0, 0.05)),
    "line": GoalRegion(FRAME, y=(-0.3, 0.3)),
    "ring": GoalRegion(FRAME, radius=(0.2, 0.25)),
    "tube": GoalRegion(FRAME, radius=(0.1, 0.1), z=(-0.1, 0.3)),
    "disc": GoalRegion(FRAME, radius=(0.0, 0.2), z=0.1),
    "any yaw": GoalRegion(FRAME, x=(-0.1, 0.1), roll=0.2, pitch=-0.1),
    "tilted": GoalRegion(FRAME, roll=(-0.3, 0.3), pitch=(-0.2, 0.4)),
    "cone": GoalRegion(FRAME, radius=(0.1, 0.2), roll=(2.8, 3.5), pitch=(-0.3, 0.3), yaw=(-1.0, 2.0)),
    "wide": GoalRegion(FRAME, roll=(-2.0, 2.5), pitch=(-1.4, 1.0), yaw=(0.5, 2.5)),
    "pose": GoalRegion(FRAME, roll=0.1, pitch=0.2, yaw=-0.4),
}
NAMES = [pytest.param(region, id=name) for name, region in REGIONS.items()]


def poses(rng, count):
    for _ in range(count):
        turn = pin.Quaternion(rng.normal(size=4)).normalized().matrix()
        yield pin.SE3(turn, rng.normal(size=3) * 0.4 + FRAME.position)


def holds(region, position, rotation, tolerance):
    def inside(key, value, default):
        low, high = getattr(region, key) or default
        return low - tolerance <= value <= high + tolerance

    here = FRAME.se3.actInv(np.asarray(position))
    if region.radius is not None:
        held = inside("radius", np.hypot(here[0], here[1]), None)
    else:
        held = inside("x", here[0], (0.0, 0.0)) and inside("y", here[1], (0.0, 0.0))
    held = held and inside("z", here[2], (0.0, 0.0))
    angles = np.zeros(3) if rotation is None else pin.rpy.matrixToRpy(FRAME.se3.rotation.T @ rotation)
    for key, value in zip(("roll", "pitch", "yaw"), angles, strict=True):
        held &= any(inside(key, value + turn, (-np.inf, np.inf)) for turn in 2 * np.pi * np.arange(-2, 3))
    return held


def sampled_distance(drawn, pose):
    """Return the least distance of a pose from samples of a region, position and orientation apart."""
    position = min(np.linalg.norm(p - pose.translation) for p, _ in drawn)
    if drawn[0][1] is None:
        return position
    cosines = np.array([np.trace(r.T @ pose.rotation) for _, r in drawn])
    return np.hypot(position, METRES_PER_RADIAN * np.arccos(np.clip((cosines.max() - 1) / 2, -1, 1)))


@pytest.mark.parametrize("region", NAMES)
def test_what_is_drawn_is_inside_and_documents_are_read_back(region, rng):
    assert GoalRegion.from_mapping(region.to_mapping()) == region
    for _ in range(100):
        position, rotation = region.sample(rng)
        assert holds(region, position, rotation, 1e-9)
        turned = np.eye(3) if rotation is None else rotation
        assert region.distance(pin.SE3(turned, position)) < 1e-7


@pytest.mark.parametrize("region", NAMES)
def test_the_nearest_pose_is_inside_and_none_that_is_drawn_is_nearer(region, rng):
    drawn = [region.sample(rng) for _ in range(2500)]
    for pose in poses(rng, 4):
        position, rotation = region.nearest(pose)
        assert holds(region, position, rotation, 1e-7)
        distance, sampled = region.distance(pose), sampled_distance(drawn, pose)
        assert distance <= sampled + 1e-9
        assert sampled <= distance + 0.07, "samples are dense enough to say how far it is"


def test_of_many_orientations_none_is_nearer(rng):
    """Random bounds of all three angles: the search must not end in a corner that is not the best."""
    for _ in range(25):
        ends = np.sort(rng.uniform([[-3], [-1.5], [-3]], [[3], [1.5], [3]], (3, 2)), axis=1)
        region = GoalRegion(roll=ends[0], pitch=ends[1], yaw=ends[2])
        grids = np.stack(np.meshgrid(*[np.linspace(*bounds, 12) for bounds in ends]), -1).reshape(-1, 3)
        drawn = np.array([pin.rpy.rpyToMatrix(angles) for angles in grids])
        for pose in poses(rng, 5):
            cosine = (np.einsum("nij,ij->n", drawn, pose.rotation).max() - 1) / 2
            rotation = region.nearest(pose)[1]
            assert np.linalg.norm(pin.log3(rotation.T @ pose.rotation)) <= np.arccos(np.clip(cosine, -1, 1)) + 1e-6


@pytest.mark.parametrize("region", NAMES)
def test_the_jacobian_is_the_slope_of_the_distance(region, ur5, rng):
    place = RegionTarget(ur5, region)
    for q in rng.uniform(-2.5, 2.5, (5, ur5.n)):
        half_square = slopes(lambda at: place.distance(at) ** 2 / 2, q)
        np.testing.assert_allclose(-place.jacobian(q).T @ place.error(q), half_square, atol=1e-4)


def test_one_number_is_a_bound_without_choice():
    assert GoalRegion(x=0.1, yaw=[1, 2]) == GoalRegion(x=(0.1, 0.1), yaw=(1.0, 2.0))
    assert GoalRegion(pin.SE3.Identity()) == GoalRegion()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"x": (0.2, 0.1)}, r"x: must be \[low, high\] with low <= high, got \[0.2, 0.1\]"),
        ({"x": "wide"}, "x: must be a list"),
        ({"z": (0.0, np.nan)}, "z: must be a finite number"),
        ({"y": (0, 1, 2)}, "y: must be 2 numbers"),
        ({"radius": 0.1, "x": 0.0}, "radius: give either radius, or x and y"),
        ({"radius": (-0.1, 0.1)}, "radius: must be lengths >= 0"),
        ({"yaw": (-4.0, 4.0)}, "yaw: must span at most 2π"),
        ({"pitch": (-2.0, 0.0)}, "pitch: must be in"),
    ],
)
def test_what_is_no_region_is_refused(given, words):
    with pytest.raises(InputError, match=words):
        GoalRegion(**given)
