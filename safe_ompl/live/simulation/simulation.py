"""A robot, its replanner and people in simulated time, with a monitor that looks for contacts."""

from __future__ import annotations

from collections.abc import Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from time import perf_counter
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, Section, fraction, key, number
from safe_ompl.live import ReachSets, ReachViolation, Surroundings
from safe_ompl.live.replanning import Action, Command, Replanner, Route, Segment, SegmentSequence
from safe_ompl.live.simulation.movers import Drifting, PersonMover, Solid, World
from safe_ompl.motions import Trajectory
from safe_ompl.robot import Robot

# The time between two observations of the contact monitor.
_MONITOR_INTERVAL = 0.005  # [s]
# A robot that is slower than this is at rest.
_REST_SPEED = 1e-9  # [rad/s]
# A limb may be outside of its reach set by this.
_REACH_TOLERANCE = 1e-6  # [m]


class Touch(NamedTuple):
    """A link of the robot that touches a limb."""

    link: str
    who: str
    limb: str
    # The speed of the link at the point of contact [m/s].
    speed: float
    point: FloatArray  # (3,) [m]
    # The direction from the link to the limb (3,).
    normal: FloatArray


class NearestLimb(NamedTuple):
    """The smallest distance at one instant [m], the link of the robot, and the limb of a person or object."""

    distance: float
    link: str | None = None
    who: str | None = None
    limb: str | None = None


@dataclass
class Contact:
    """A contact between the robot and a person or object."""

    time: float  # When it began [s]
    # The link of the robot, and the limb of the person or object.
    link: str
    who: str
    limb: str
    # Whether the robot moved at the beginning or later during the contact.
    moving: bool
    # Whether everybody had kept to the reach model since the measurement that the motion was proven against
    obeyed: bool
    # Whether the robot retreated during the contact.
    retreating: bool = False
    # The largest speed of the robot at the point of contact [m/s].
    speed: float = 0.0


class ContactMonitor:
    """Measures distances between a robot and everything that moves, and notes contacts in order."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._model = robot.shared.model
        self._bodies = robot.shared.collision_model
        self._kinematics = self._model.createData()
        self._data = self._bodies.createData()
        self._moving = [k for k, part in enumerate(self._bodies.geometryObjects) if part.parentJoint != 0]
        self._links = robot.shared.body_links
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        # The present contacts, by link and by person or object.
        self.touching: dict[tuple[str, str], Contact] = {}
        self.contacts: list[Contact] = []

    def nearest(self, q: FloatArray, solids: list[Solid]) -> NearestLimb:
        """Return the smallest distance between the robot at `q: (n,)` and any of the solids."""
        full = self._robot.pinocchio_configuration(q)
        pin.updateGeometryPlacements(self._model, self._kinematics, self._bodies, self._data, full)
        found = NearestLimb(np.inf)
        for k, solid, geometries in self._pairs(solids):
            # Without clearing, the result keeps the smallest distance of all calls.
            self._result.clear()
            distance = coal.distance(*geometries, self._request, self._result)
            if distance < found.distance:
                found = NearestLimb(float(distance), self._links[k], solid.who, solid.limb)
        return found

    def _pairs(self, solids: list[Solid]) -> Iterator[tuple[int, Solid, tuple[Any, Any, Any, Any]]]:
        """Yield all pairs of a part of the robot and a solid, with their geometries and places as coal takes them."""
        there = [coal.Transform3s(solid.placement.rotation, solid.placement.translation) for solid in solids]
        for k in self._moving:
            part, place = self._bodies.geometryObjects[k], self._data.oMg[k]
            where = coal.Transform3s(place.rotation, place.translation)
            for solid, at in zip(solids, there, strict=True):
                yield k, solid, (part.geometry, where, solid.geometry, at)

    def touches(self, q: FloatArray, qd: FloatArray, solids: list[Solid]) -> list[Touch]:
        """Return all contacts of the robot at `q` and joint velocities `qd`, both (n,)."""
        full = self._robot.pinocchio_configuration(q)
        pin.forwardKinematics(self._model, self._kinematics, full, self._robot.coupling.motions(qd))
        pin.updateGeometryPlacements(self._model, self._kinematics, self._bodies, self._data)
        request, found = coal.CollisionRequest(), []
        for k, solid, geometries in self._pairs(solids):
            result = coal.CollisionResult()
            if coal.collide(*geometries, request, result):
                met = result.getContact(0)
                point, joint = np.array(met.pos), self._bodies.geometryObjects[k].parentJoint
                velocity = self._kinematics.v[joint]
                fast = velocity.linear + np.cross(velocity.angular, self._kinematics.oMi[joint].actInv(point))
                speed = float(np.linalg.norm(fast))
                found.append(Touch(self._links[k], solid.who, solid.limb, speed, point, np.array(met.normal)))
        return found

    def observe(
        self,
        time: float,
        q: FloatArray,
        solids: list[Solid],
        *,
        moving: bool,
        obeyed: bool,
        qd: FloatArray | None = None,
    ) -> NearestLimb:
        """Record the contacts at one instant, and return the smallest distance.

        With joint velocities `qd: (n,)` the speeds of the robot in contacts are recorded, too.
        """
        nearest = self.nearest(q, solids)
        if nearest.distance > 0:
            self.touching.clear()
            return nearest
        whom = str(nearest.who), str(nearest.limb)
        if whom not in self.touching:
            self.touching = {whom: Contact(time, str(nearest.link), *whom, moving, obeyed)}
            self.contacts.append(self.touching[whom])
        contact = self.touching[whom]
        if moving and not contact.moving:
            contact.moving, contact.obeyed = True, obeyed
        if qd is not None:
            contact.speed = max([contact.speed, *(touch.speed for touch in self.touches(q, qd, solids))])
        return nearest


@dataclass(frozen=True)
class Faults(Section):
    """Delays and faults between the world and the replanner; raises InputError if a value is out of its range."""

    # Errors of measured key points and positions of objects are uniform in a ball of this radius [m].
    noise: float = key(number, default=0.0, at_least=0.0)
    # The share of the measurements in which nobody is seen.
    drops: float = key(fraction, default=0.0)
    # The share of the ticks in which the command is too late. The robot then follows its last command to its stop.
    late: float = key(fraction, default=0.0)
    # The seed of the generator that draws the faults.
    seed: int = 0
    # The time from a measurement until its command holds [s], at most a tick; the replanner computes in this time.
    latency: float = key(number, default=0.02, at_least=0.0)


@dataclass
class SimulationSummary:
    """The result of a simulation."""

    seconds: float = 0.0
    # Contacts while the robot moved and everybody stayed in their reach sets: 0 if the proofs hold and contact is not
    # allowed.
    contacts_while_moving: int = 0
    # The largest speed of the robot at the point of contact [m/s].
    contact_speed: float = 0.0
    # Contacts while the robot moved, after somebody had left their reach set; and contacts while the robot stood.
    contacts_after_violations: int = 0
    contacts_at_rest: int = 0
    # Contacts with people who followed a robot that retreated from their measured places.
    contacts_retreating: int = 0
    # The share of the time in which everybody had stayed in their reach sets since the measurement against which the
    # motion was proven.
    model_obeyed: float = 1.0
    # Numbers of goals reached, of stops on the way, and of detours.
    tasks: int = 0
    stops: int = 0
    detours: int = 0
    # The share of the time in which the robot moved.
    moving: float = 0.0
    # The time from a measurement to a proven command on this machine: median and 99th percentile [s].
    reaction: tuple[float, float] = (0.0, 0.0)
    # Ticks without a new command, in which the robot followed its last command to the stop.
    deadlines_missed: int = 0
    # Measurements that showed a limb farther away than assumed.
    violations: int = 0
    # The smallest distance while the robot moved and everybody stayed in their reach sets [m].
    least_distance: float = np.inf

    def as_dict(self) -> dict[str, Any]:
        """Return all attributes as a dict of plain values."""
        found = dict(self.__dict__)
        found["reaction"] = {"median": self.reaction[0], "p99": self.reaction[1]}
        return found

    def __str__(self) -> str:
        median, late = (1e3 * t for t in self.reaction)
        fast = f" (the robot at {self.contact_speed:.2f} m/s at most)" if self.contacts_while_moving else ""
        return (
            f"{self.seconds:g} s: {self.tasks} tasks, {self.stops} stops; contacts while moving "
            f"{self.contacts_while_moving}{fast}, after violations {self.contacts_after_violations}, at rest "
            f"{self.contacts_at_rest}, in retreats {self.contacts_retreating}; "
            f"model obeyed {100 * self.model_obeyed:.1f} % of the time; reaction "
            f"{median:.1f} ms (99 %: {late:.1f}); deadlines missed {self.deadlines_missed}"
        )


class Simulation:
    """Simulation of a robot that follows trajectories among moving people and objects, which its replanner tracks.

    The trajectories are followed in order, and then again from the first; each begins where the previous one ends. Or
    the places of a `Route` are visited in any order. `summary` is complete at the end of the simulation. The search for
    contacts takes most of the time; set `monitor` to None to skip it. `reactions` are the times from measurements to
    their commands on the `clock` [s].
    """

    clock = staticmethod(perf_counter)

    def __init__(
        self,
        replanner: Replanner,
        trajectories: Sequence[Trajectory] | Route,
        people: Mapping[str, PersonMover],
        objects: Mapping[str, Drifting] | None = None,
        *,
        faults: Faults | None = None,
    ) -> None:
        self.replanner, self.trajectories = replanner, trajectories
        self.world = World(people, objects or {}, replanner.surroundings)
        self.faults = Faults() if faults is None else faults
        self.latency = number("latency", self.faults.latency, at_least=0.0, at_most=replanner.tick)
        self.monitor = ContactMonitor(replanner.robot)
        self.summary = SimulationSummary()
        self._rng = np.random.default_rng(self.faults.seed)
        self._promised: dict[float, ReachSets] = {}
        self.reactions: list[float] = []

    def log_header(self) -> dict[str, Any]:
        """Return the header of a log of the ticks."""
        return self.replanner.log_header()

    def run(self, seconds: float) -> SimulationSummary:
        """Simulate for a time [s], and return the summary."""
        for _ in self.ticks(seconds):
            pass
        return self.summary

    def ticks(self, seconds: float) -> Generator[dict[str, Any], None, None]:
        """Simulate for a time [s], and yield ticks in the form of `safe_ompl.io.ticks`."""
        tick = self.replanner.tick
        if isinstance(self.trajectories, Route):
            self.trajectories.start(self.replanner, self.trajectories.places[0])
        elif self.trajectories:
            self.replanner.start(self.trajectories[0])
        command: Command | None = None
        logged: Command | None = None
        shares: FloatArray = np.zeros(2)
        path, over = 0, 0.0
        try:
            for k in range(round(number("seconds", seconds, above=0.0) / tick)):
                now = k * tick
                new, reaction = self._answer(now, command)
                if new is None:
                    continue
                old, command = command, new
                self._count(old, command)
                share, nearest = self._observe(now, old, command)
                shares += share * tick
                over = now + tick
                current = self._in_force(now, now, old, command)
                new_path = logged is None or current.path is not logged.path
                path, logged = path + new_path, current
                line: dict[str, Any] = {
                    **current.tick_at(now, tick),
                    **self.world.tick(now),
                    **nearest._asdict(),
                    "obeyed": bool(share[0] == 1.0),
                    "path": path,
                    "task": self.summary.tasks,
                    "reaction": reaction,
                }
                if new_path:
                    curve = current.path.curve
                    line["ahead"] = curve.knots.tolist()
                yield line
            over = seconds
        # This also happens if Ctrl-C or the caller ends the simulation early.
        finally:
            if over:
                self._conclude(over, shares)

    def _answer(self, now: float, command: Command | None) -> tuple[Command | None, float | None]:
        """Return the new command and its computing time [s]; if it is late, the last command and None."""
        if self._rng.random() < self.faults.late:
            self.summary.deadlines_missed += 1
            return command, None
        reaction = self._measure(now, command)
        if command is not None and command.action is Action.DONE:
            self._go_on(now, command.at(np.inf).q)
        begin = self.clock()
        new = self.replanner.command(now + self.latency)
        reaction += self.clock() - begin
        self.replanner.think()
        self.reactions.append(reaction)
        return new, reaction

    def _go_on(self, now: float, q: FloatArray) -> None:
        """Start the next trajectory or place of the route from `q: (n,)`."""
        self.summary.tasks += 1
        if isinstance(self.trajectories, Route):
            self.trajectories.start(self.replanner, q)
        else:
            self.replanner.start(self.trajectories[self.summary.tasks % len(self.trajectories)])

    def _count(self, old: Command | None, new: Command) -> None:
        """Count detours and stops."""
        if old is None:
            return
        self.summary.detours += new.path is not old.path and old.action is not Action.DONE
        stops = new.action in (Action.STANDING, Action.BRAKING)
        self.summary.stops += stops and old.action in (Action.MOVING, Action.SLOWED)

    def _in_force(self, time: float, now: float, old: Command | None, new: Command) -> Command:
        """Return the command that the robot follows at a time [s] of the tick from `now` on."""
        return new if old is None or time >= now + self.latency - 1e-12 else old

    def _measure(self, now: float, command: Command | None) -> float:
        """Pass measurements of the world to the replanner; return the computing time of its update [s]."""
        seen, things = dict[str, Any](), dict[str, Any]()
        if not self._rng.random() < self.faults.drops:
            for name, mover in self.world.people.items():
                points = mover.at(now)
                seen[name] = points + self._noise(points.shape) / mover.tracker.skeleton.scale
            for name, thing in self.world.objects.items():
                things[name] = thing.at(now)
        begin = self.clock()
        violations = self.replanner.update(seen, things, now)
        took = self.clock() - begin
        self._promise(now, self.replanner.surroundings, violations)
        return took

    def _promise(self, now: float, around: Surroundings, violations: list[ReachViolation]) -> None:
        """Record the new reach sets, and the violations of the previous ones."""
        self.summary.violations += bool(violations)
        if around.known:
            self._promised[now] = around.sets
        while len(self._promised) > 200:
            del self._promised[next(iter(self._promised))]

    def _noise(self, shape: tuple[int, ...]) -> FloatArray:
        if not self.faults.noise:
            return np.zeros(shape)
        directions = self._rng.normal(size=shape)
        directions /= np.maximum(np.linalg.norm(directions, axis=-1, keepdims=True), 1e-12)
        radii = self.faults.noise * self._rng.random((*shape[:-1], 1)) ** (1 / 3)
        return np.asarray(directions * radii)

    def _observe(self, now: float, old: Command | None, new: Command) -> tuple[FloatArray, NearestLimb]:
        """Return the shares (2,) of a tick in which reach sets held and the robot moved, and the first nearest limb."""
        robot = self.replanner.robot
        times = now + np.arange(0.0, self.replanner.tick - 1e-9, _MONITOR_INTERVAL)
        shares: FloatArray = np.zeros(2)
        here, first_q, first = NearestLimb(np.inf), np.zeros(0), [np.zeros((0, 3))]
        for i, time in enumerate(times.tolist()):
            command = self._in_force(time, now, old, new)
            state = command.at(max(time, command.time))
            moving = bool(np.abs(state.qd).max() > _REST_SPEED)
            keypoints = self.world.keypoints(time)
            ends = self.world.ends(keypoints, time)
            sets = self._promised.get(command.measured)
            # Whether everybody is in the reach sets of the measurement.
            since = time - command.measured
            good = sets is None or bool((sets.excess(ends, since) <= _REACH_TOLERANCE).all())
            shares += (good, moving)
            if i:
                way = float(np.abs(state.q - first_q) @ robot.bounds.displacement_radii.max(axis=0))
                moved = (np.linalg.norm(a - b, axis=1).max() for a, b in zip(ends, first, strict=True))
                way += max(map(float, moved), default=0.0)
                if way < here.distance:
                    self.monitor.touching.clear()
                    continue
            solids = self.world.solids(keypoints, time)
            away = moving and command.action is Action.RETREATING
            nearest = self.monitor.observe(time, state.q, solids, moving=moving and not away, obeyed=good, qd=state.qd)
            for contact in self.monitor.touching.values():
                contact.retreating |= away
            if not i:
                here, first_q, first = nearest, state.q, ends
            if moving and good and not away:
                self.summary.least_distance = min(self.summary.least_distance, nearest.distance)
        return shares / len(times), here

    def _conclude(self, seconds: float, shares: FloatArray) -> None:
        summary, kept = self.summary, np.minimum(shares / seconds, 1.0).tolist()
        summary.seconds = float(seconds)
        summary.model_obeyed, summary.moving = kept
        if self.reactions:
            summary.reaction = tuple(np.percentile(self.reactions, (50, 99)).tolist())
        contacts = self.monitor.contacts
        speeds = [c.speed for c in contacts if c.moving and c.obeyed]
        summary.contacts_while_moving, summary.contact_speed = len(speeds), max(speeds, default=0.0)
        summary.contacts_after_violations = sum(c.moving and not c.obeyed for c in contacts)
        summary.contacts_retreating = sum(c.retreating and not c.moving for c in contacts)
        summary.contacts_at_rest = sum(not (c.moving or c.retreating) for c in contacts)


class ProgramSimulation(Simulation):
    """Simulation of a program: `segments` are executed once in order; the robot stops for people and then continues.

    After the last segment the robot rests. The summary counts segments as tasks. Raises InputError as
    `SegmentSequence`.
    """

    def __init__(
        self,
        segments: Sequence[Segment],
        people: Mapping[str, PersonMover],
        objects: Mapping[str, Drifting] | None = None,
        *,
        faults: Faults | None = None,
    ) -> None:
        self.segments = SegmentSequence(segments)
        super().__init__(self.segments.current.replanner, [], people, objects, faults=faults)

    def ticks(self, seconds: float) -> Generator[dict[str, Any], None, None]:
        """Simulate for a time [s] or until all segments are executed, and yield ticks as `Simulation.ticks`."""
        with closing(super().ticks(seconds)) as ticks:
            for tick in ticks:
                yield tick
                if self.segments.finished:
                    return

    def _go_on(self, now: float, q: FloatArray) -> None:
        self.segments.go_on(now)
        self.summary.tasks = self.segments.done
        segment = self.segments.current
        if segment.replanner is self.replanner:
            return
        self.replanner = segment.replanner
        contacts, self.monitor = self.monitor.contacts, ContactMonitor(segment.robot)
        self.monitor.contacts = contacts
