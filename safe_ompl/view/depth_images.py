"""What depth cameras see of a robot among obstacles, and of solids that come and go, with the errors of a sensor.

Errors are those of a Kinect (Nguyen, Izadi & Lovell, 3DIMPVT 2012): depths z with a quarter of the camera's bound as
standard deviation, rays that are off by σ = 0.5 pixels, flying pixels between near and far at a tenth of the edges, 1 %
of the pixels without a depth; joints are off by up to 2 mrad, poses of cameras by 2 mm and σ = 0.5 mrad.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.geometry import Triangles, surfaces
from safe_ompl.people import DepthCamera
from safe_ompl.people.simulation import Solid
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene
from safe_ompl.view.rasteriser import nearest_triangles
from safe_ompl.view.surfaces import RobotBody, tessellate

_WALLS = 4.0  # [m]
_NEAR = 0.02  # [m] in front of a camera, where it begins to see
_JOINTS, _SHIFT, _TURN = 0.002, 0.002, 0.0005  # [rad], [m] and [rad]
_JITTER, _MIXED, _GONE = 0.5, 0.1, 0.01  # [px], and shares
_SHARE = 0.25  # of the bound of the noise that is its standard deviation
_FIELDS = 4  # of random numbers


class DepthRenderer:
    """Renders what each of some cameras sees.

    Parameters
    ----------
    robot : Robot
        The robot; its collision geometry is seen.
    still : Scene
        What stands still.
    cameras : mapping of str to DepthCamera
        The cameras, as the robot knows them.
    floor : float
        Height of the floor [m]. Walls are 4 m and more from the origin and the cameras.
    seed : int
        Of the errors.
    """

    def __init__(
        self, robot: Robot, still: Scene, cameras: Mapping[str, DepthCamera], floor: float, seed: int = 0
    ) -> None:
        self._robot, self._rng = robot, np.random.default_rng(seed)
        self._body = RobotBody(robot, coarse=True)
        self._eyes = {name: _Eye(camera, self._rng) for name, camera in cameras.items()}
        things = [obstacle.triangles() for obstacle in still]
        far = _WALLS + np.abs([camera.pose.position for camera in cameras.values()]).max()
        room = np.array([[-far, -far, floor], [far, far, far]])
        for eye in self._eyes.values():
            eye.behind = eye.walls(room)
            if things:
                eye.behind = np.minimum(eye.behind, eye.depths(*surfaces.joined(things), clip=True))

    def see(self, q: FloatArray, solids: Iterable[Solid], names: Iterable[str]) -> dict[str, FloatArray]:
        """Return what some cameras see of a robot at `q: (n,)` and of solids, depths (H, W) [m]; NaN: nothing."""
        true = q + self._rng.uniform(-_JOINTS, _JOINTS, len(q))
        body, things = self._body.posed(true), []
        for solid in solids:
            vertices, faces = tessellate(solid.geometry)
            things.append((vertices @ solid.placement.rotation.T + solid.placement.translation, faces))
        points, faces = surfaces.joined([(body.vertices, body.faces), *things])
        return {name: self._eyes[name].spoilt(points, faces) for name in names}


class _Eye:
    """A camera where it truly is, and its errors; `behind` is what it sees where nothing moves (H, W) [m]."""

    behind: FloatArray

    def __init__(self, camera: DepthCamera, rng: np.random.Generator) -> None:
        self._camera, self._rng, self._seed = camera, rng, int(rng.integers(2**31))
        off = pin.SE3(pin.exp3(rng.normal(0.0, _TURN, 3)), rng.uniform(-_SHIFT, _SHIFT, 3))
        self._place = camera.pose.se3 * off

    def walls(self, room: FloatArray) -> FloatArray:
        """Return the depths (H, W) of the walls of a room (2, 3) about the camera [m]."""
        camera, origin = self._camera, self._place.translation
        v, u = np.mgrid[: camera.height, : camera.width]
        (fx, fy), (cx, cy) = camera.focal, camera.middle
        rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones(u.shape)], axis=-1) @ self._place.rotation.T
        rays = np.where(np.abs(rays) < 1e-9, 1e-9, rays)
        return np.asarray(np.maximum((room[0] - origin) / rays, (room[1] - origin) / rays).min(axis=-1))

    def depths(self, vertices: FloatArray, faces: IntArray, *, clip: bool = False) -> FloatArray:
        """Return the depths (H, W) of triangles [m], infinite beside them; of those partly behind only with `clip`."""
        camera = self._camera
        own = (vertices - self._place.translation) @ self._place.rotation
        if clip:
            own, faces = _clipped(own, faces)
        z = np.where(own[:, 2] >= _NEAR, own[:, 2], np.nan)
        (fx, fy), (cx, cy) = camera.focal, camera.middle
        points = np.column_stack([fx * own[:, 0] / z + cx, fy * own[:, 1] / z + cy, 1.0 / z])
        nearness, _ = nearest_triangles(points, faces, camera.width, camera.height)
        return np.where(nearness > 0.0, 1.0 / nearness, np.float32(np.inf))

    @cached_property
    def _fields(self) -> list[tuple[Any, ...]]:
        """Random fields, of which every image takes one, shifted: rays, noise, what is mixed and what is gone."""
        rng, shape = np.random.default_rng(self._seed), (self._camera.height, self._camera.width)
        found: list[tuple[Any, ...]] = []
        for _ in range(_FIELDS):
            jitter = np.rint(rng.normal(0.0, _JITTER, (2, *shape))).astype(np.intp)
            v = np.clip(np.arange(shape[0])[:, None] + jitter[0], 0, shape[0] - 1)
            u = np.clip(np.arange(shape[1]) + jitter[1], 0, shape[1] - 1)
            mixed = np.where(rng.random(shape) < _MIXED, rng.random(shape), 1.0)
            noise = rng.normal(size=shape)
            found.append((v * shape[1] + u, noise, mixed, rng.random(shape) < _GONE))
        return found

    def spoilt(self, vertices: FloatArray, faces: IntArray) -> FloatArray:
        """Return an image (H, W) of triangles before what stands still, with the errors of a sensor [m]."""
        true = np.minimum(self.behind, self.depths(vertices, faces))
        rays, noise, mixed, gone = self._fields[self._rng.integers(_FIELDS)]
        shift = int(self._rng.integers(true.size))
        image = true.ravel()[rays]
        image = true + np.roll(mixed.ravel(), shift).reshape(true.shape) * (image - true)
        bound = self._camera.noise[0] + self._camera.noise[1] * image**2
        image += np.roll(noise.ravel(), shift).reshape(true.shape) * (_SHARE * bound)
        image[gone] = np.nan
        return np.asarray(image, dtype=np.float32)


def _clipped(points: FloatArray, faces: IntArray) -> Triangles:
    """Return triangles without what is behind a camera, whose frame the points (V, 3) are in."""
    ahead = points[faces][..., 2] >= _NEAR
    parts = [(points, faces[ahead.all(axis=1)])]
    for f in np.flatnonzero(ahead.any(axis=1) & ~ahead.all(axis=1)).tolist():
        corners, inside = faces[f], ahead[f]
        found = []
        for k in range(3):
            a, b = points[corners[k]], points[corners[(k + 1) % 3]]
            if inside[k]:
                found.append(a)
            if inside[k] != inside[(k + 1) % 3]:
                found.append(a + (1.001 * _NEAR - a[2]) / (b[2] - a[2]) * (b - a))
        parts.append((np.array(found), np.array([[0, k, k + 1] for k in range(1, len(found) - 1)])))
    return surfaces.joined(parts)
