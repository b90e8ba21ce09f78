"""The shield against other filters of what a policy proposes: a Panda beside recorded people.

FOLDER has recordings as for `live`. A scripted policy proposes at each tick a chunk of 16 positions at 20 Hz along a
path that it knows, to and fro as in `scenarios/panda_shelf.yaml`, from where the robot is, with noise. Filters of
the chunk:

* the shield; with the limits of the jerk of a Panda (`jerk`); and where contact is allowed (`people.contact`);
* none: the chunk as it is;
* clamp A-B: the chunk's timing scaled by the distance of the nearest person, from 0 at A mm to 1 at B mm;
* pink D: a control barrier filter, `SelfCollisionBarrier` of pink (pin-pink) for all pairs of link and limb, which
  must keep D mm. It needs `pip install pin-pink daqp`; it is left out where they are not installed. It knows
  nothing of the shelf, nor how people move: D must be large enough for that.

All but the shield give velocities, one for each tick, which the robot reaches as fast as its accelerations let it.
With `--random` people walk about and reach out at random, as fast as the bounds allow (`Walker`), instead of recorded
ones. A task is done when the robot is within 0.02 rad of the end of the path. Contacts count as in `live`: while
the robot moves and everybody has kept to the reach model since the measurement that the motion answers. *Too fast* are
those in which a point that touches is faster than the limb bears: where contact is allowed these alone count.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from bench._harness import Report
from bench._scenes import ACCELERATIONS
from bench._touches import Bearable
from bench.live import HANDS, places, situations, to_and_fro
from safe_ompl import CollisionChecker, MotionProver, People, RateLimits, Robot, Scenario, Shield, Tracker, Trajectory
from safe_ompl.common import FloatArray
from safe_ompl.geometry import placed
from safe_ompl.live import Recording, Surroundings, TrackedBody
from safe_ompl.live.replanning import ReplanningOptions, SpeedLimits
from safe_ompl.live.simulation import ContactMonitor, Playback, Solid, Walker, World, limb_solids

CLAIM = "the shield lets no proposal touch people while the robot moves; what other filters do"
OURS = ("shield", "jerk", "contact")
TICK, LATENCY, RATE, CHUNK = 0.05, 0.02, 20.0, 16
JERKS = (7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0)  # [rad/s³] of a Panda
NOISE = 2e-3  # [rad] of each of four waves along a chunk
_INSTANT = 0.005  # [s] between two looks of the monitor
_ARRIVED, _STILL = 0.02, 1e-6  # [rad], [rad/s]
PLACES = 20
PEOPLE = People(speed=1.6, speeds=HANDS)
BEARING = replace(PEOPLE, contact=True)

Motion = Callable[[float], FloatArray]


class Policy:
    """Proposes chunks along trajectories that it knows, one after the other, from where the robot is."""

    def __init__(self, ways: list[Trajectory], seed: int) -> None:
        self.ways, self.tasks, self._progress = ways, 0, 0.0
        self._rng = np.random.default_rng(seed)
        self._ahead = np.arange(CHUNK) / RATE

    def chunk(self, q: FloatArray) -> FloatArray:
        """Return the positions (K, n) that it proposes for a robot at `q: (n,)`."""
        way = self.ways[self.tasks % len(self.ways)]
        if np.abs(way.at(way.duration).q - q).max() < _ARRIVED:
            self.tasks, self._progress = self.tasks + 1, 0.0
            way = self.ways[self.tasks % len(self.ways)]
        near = np.clip(self._progress + np.arange(-0.1, 0.5, 0.01), 0.0, way.duration)
        self._progress = float(near[np.linalg.norm(way.at(near).q - q, axis=1).argmin()])
        found = way.at(self._progress + self._ahead).q
        back = np.exp(-self._ahead / 0.2)[:, None] * (q - found[0])
        phases = np.pi * np.outer(self._ahead / self._ahead[-1], np.arange(1, 5))
        return np.asarray(found + back + np.sin(phases) @ self._rng.normal(scale=NOISE, size=(4, len(q))))


class Filter(Protocol):
    """Makes of a chunk what is driven; `start: (n,)` is where the robot stands at first."""

    failures: int

    def answer(self, time: float, q: FloatArray, chunk: FloatArray, seen: FloatArray) -> tuple[Motion, float]:
        """Return the motion from a time [s] on, and when that was measured which it answers.

        The robot will be at `q: (n,)`; key points (J, 3) were seen `LATENCY` before.
        """


class Shielded:
    """The shield."""

    def __init__(
        self,
        robot: Robot,
        scenario: Scenario,
        tracker: Tracker,
        start: FloatArray,
        people: People,
        jerk: Sequence[float] | None = None,
    ) -> None:
        limits = SpeedLimits(RateLimits.of(robot, acceleration=ACCELERATIONS["panda"], jerk=jerk))
        known = Surroundings(scenario.scene, {"operator": tracker}, people=people)
        self.shield = Shield(robot, known, options=ReplanningOptions(tick=TICK, limits=limits))
        self.shield.start(start)
        self.failures = 0

    def answer(self, time: float, q: FloatArray, chunk: FloatArray, seen: FloatArray) -> tuple[Motion, float]:
        self.shield.update({"operator": seen}, {}, time - LATENCY)
        self.failures += not self.shield.propose(chunk, RATE)
        command = self.shield.command(time)
        return lambda t: command.at(t).q, command.measured


class Tracked:
    """A robot that is given velocities, and reaches them as fast as its accelerations let it."""

    failures = 0

    def __init__(self, robot: Robot) -> None:
        self._velocity = np.zeros(robot.n)
        self._most = np.array(ACCELERATIONS["panda"], dtype=float)

    def answer(self, time: float, q: FloatArray, chunk: FloatArray, seen: FloatArray) -> tuple[Motion, float]:
        first, change = self._velocity, self.velocity(q, chunk, seen) - self._velocity
        until = np.abs(change) / self._most
        self._velocity = first + np.clip(change, -self._most * TICK, self._most * TICK)

        def motion(t: float) -> FloatArray:
            ramp = np.minimum(t - time, until)
            return np.asarray(q + (t - time) * first + np.sign(change) * self._most * ramp * (t - time - ramp / 2))

        return motion, time - LATENCY

    def velocity(self, q: FloatArray, chunk: FloatArray, seen: FloatArray) -> FloatArray:
        """Return the velocity (n,) that it is given: that of the chunk."""
        return np.asarray((chunk[1] - q) * RATE)


class Clamped(Tracked):
    """The velocity of the chunk, the slower the nearer the nearest person is."""

    def __init__(self, robot: Robot, tracker: Tracker, near: float, far: float) -> None:
        super().__init__(robot)
        self._monitor, self._tracker, self._near, self._far = ContactMonitor(robot), tracker, near, far

    def velocity(self, q: FloatArray, chunk: FloatArray, seen: FloatArray) -> FloatArray:
        distance = self._monitor.nearest(q, _limbs(self._tracker, seen)).distance
        share = float(np.clip((distance - self._near) / (self._far - self._near), 0.0, 1.0))
        return share * super().velocity(q, chunk, seen)


class Barrier(Tracked):
    """The velocity towards the chunk that is nearest to it among those that pink's barriers allow."""

    def __init__(self, robot: Robot, tracker: Tracker, distance: float) -> None:
        import pink
        from pink.barriers import SelfCollisionBarrier

        super().__init__(robot)
        self._pink, self._tracker, self._robot = pink, tracker, robot
        self._bodies = robot.collision_model.copy()
        self._bodies.removeAllCollisionPairs()
        links = [k for k, body in enumerate(self._bodies.geometryObjects) if body.parentJoint]
        self._limbs, self._shapes = [], []
        for solid in _limbs(tracker, np.zeros((len(tracker.skeleton.points), 3))):
            shape = pin.hppfcl.Capsule(solid.geometry.radius, 0.1)
            limb = self._bodies.addGeometryObject(pin.GeometryObject(solid.limb, 0, pin.SE3.Identity(), shape))
            self._limbs.append(limb)
            self._shapes.append(shape)
            for link in links:
                self._bodies.addCollisionPair(pin.CollisionPair(link, limb))
        count = len(self._bodies.collisionPairs)
        self._barriers = [SelfCollisionBarrier(count, gain=1 / TICK, safe_displacement_gain=0.0, d_min=distance)]
        self._task = pink.tasks.PostureTask(cost=1.0)

    def velocity(self, q: FloatArray, chunk: FloatArray, seen: FloatArray) -> FloatArray:
        for solid, limb, shape in zip(_limbs(self._tracker, seen), self._limbs, self._shapes, strict=True):
            self._bodies.geometryObjects[limb].placement = solid.placement
            shape.halfLength = getattr(solid.geometry, "halfLength", 0.0)
        model = self._robot.shared.model
        here, there = (self._robot.pinocchio_configuration(x) for x in (q, chunk[1]))
        try:
            state = self._pink.Configuration(
                model,
                model.createData(),
                np.clip(here, model.lowerPositionLimit, model.upperPositionLimit),
                collision_model=self._bodies,
                collision_data=pin.GeometryData(self._bodies),
            )
            self._task.set_target(there)
            velocity = self._pink.solve_ik(state, [self._task], TICK, "daqp", barriers=self._barriers)
        except (self._pink.exceptions.PinkError, ValueError, AssertionError):
            self.failures += 1
            velocity = np.zeros(model.nv)
        if not np.isfinite(velocity).all():
            self.failures += 1
            velocity = np.zeros(model.nv)
        planned = [model.joints[model.getJointId(name)].idx_v for name in self._robot.joint_names]
        return np.asarray(velocity[planned])


def _limbs(tracker: Tracker, seen: FloatArray) -> list[Solid]:
    """Return the limbs of a person whose key points (J, 3) were seen."""
    points = placed(tracker.place.se3, tracker.skeleton.keypoints(seen))
    return limb_solids("operator", tracker.body, tracker.body.completed(points)[0])


def filters(robot: Robot, scenario: Scenario, tracker: Tracker, start: FloatArray) -> Mapping[str, Callable[[], Any]]:
    """Return what makes each filter."""
    found: dict[str, Callable[[], Any]] = {
        "shield": lambda: Shielded(robot, scenario, tracker, start, PEOPLE),
        "jerk": lambda: Shielded(robot, scenario, tracker, start, PEOPLE, JERKS),
        "contact": lambda: Shielded(robot, scenario, tracker, start, BEARING),
        "none": lambda: Tracked(robot),
    }
    for near, far in ((0.05, 0.3), (0.1, 0.5), (0.2, 0.8)):
        name = f"clamp {1e3 * near:.0f}-{1e3 * far:.0f}"
        found[name] = lambda near=near, far=far: Clamped(robot, tracker, near, far)
    for distance in (0.05, 0.1, 0.2, 0.4):
        found[f"pink {1e3 * distance:.0f}"] = lambda distance=distance: Barrier(robot, tracker, distance)
    return found


def recorded(file: Path, clip: str, place: int) -> Playback:
    """Return a recorded person at a place beside the robot."""
    recording = Recording.load(file, clip)
    seed = sum(map(ord, file.stem + clip))
    return Playback(recording, Tracker(recording.skeleton, TrackedBody(), places(recording, PLACES, seed)[place]))


def walker(seed: int) -> Walker:
    """Return a person who walks about and reaches out at random."""
    return Walker(PEOPLE, np.array([0.0, 0.0, -0.9]), np.array([1.2, 0.3 * (-1) ** seed]), seed=seed)


def run(mover: Any, seed: int, names: list[str], seconds: float) -> list[dict[str, Any]]:
    """Run each of the filters beside a person."""
    scenario = Scenario.load("panda_shelf")
    robot = scenario.build_robot()
    tracker = mover.tracker
    proof = MotionProver(CollisionChecker(robot, scenario.scene.without("operator")))
    urdf = RateLimits.of(robot, acceleration=ACCELERATIONS["panda"])
    limits = RateLimits.of(robot, velocity=0.8 * urdf.velocity, acceleration=0.5 * urdf.acceleration)
    ways = to_and_fro(scenario, robot, limits, proof)
    made = filters(robot, scenario, tracker, ways[0].at(0.0).q)
    rows = []
    for name in names or list(made):
        try:
            one = made[name]()
        except ImportError as error:
            print(f"{name} is left out: {error}")
            continue
        surroundings = Surroundings(scenario.scene, {"operator": tracker}, {}, PEOPLE)
        world = World({"operator": mover}, {}, surroundings)
        row = drive(robot, one, Policy(ways, seed), world, proof.checker, seconds)
        rows.append({"filter": name, **row})
    return rows


def drive(
    robot: Robot, one: Filter, policy: Policy, world: World, checker: CollisionChecker, seconds: float
) -> dict[str, Any]:
    """Return what happens in a time [s]."""
    start = before = policy.ways[0].at(0.0).q
    motion: Motion = lambda t: start  # noqa: E731
    measured = 0.0
    surroundings, monitor, sets = world.surroundings, ContactMonitor(robot), {}
    took, moving, touched = [], 0, 0
    reach = robot.bounds.displacement_radii.max(axis=0)
    for k in range(round(seconds / TICK)):
        now = k * TICK
        seen = world.people["operator"].at(now)
        surroundings.update({"operator": seen}, {}, now)
        sets[now] = surroundings.sets
        ahead = motion(now + LATENCY)
        chunk = policy.chunk(ahead)
        begin = process_time()
        new = one.answer(now + LATENCY, ahead, chunk, seen)
        took.append(process_time() - begin)
        left = 0.0
        for j in range(round(TICK / _INSTANT)):
            time = now + j * _INSTANT
            if j == round(LATENCY / _INSTANT):
                motion, measured = new
            q = motion(time)
            moves = bool(np.abs(q - before).max() > _STILL * _INSTANT)
            keypoints = world.keypoints(time)
            ends = world.ends(keypoints, time)
            promised = sets.get(measured, surroundings.sets)
            obeyed = bool((promised.excess(ends, time - measured) <= 1e-6).all())
            moving += moves
            left -= float(np.abs(q - before) @ reach) + 0.08  # no limb is faster than 16 m/s
            if left < 0:
                solids, rates = world.solids(keypoints, time), (q - before) / _INSTANT
                found = monitor.observe(time, q, solids, moving=moves, obeyed=obeyed, qd=rates)
                left = found.distance
            else:
                monitor.touching.clear()
            before = q
        touched += checker.in_collision(q)
    contacts, bearable = monitor.contacts, Bearable(robot, BEARING)
    return {
        "seconds": seconds,
        "tasks": policy.tasks,
        "contacts": sum(c.moving and c.obeyed for c in contacts),
        "too_fast": sum(c.moving and c.obeyed and c.speed > bearable.speeds(c.limb)[0] for c in contacts),
        "after_violations": sum(c.moving and not c.obeyed for c in contacts),
        "at_rest": sum(not c.moving for c in contacts),
        "still": touched,
        "moving": moving * _INSTANT,
        "failures": one.failures,
        "took": took,
    }


COUNTS = ("contacts", "too_fast", "after_violations", "at_rest", "still", "failures")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--random", action="store_true", help="people who walk about at random")
    parser.add_argument("--sample", type=int, default=20, metavar="N", help="of all clips and places, or people")
    parser.add_argument("--seconds", type=float, default=12.0, metavar="S", help="of each")
    parser.add_argument("--filters", default="", help="by name, with commas between; default: all")
    parser.add_argument("--tick", type=float, default=TICK, metavar="S", help="between measurements, and commands")


def main(options: argparse.Namespace, report: Report) -> int:
    """Run what the options choose."""
    global TICK, LATENCY
    TICK, LATENCY = options.tick, LATENCY / TICK * options.tick
    if options.folder is None and not options.random:
        raise SystemExit("give a folder with .npz files, or --random")
    if options.random:
        people = [(k, walker(k)) for k in range(options.sample)]
    else:
        chosen = situations(options.folder, PLACES, options.sample)
        people = [(k, recorded(*situation)) for k, situation in enumerate(chosen)]
    names, rows = [name for name in options.filters.split(",") if name], []
    for k, mover in people:
        rows += run(mover, k, names, options.seconds)
    table = []
    for name in dict.fromkeys(row["filter"] for row in rows):
        mine = [row for row in rows if row["filter"] == name]
        total = {key: sum(r[key] for r in mine) for key in ("seconds", "tasks", "moving", *COUNTS)}
        half, late = 1e3 * np.percentile(np.concatenate([row["took"] for row in mine]), (50, 99))
        share = f"{total['moving'] / total['seconds']:.1%}"
        tasks = round(3600 * total["tasks"] / total["seconds"])
        table.append((name, tasks, *(total[key] for key in COUNTS), share, float(half), float(late)))
    header = ("", "tasks/h", "contacts moving", "too fast", "after violation", "at rest", "shelf", "fails")
    report.table((*header, "moving", "CPU 50 % [ms]", "99 %"), table)
    ours = [row for row in rows if row["filter"] in OURS]
    return int(any(row["too_fast" if row["filter"] == "contact" else "contacts"] for row in ours))
