"""A Panda beside recorded people and unknown boxes that two depth cameras see: against skeletons and stop-and-go.

FOLDER has recordings as for `live`. MuJoCo renders the cell (robot, obstacles, the person's capsules, boxes) for two
cameras of 640 × 480 pixels at 30 Hz, with errors: axial noise of a Kinect, σ = 1.2 mm + 1.9 mm (z/m − 0.4)², rays that
are off by σ = 0.5 pixels, flying pixels between near and far at a tenth of the edges, 1 % of the pixels without a depth
(Nguyen, Izadi & Lovell, 3DIMPVT 2012), joints off by up to 2 mrad, poses of cameras by 2 mm and 0.5 mrad. Nothing of
the person or of the boxes is known to the robot but these images.
"""

from __future__ import annotations

import argparse
import logging
import os
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from time import process_time
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")
import coal
import mujoco
import numpy as np
import pinocchio as pin

from bench._harness import Report
from bench._scenes import ACCELERATIONS
from bench.live import HANDS, StopAndGo, places, situations, to_and_fro
from safe_ompl import Box, Obstacle, People, Pose, RateLimits, Replanner, Robot, Scenario, Scene, Surroundings, Tracker
from safe_ompl.common import FloatArray
from safe_ompl.geometry import bounding_hull
from safe_ompl.people import DepthCamera, DepthFrame, OccupancyGrid, OccupancyOptions, Recording, TrackedBody
from safe_ompl.people.replanning import Command, ReplanningOptions
from safe_ompl.people.simulation.movers import Drifting, Playback, Solid, World
from safe_ompl.people.simulation.simulation import Faults, Simulation
from safe_ompl.scene import find_scenario

CLAIM = "nobody whom depth cameras see is touched while the robot moves, without anybody being recognised"
TICK = 1 / 30  # [s]
SPEED = 2.0  # [m/s] of all that cameras see
_LATENCY = 0.4  # of a tick
_JOINTS, _SHIFT, _TURN = 0.002, 0.002, 0.0005  # [rad], [m] and [rad], errors of joints and of poses
_PLACES = 20
_BOXES = 3
_SIZE = (640, 480)
_FOCAL = 337.0  # [px]
_FIELDS = 8  # of random numbers
# Where cameras are, and where they look [m].
_LOOKS = {"front": ((0.7, -1.3, 2.0), (0.1, 0.3, 0.25)), "back": ((-1.0, 0.5, 2.0), (0.35, -0.1, 0.2))}


# -------------------------------------------------------------------------------------------------- cameras


def looking(place: tuple[float, ...], at: tuple[float, ...]) -> Pose:
    """Return the pose of an optical frame at a place that looks at a point."""
    ahead = np.array(at) - place
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    return Pose.of(pin.SE3(np.column_stack([right, np.cross(ahead, right), ahead]), np.array(place)))


def cameras() -> dict[str, DepthCamera]:
    """Return the two cameras, as the robot knows them."""
    width, height = _SIZE
    middle = ((width - 1) / 2, (height - 1) / 2)
    return {name: DepthCamera(width, height, (_FOCAL, _FOCAL), middle, looking(*look)) for name, look in _LOOKS.items()}


class Renderer:
    """Depth images of a robot among boxes, and of solids that come and go."""

    def __init__(self, robot: Robot, still: Scene, solids: list[Solid], rng: np.random.Generator) -> None:
        self._robot, self._rng = robot, rng
        spec = mujoco.MjSpec()
        spec.visual.global_.offwidth, spec.visual.global_.offheight = _SIZE
        spec.visual.map.znear, spec.visual.map.zfar = 0.02, 20.0
        spec.stat.extent = 1.0
        world = spec.worldbody
        world.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[4, 4, 0.02], pos=[0, 0, -0.78])
        for x, y in ((4, 0), (-4, 0), (0, 4), (0, -4)):  # a room
            world.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1 + abs(y), 0.1 + abs(x), 3], pos=[x, y, 1])
        for obstacle in still:
            for name, geometry, pose in obstacle.geometries():
                assert isinstance(geometry, coal.Box), name
                half, turn = np.ravel(geometry.halfSide), pin.Quaternion(pose.rotation).coeffs()
                place = {"pos": pose.translation, "quat": np.roll(turn, 1)}
                world.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half, **place)
        self._bodies = list(robot.shared.collision_model.geometryObjects)
        for k, body in enumerate(self._bodies):
            points = bounding_hull(body.geometry).points
            spec.add_mesh(name=f"mesh{k}", uservert=points.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
            holder = world.add_body(name=f"link{k}", mocap=True)
            holder.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"mesh{k}")
        for k, solid in enumerate(solids):
            kind = mujoco.mjtGeom.mjGEOM_BOX if isinstance(solid.geometry, coal.Box) else mujoco.mjtGeom.mjGEOM_CAPSULE
            holder = world.add_body(name=f"solid{k}", mocap=True)
            holder.add_geom(name=f"solid{k}", type=kind, size=[0.1, 0.1, 0.1])
        fovy = float(np.degrees(2 * np.arctan(_SIZE[1] / 2 / _FOCAL)))
        for name, camera in cameras().items():
            place = camera.pose.se3
            place = place * pin.SE3(pin.exp3(rng.normal(0, _TURN, 3)), rng.uniform(-_SHIFT, _SHIFT, 3))
            turn = pin.Quaternion(place.rotation @ np.diag([1.0, -1.0, -1.0])).coeffs()
            world.add_camera(name=name, pos=place.translation, quat=np.roll(turn, 1), fovy=fovy)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._pin = robot.shared.model.createData()
        self._renderer = mujoco.Renderer(self._model, _SIZE[1], _SIZE[0])
        self._renderer.enable_depth_rendering()
        # MuJoCo moves the vertices of a mesh into a frame of its inertia.
        self._shifts = []
        for k in range(len(self._bodies)):
            mesh = self._model.mesh(f"mesh{k}").id
            turn = self._model.mesh_quat[mesh]
            self._shifts.append(pin.SE3(pin.Quaternion(*turn).matrix(), self._model.mesh_pos[mesh].copy()))

    def see(self, q: FloatArray, solids: list[Solid]) -> dict[str, FloatArray]:
        """Return what both cameras see, with errors (H, W) [m]."""
        robot, model, data = self._robot, self._model, self._data
        true = q + self._rng.uniform(-_JOINTS, _JOINTS, len(q))
        pin.forwardKinematics(robot.shared.model, self._pin, robot.pinocchio_configuration(true))
        for k, body in enumerate(self._bodies):
            self._put(f"link{k}", self._pin.oMi[body.parentJoint] * body.placement)
        for k, solid in enumerate(solids):
            shape = solid.geometry
            size = model.geom(f"solid{k}").size
            if isinstance(shape, coal.Box):
                size[:] = np.ravel(shape.halfSide)
            else:
                size[:2] = shape.radius, getattr(shape, "halfLength", 1e-6)
            model.geom(f"solid{k}").rbound = float(np.sum(size))
            self._put(f"solid{k}", solid.placement)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        images = {}
        for name in _LOOKS:
            self._renderer.update_scene(data, name)
            images[name] = self._spoilt(self._renderer.render())
        return images

    def _put(self, name: str, place: pin.SE3) -> None:
        k = self._model.body(name).mocapid[0]
        self._data.mocap_pos[k] = place.translation
        self._data.mocap_quat[k] = np.roll(pin.Quaternion(place.rotation).coeffs(), 1)

    @cached_property
    def _fields(self) -> list[tuple[Any, ...]]:
        """Random fields, of which every image takes one, shifted: rays, noise, what is mixed and what is gone."""
        rng, (columns, rows) = self._rng, _SIZE
        found: list[tuple[Any, ...]] = []
        for _ in range(_FIELDS):
            jitter = np.rint(rng.normal(0.0, 0.5, (2, rows, columns))).astype(np.intp)
            v = np.clip(np.arange(rows)[:, None] + jitter[0], 0, rows - 1)
            u = np.clip(np.arange(columns) + jitter[1], 0, columns - 1)
            mixed = np.where(rng.random((rows, columns)) < 0.1, rng.random((rows, columns)), 1.0)
            noise = rng.normal(size=(rows, columns))
            found.append((v * columns + u, noise, mixed, rng.random((rows, columns)) < 0.01))
        return found

    def _spoilt(self, true: FloatArray) -> FloatArray:
        """Return an image with the errors of a sensor."""
        rays, noise, mixed, gone = self._fields[self._rng.integers(_FIELDS)]
        shift = int(self._rng.integers(true.size))
        image = true.ravel()[rays]
        image = true + np.roll(mixed.ravel(), shift).reshape(true.shape) * (image - true)
        image += np.roll(noise.ravel(), shift).reshape(true.shape) * (0.0012 + 0.0019 * (image - 0.4) ** 2)
        image[gone | (true > 10.0)] = np.nan
        return image.astype(np.float32)


class Seen(Simulation):
    """A simulation in which the replanner sees through cameras."""

    def __init__(self, pilot: Replanner, ways: list[Any], world: World, shadow: Surroundings, seed: int) -> None:
        super().__init__(pilot, ways, world.people, faults=Faults(latency=_LATENCY * TICK))
        self.world, self._shadow = world, shadow
        solids = world.solids(world.keypoints(0.0), 0.0)
        self._renderer = Renderer(pilot.robot, pilot.surroundings.still, solids, np.random.default_rng(seed))
        self.ingest: list[float] = []
        self.surprises = 0

    def _measure(self, now: float) -> float:
        truth = {name: mover.at(now) for name, mover in self.world.people.items()}
        self._shadow.update(truth, {name: thing.at(now) for name, thing in self.world.objects.items()}, now)
        self._promised[now] = self._shadow.sets
        while len(self._promised) > 200:
            del self._promised[next(iter(self._promised))]
        last: Command | None = self.replanner._last
        q = self.trajectories[0].at(0.0).q if last is None else last.at(now).q
        images = self._renderer.see(q, self.world.solids(self.world.keypoints(now), now))
        begin = process_time()
        frames = {name: DepthFrame(image, now, q) for name, image in images.items()}
        found = self.replanner.update({}, {}, now, frames)
        took = process_time() - begin
        self.ingest.append(took)
        self.surprises += bool(found)
        return took


# -------------------------------------------------------------------------------------------------- drives

POLICIES: dict[str, Any] = {"depth": Replanner, "skeletons": Replanner, "stop-and-go": StopAndGo}


def boxes(seed: int) -> dict[str, Drifting]:
    """Return boxes that fly through the cell at up to the speed."""
    rng, found = np.random.default_rng(seed), {}
    room = np.array([[-0.7, -1.2, -0.5], [1.5, 0.55, 1.3]])
    for k in range(_BOXES):
        way = rng.normal(size=3)
        velocity = way / np.linalg.norm(way) * rng.uniform(0.2, SPEED)
        turn = pin.exp3(rng.uniform(-1, 1, 3))
        found[f"box{k}"] = Drifting(pin.SE3(turn, rng.uniform([0.9, -1.2, 0.0], [1.5, 0.5, 1.2])), velocity, room)
    return found


def drive(job: tuple[Path, str, int] | int, policy: str, seconds: float, unseen: str) -> dict[str, Any]:
    """Drive once beside a recorded person, or beside boxes of a seed, and return what happened."""
    scenario = Scenario.load(find_scenario("panda_shelf"))
    robot = scenario.build_robot()
    still = scenario.scene.without("operator")
    shapes = [Obstacle(f"box{k}", Box((0.12, 0.2, 0.16))) for k in range(_BOXES)]
    options = OccupancyOptions(speed=SPEED, unseen=unseen, clear=2.0)  # somebody looked before it began
    if isinstance(job, int):
        people, things, scene, seed = {}, boxes(job), still.with_obstacles(*shapes), job
    else:
        file, clip, place = job
        recording = Recording.load(file, clip)
        seed = sum(map(ord, file.stem + clip))
        tracker = Tracker(recording.skeleton, TrackedBody(), places(recording, _PLACES, seed)[place])
        people, things, scene = {"operator": Playback(recording, tracker)}, {}, still
    trackers, speeds = {name: one.tracker for name, one in people.items()}, dict.fromkeys(things, SPEED)
    sighted = policy == "skeletons"
    rules = People(speed=1.6, speeds=HANDS) if sighted else People(speed=SPEED)
    shadow = Surroundings(scene, trackers, speeds, rules)
    around = (
        shadow if sighted else Surroundings(still, people=rules, depth=OccupancyGrid(robot, still, cameras(), options))
    )
    replanning = ReplanningOptions(TICK, detours=policy != "stop-and-go", retreats=policy != "stop-and-go")
    pilot = POLICIES[policy](robot, around, options=replanning)
    limits = RateLimits.of(robot, acceleration=ACCELERATIONS["panda"])
    ways = to_and_fro(scenario, robot, limits, pilot.prover)
    world = World(people, things, shadow)
    if sighted:
        one: Simulation = Simulation(pilot, ways, people, things, faults=Faults(latency=_LATENCY * TICK))
    else:
        one = Seen(pilot, ways, world, shadow, seed)
    ticks = list(one.ticks(seconds))
    false = sum(
        before["state"] in ("moving", "slowed") and tick["state"] in ("braking", "standing") and tick["distance"] > 0.8
        for before, tick in pairwise(ticks)
    )
    found = {"policy": policy, "job": str(job), **one.summary.as_dict(), "false": false, "took": one.reactions}
    found["standing"] = sum(tick["state"] == "standing" for tick in ticks) * TICK
    return found | {"surprises": getattr(one, "surprises", 0)}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    add = parser.add_argument
    add("folder", type=Path, nargs="?", help="with recordings; without: boxes only")
    add("--drives", type=int, default=100, metavar="N")
    add("--seconds", type=float, default=6.0, metavar="S", help="of each")
    add("--boxes", action="store_true", help="unknown boxes that fly, and nobody")
    add("--unseen", default="occupied", choices=("occupied", "free"))
    add("--policies", default=",".join(POLICIES))


def main(options: argparse.Namespace, report: Report) -> int:
    """Run what the options choose."""
    logging.disable(logging.WARNING)
    jobs: list[Any] = list(range(options.drives))
    if not options.boxes:
        jobs = situations(options.folder, _PLACES, options.drives)
    rows = []
    for policy in options.policies.split(","):
        rows += [drive(job, policy, options.seconds, options.unseen) for job in jobs]
    table = []
    for policy in options.policies.split(","):
        mine = [row for row in rows if row["policy"] == policy]
        hours = sum(row["seconds"] for row in mine) / 3600
        total = {key: sum(row[key] for row in mine) for key in ("tasks", "stops", "false", "surprises", "standing")}
        counts = [
            sum(row[f"contacts_{key}"] for row in mine) for key in ("while_moving", "after_violations", "at_rest")
        ]
        took = 1e3 * np.percentile(np.concatenate([row["took"] for row in mine]), (50, 99))
        obeyed = f"{np.mean([row['model_obeyed'] for row in mine]):.2%}"
        rates = [round(total[key] / hours) for key in ("tasks", "stops", "false")]
        table.append((policy, *rates, *counts, obeyed, total["surprises"], *(float(t) for t in took)))
    header = ("", "tasks/h", "stops/h", "false stops/h", "contacts moving", "after violation", "at rest", "obeyed")
    report.table((*header, "surprises", "ingest + command 50 % [ms]", "99 %"), table)
    wrong = [row for row in rows if row["policy"] == "depth" and row["contacts_while_moving"]]
    for row in wrong:
        print("CONTACT", {key: value for key, value in row.items() if key != "took"})
    return int(bool(wrong))
