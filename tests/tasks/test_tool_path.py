"""Curves of tool poses: their derivatives, bounds of these, ends and corners."""

import numpy as np
import pinocchio as pin
import pytest

from safe_ompl import InputError, ToolPath


def pose(x, y, z, roll=0.0, pitch=0.0, yaw=0.0):
    return pin.SE3(pin.rpy.rpyToMatrix(roll, pitch, yaw), np.array([x, y, z], dtype=float))


START, VIA, END = pose(0.4, -0.2, 0.3), pose(0.5, 0.0, 0.4, 0.3), pose(0.4, 0.2, 0.3, 0.6, 0.2)
FAR_VIA = np.array([0.9, 0.0, 0.5])
PATHS = {
    "line": ToolPath.line(START, END),
    "turn": ToolPath.line(START, pose(0.4, -0.2, 0.3, 0.5)),
    "arc": ToolPath.arc(START, VIA, END),
    "long arc": ToolPath.arc(START, FAR_VIA, END),
    "corners": ToolPath.polyline([START, VIA, END]),
    "blended": ToolPath.polyline([START, VIA, END], blend=0.04),
    "all blended": ToolPath.polyline([START, VIA, END], blend=1.0),
    "spline": ToolPath.spline([START, VIA, END, pose(0.2, 0.3, 0.5, -0.4)]),
}


@pytest.fixture(params=PATHS)
def path(request):
    return PATHS[request.param]


def intervals(path, number=2000):
    s = np.unique(np.concatenate([np.linspace(0.0, path.length, number), path.knots]))
    return s[:-1], s[1:]


def test_velocities_and_spins_are_derivatives(path):
    first, last = intervals(path)
    middle, step = (first + last) / 2, np.minimum(1e-6, (last - first) / 4)
    before, at, after = path.at(middle - step), path.at(middle), path.at(middle + step)
    span = (2 * step)[:, None]
    np.testing.assert_allclose((after.positions - before.positions) / span, at.velocities, atol=1e-6)
    turns = after.rotations @ np.swapaxes(before.rotations, 1, 2)
    np.testing.assert_allclose([pin.log3(turn) for turn in turns] / span, at.spins, atol=1e-6)
    np.testing.assert_allclose(path.at(last[:-1] - 1e-9).positions, path.at(first[1:]).positions, atol=1e-8)
    for matrix in at.rotations[::100]:
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(3), atol=1e-12)


def test_splines_turn_the_shorter_way():
    """Of the two quaternions of a rotation, the one nearer to that of the pose before is taken."""
    path = ToolPath.spline([pose(0.4, 0.0, 0.3, yaw=yaw) for yaw in (3.3, 4.2, 5.2)])
    turned = np.linalg.norm(path.at(np.linspace(0.0, path.length, 200)).spins, axis=1).mean() * path.length
    assert turned == pytest.approx(1.9, rel=0.02)


def test_bounds_hold(path):
    first, last = intervals(path, 60)
    curvature, angular_acceleration = path.second_derivative_bounds(first, last)
    for share in (0.01, 0.3, 0.7, 0.99):
        at, step = first + share * (last - first), 1e-3 * (last - first)
        before, after = path.at(at - step), path.at(at + step)
        span = (2 * step)[:, None]
        assert (
            np.linalg.norm((after.velocities - before.velocities) / span, axis=1) <= curvature * (1 + 1e-6) + 1e-6
        ).all()
        assert (
            np.linalg.norm((after.spins - before.spins) / span, axis=1) <= angular_acceleration * (1 + 1e-6) + 1e-6
        ).all()


def test_paths_go_through_their_poses():
    for name in ("line", "arc", "long arc", "corners", "blended", "all blended"):
        frames = PATHS[name].at(np.array([0.0, PATHS[name].length]))
        for k, wanted in enumerate((START, END)):
            np.testing.assert_allclose(frames.positions[k], wanted.translation, atol=1e-12)
            np.testing.assert_allclose(frames.rotations[k], wanted.rotation, atol=1e-12)
    for name, via in (("arc", VIA.translation), ("long arc", FAR_VIA)):
        near = PATHS[name].at(np.linspace(0, PATHS[name].length, 20001)).positions - via
        assert np.linalg.norm(near, axis=1).min() < 1e-4
    spline = PATHS["spline"].at(PATHS["spline"].knots)
    np.testing.assert_allclose(spline.positions[1], VIA.translation, atol=1e-12)
    np.testing.assert_allclose(spline.rotations[1], VIA.rotation, atol=1e-12)
    assert len(PATHS["corners"].corners) == 1
    assert all(not len(PATHS[name].corners) for name in PATHS if name != "corners")


def test_poses_of_scipy():
    transform = pytest.importorskip("scipy.spatial.transform")
    rotations = transform.Rotation.from_matrix([START.rotation, VIA.rotation, END.rotation])
    places = np.array([START.translation, VIA.translation, END.translation])
    if not hasattr(transform, "RigidTransform"):
        pytest.skip("older SciPy")
    poses = transform.RigidTransform.from_components(places, rotations)
    places = [path.at(np.array([0.1])).positions for path in (ToolPath.of(poses), ToolPath.spline([START, VIA, END]))]
    np.testing.assert_allclose(*places)


NO_PATHS = [
    (lambda: ToolPath.line(START, START), "segment 0 has no length"),
    (lambda: ToolPath.arc(START, (START.translation + END.translation) / 2, END), "must not be on a line"),
    (lambda: ToolPath.of("a path"), "path"),
    (lambda: ToolPath.of([START]), "path: must be a sequence of 2 poses or more"),
    (lambda: ToolPath.of([START, np.eye(3)]), r"path\[1\]: must have shape \(4, 4\)"),
    (lambda: ToolPath.of([START, 2 * np.eye(4)]), r"path\[1\]: must be a pose"),
    (lambda: ToolPath.polyline([START, END], blend=-1.0), "blend"),
]


@pytest.mark.parametrize(("make", "words"), NO_PATHS)
def test_what_is_no_path_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
