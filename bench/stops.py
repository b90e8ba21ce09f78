"""Stops beside people against an adversary that runs at the robot.

stops      From random instants of trajectories beside a person the robot brakes, while every limb runs straight at the
           nearest link at its speed, from where she was measured before the reaction time. `reached` must be 0. Where
           contact is allowed, as in half of them, a limb that may be there has reached the robot only if some point of
           it is then faster than the limb bears, or if a gap in which it fits closes faster than it bears when it is
           clamped: a hand is put in every gap. `fastest` and `closing` are the largest of these speeds, as shares of
           what is borne. Motions without contact are driven without a limit of the jerk and with one of 500 times the
           acceleration; `jerk` is the largest in a stop, by differences, as a share of it.
motions    The same of motions that others made: random splines, as fast as is proven (`check(..., people=)`), to 1 %.
           `reached` must be 0. Of the same splines, faster by some percent and not proven, the share that is reached.
           And the trajectories of `stops` without a limit of the jerk, as polynomials: whether they are proven as they
           are, or 1 % slower.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from bench._harness import Report
from bench._plain import fresh_data
from bench._scenes import ACCELERATIONS
from bench._touches import Bearable, Gaps, thickness
from safe_ompl import (
    CollisionChecker,
    Motion,
    MotionProver,
    PathTimer,
    People,
    RateLimits,
    Robot,
    Scenario,
    Scene,
    Trajectory,
)
from safe_ompl.certificates.verifier.bodies import corners
from safe_ompl.common import FloatArray
from safe_ompl.motions import State, Stops, rate_violations
from safe_ompl.motions.rates import stops_of

CLAIM = "a robot stands, or is as slow as is borne, before anyone of bounded speed is there"
BETWEEN = {
    "panda_shelf": [[0.7, -0.6, 0, -2.2, 0, 3.0, 0.785], [-0.7, -0.6, 0, -2.4, 0, 2.6, 0.785]],
    "ur5_handover": [[0.6, -1.9, 2.2, -2.0, -1.57, 0], [-0.8, -1.9, 2.2, -2.0, -1.57, 0]],
}
INSTANTS = 5  # of each stop


class Problem:
    """A path beside a person, and what times it."""

    def __init__(self, name: str, people: People, *, jerk: bool = False) -> None:
        scenario = Scenario.load(name)
        self.name, self.people, self.scene = name, people, scenario.scene
        self.robot = robot = scenario.build_robot()
        ends = scenario.start_configuration(robot), scenario.goal_configurations(robot)[0]
        self.path = np.array([ends[0], *BETWEEN[name], ends[1]])
        motion = MotionProver(CollisionChecker(robot, scenario.scene))
        pushes = np.array(ACCELERATIONS[name.partition("_")[0]])
        limits = RateLimits.of(robot, acceleration=pushes, jerk=500 * pushes if jerk else None)
        self.proof, self.limits = motion, limits
        self.timer = PathTimer(robot, limits, motion=motion, people=people)
        self.trajectory = self.timer.time(self.path)

    def adversary(self) -> Adversary:
        """Return the limbs that run at the robot."""
        people, limbs = self.people, Limbs(self.robot, self.scene, self.people.names(self.scene))
        speeds = np.array([people.speed_of(limb) for limb in limbs.limbs])
        contact = Contact(self, limbs.limbs) if people.contact else None
        return Adversary(limbs, speeds, people.reaction_time, people.clearance, contact)


class Limbs:
    """Distances of limbs from the robot by all pairs, nothing left out."""

    def __init__(self, robot: Robot, scene: Scene, names: tuple[str, ...]) -> None:
        self._robot = robot
        self._geometry = robot.shared.collision_model.copy()
        self._geometry.removeAllCollisionPairs()
        moving = [k for k, body in enumerate(self._geometry.geometryObjects) if body.parentJoint]
        self.limbs: list[str] = []
        self.parts: list[str] = []
        for name in names:
            for part, shape, place in scene[name].geometries():
                added = self._geometry.addGeometryObject(pin.GeometryObject(part, 0, place, shape))
                self.parts.append(part)
                self.limbs.append(part[len(name) + 1 :])
                for body in moving:
                    self._geometry.addCollisionPair(pin.CollisionPair(body, int(added)))
        self._data, self._memory = fresh_data(self._geometry), robot.shared.model.createData()
        bodies = [(body, *corners(body.geometry)) for body in robot.shared.collision_model.geometryObjects]
        self._bodies = [
            (body.parentJoint, points @ body.placement.rotation.T + body.placement.translation, pad)
            for body, points, pad in bodies
        ]

    def fastest(self, q: FloatArray, qd: FloatArray) -> float:
        """Return the speed of the fastest point of the robot [m/s]."""
        model, robot = self._robot.shared.model, self._robot
        rates = robot.coupling.motions(qd)
        pin.forwardKinematics(model, self._memory, robot.pinocchio_configuration(q), rates)
        found = 0.0
        for joint, points, pad in self._bodies:
            motion = self._memory.v[joint]
            speeds = np.linalg.norm(np.cross(motion.angular, points) + motion.linear, axis=1)
            found = max(found, float(speeds.max() + pad * np.linalg.norm(motion.angular)))
        return found

    def at(self, q: FloatArray) -> FloatArray:
        """Return the distance of every limb [m]."""
        model, full = self._robot.shared.model, self._robot.pinocchio_configuration(q)
        pin.computeDistances(model, self._memory, self._geometry, self._data, full)
        found = np.array([result.min_distance for result in self._data.distanceResults])
        return found.reshape(len(self.limbs), -1).min(axis=1)


class Adversary:
    """Limbs that run straight at the nearest link from where they were measured, at their speeds.

    Parameters
    ----------
    limbs : Limbs
        Where they were.
    speeds : ndarray, shape (M,)
        How fast they are [m/s].
    reaction, clearance : float
        When the robot begins to brake [s], and what must be left [m].
    contact : Contact, optional
        What limbs bear; default: nothing.
    """

    def __init__(
        self, limbs: Limbs, speeds: FloatArray, reaction: float, clearance: float, contact: Contact | None = None
    ) -> None:
        self._limbs, self._speeds = limbs, speeds
        self._reaction, self._clearance = reaction, clearance
        self._contact = contact

    def stopped(self, stop: Trajectory | MotionStop) -> tuple[float, float, float]:
        """Return what is least left in a stop of limbs that are harmed [m], and the largest speeds over what is borne.

        Limbs that bear the speed of a contact need nothing left; a limb that bears none need not be met at all. The
        speeds are those of points of the robot, and of gaps that close.
        """
        least, share, clamped = np.inf, 0.0, 0.0
        times = np.linspace(0, stop.duration * (1 - 1e-6), INSTANTS)
        states = stop.at(times)
        for t, q, qd in zip(times.tolist(), states.q, states.qd, strict=True):
            if np.abs(qd).max() <= 1e-9:
                continue
            left = self._limbs.at(q) - self._speeds * (self._reaction + t) - self._clearance
            met = left <= 0
            harmed = np.ones(len(left), dtype=bool)
            if self._contact is not None and met.any():
                bears, borne = self._contact.bears, self._contact.bears_clamped
                self._contact.gaps.place(q, qd)
                fast, closing = self._limbs.fastest(q, qd), self._contact.gaps.closing(self._contact.widths)
                harmed = ~met | (fast > bears * (1 + 1e-9)) | (closing > borne * (1 + 1e-9))
                share = max(share, float((fast / bears[~harmed]).max(initial=0.0)))
                clamped = max(clamped, float((closing / np.maximum(borne, 1e-9))[~harmed].max(initial=0.0)))
            least = min(least, float(left[harmed].min(initial=np.inf)))
        return least, share, clamped


class Contact:
    """What limbs bear in transient contacts and where they are clamped (M,) [m/s], and where they may be."""

    def __init__(self, problem: Problem, limbs: list[str]) -> None:
        people, scene = problem.people, problem.scene
        names = people.names(scene)
        bearable = Bearable(problem.robot, people)
        self.bears, self.bears_clamped = np.array([bearable.speeds(limb) for limb in limbs]).T
        height = scene[names[0]].shape.height
        # Neither of them bears anything: a gap for a head does not count.
        self.widths = np.array([0.0 if limb == "head" else thickness(limb, height) for limb in limbs])
        self.gaps = Gaps(problem.robot, scene.without(*names))


def largest_jerk(trajectory: Trajectory, begin: float) -> float:
    """Return the largest jerk in a stop, by differences of accelerations, over its limit."""
    stop = trajectory.stop_from(begin)
    t = np.linspace(0.0, stop.duration, 200)
    jerks = np.diff(stop.at(t).qdd, axis=0) / (t[1] - t[0])
    return float(np.abs(jerks / stop.limits.jerk).max())


CASES = (
    ("panda_shelf", People()),
    ("panda_shelf", People(speed=1.2, reaction_time=0.05, clearance=0.05)),
    ("panda_shelf", People(speed=1.0, speeds={"right_hand": 2.0, "head": 0.3})),
    ("ur5_handover", People(speed=0.8, reaction_time=0.05)),
    ("panda_shelf", People(contact=True)),
    ("panda_shelf", People(reaction_time=0.12, contact=True)),
    ("ur5_handover", People(contact=True)),
    ("ur5_handover", People(speed=1.0, contact=True)),
)


def stops(options: argparse.Namespace, report: Report) -> int:
    """Run the adversary."""
    rows: list[tuple[Any, ...]] = []
    reached, rng = 0, np.random.default_rng(options.seed)
    cases = [(*case, jerk) for case, jerk in product(CASES, (False, True)) if not (jerk and case[1].contact)]
    for name, people, jerk in cases:
        problem = Problem(name, people, jerk=jerk)
        trajectory, adversary = problem.trajectory, problem.adversary()
        begins = rng.uniform(0, trajectory.duration, options.stops // len(cases))
        found = [adversary.stopped(trajectory.stop_from(begin)) for begin in begins.tolist()]
        left, fast, closing = np.array(found).T
        kind = "contact" if people.contact else "none"
        row = (problem.name, f"{people.speed:g}", kind, f"{trajectory.duration:.2f}", len(left))
        met = f"{int((fast > 0).sum())}" if people.contact else "-"
        shares = [f"{found.max():.3f}" if people.contact else "-" for found in (fast, closing)]
        most = f"{max(largest_jerk(trajectory, begin) for begin in begins[:500]):.3f}" if jerk else "-"
        reached += int((left <= 0).sum())
        rows.append((*row, int((left <= 0).sum()), f"{1e3 * left.min():.2f}", met, *shares, most))
    header = ("scenario", "m/s", "allowed", "duration [s]", "stops", "reached", "least left [mm]", "met")
    report.table((*header, "fastest", "closing", "jerk"), rows)
    report.counted("stops beside a person who runs at the robot", sum(row[4] for row in rows), reached)
    return int(reached > 0)


class MotionStop:
    """A stop of a motion that something else made, that begins at a time."""

    def __init__(self, motion: Motion, found: Stops, begin: float) -> None:
        self._motion, self._law = motion, found.stop_from(begin)
        self.duration = self._law.duration

    def at(self, t: FloatArray) -> State:
        """Return the states after times (T,) [s]."""
        _, at, rate, push = self._law.at(t)
        slope, bend = (self._motion.derivative(at, order).T for order in (1, 2))
        return State(self._motion.at(at), (slope * rate).T, (bend * rate**2 + slope * push).T)


def as_motion(trajectory: Trajectory) -> Motion:
    """Return a trajectory without a limit of the jerk as polynomials of time, exact but for rounding."""
    law, curve, coefficients = trajectory.law, trajectory.curve, []
    of = curve.piece_at((law.edges[1:] + law.edges[:-1]) / 2)
    for k, h in enumerate(np.diff(law.times)):
        begin, end = curve.times[of[k] : of[k] + 2]
        along = np.array([law.edges[k] - begin, np.sqrt(law.squared_speeds[k]) * h, law.accelerations[k] * h * h / 2])
        share = np.polynomial.Polynomial(along / (end - begin))
        held = np.zeros((7, curve.n))
        for i, c in enumerate(curve.coefficients[of[k]]):
            held[: len((share**i).coef)] += np.outer((share**i).coef, c)
        coefficients.append(held)
    rounding = 1e-14 * np.abs(coefficients).sum(axis=1)
    return Motion(law.times, np.array(coefficients), trajectory.joint_names, rounding=rounding)


FASTER = 1.01, 1.03, 1.1  # than what is proven


def motions(options: argparse.Namespace, report: Report) -> int:
    """Run the adversary against splines, as fast as is proven and faster, and check our own trajectories."""
    rows: list[tuple[Any, ...]] = []
    reached, rng = 0, np.random.default_rng(options.seed)
    for case in CASES:
        problem = Problem(*case)
        adversary, wanted, least, late = problem.adversary(), options.motions // len(CASES), [], []
        own = [proven(problem, slowed(as_motion(problem.trajectory), share)) for share in (1.0, 1.01)]
        durations = []
        while len(least) < wanted:
            spline = random_spline(problem, rng)
            found = fastest_proven(problem, spline)
            if found is None:
                continue
            duration, stops_ = found
            durations.append(duration)
            begins = rng.uniform(0, duration, min(STOPS_OF_EACH, wanted - len(least))).tolist()
            motion = paced(problem, spline, duration)
            least += [adversary.stopped(MotionStop(motion, stops_, begin))[0] for begin in begins]
            late.append([is_reached(problem, spline, duration / share, adversary) for share in FASTER])
        people = problem.people
        met = ([x for x in column if x is not None] for column in zip(*late, strict=True))
        shares = [f"{np.mean(column):.0%}" if column else "-" for column in met]
        row = (problem.name, f"{people.speed:g}", "contact" if people.contact else "none", len(late))
        reached += int((np.array(least) <= 0).sum())
        row = (*row, f"{np.median(durations):.2f}", len(least), int((np.array(least) <= 0).sum()))
        own_proven = ("no" if found is None else "yes" for found in own)
        rows.append((*row, f"{1e3 * min(least):.2f}", *shares, *own_proven))
    header = ("scenario", "m/s", "allowed", "splines", "duration [s]", "stops", "reached", "least left [mm]")
    faster = (f"reached, {share:g} x as fast" for share in FASTER)
    report.table((*header, *faster, "own trajectory proven", "1 % slower"), rows)
    report.counted("the same of motions that others made", sum(row[5] for row in rows), reached)
    return int(reached > 0)


STOPS_OF_EACH, _LONGEST, _CLOSE = 25, 40.0, 1.01


def random_spline(problem: Problem, rng: np.random.Generator) -> FloatArray:
    """Return control points of a clamped spline near the problem's path: way points (N, n) for evenly spaced knots."""
    path = problem.path
    steps = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    at = np.sort(rng.uniform(0, steps[-1], int(rng.integers(3, 8))))
    points = np.stack([np.interp(at, steps, joint) for joint in path.T], axis=1)
    found = points + rng.normal(scale=0.15, size=points.shape)
    return np.clip(found, problem.robot.lower + 0.05, problem.robot.upper - 0.05)


def paced(problem: Problem, points: FloatArray, duration: float) -> Motion:
    """Return the spline through way points that takes so long [s]."""
    times = np.linspace(0.0, duration, len(points))
    return Motion.of(CubicSpline(times, points, bc_type="clamped"), names=problem.robot.joint_names)


def slowed(motion: Motion, factor: float) -> Motion:
    """Return a motion that takes so many times as long."""
    return replace(motion, times=factor * motion.times)


def proven(problem: Problem, motion: Motion) -> Stops | None:
    """Return the stops of a motion that are proven; none if they or its rates are not."""
    if any(v.kind != "position" for v in rate_violations(motion, problem.robot, problem.limits)):
        return None
    found = stops_of(motion, problem.proof, problem.limits, problem.people)
    return found if found.left.min() >= 0 else None


def fastest_proven(problem: Problem, points: FloatArray) -> tuple[float, Stops] | None:
    """Return the shortest duration that is proven, to 1 %, with its stops; none where rates limit it, or nothing is."""
    low, high = 0.5, _LONGEST
    best = proven(problem, paced(problem, points, high))
    if best is None:
        return None
    while high > _CLOSE * low:
        middle = float(np.sqrt(low * high))
        found = proven(problem, paced(problem, points, middle))
        low, high, best = (middle, high, best) if found is None else (low, middle, found)
    motion = paced(problem, points, low)
    return (
        None
        if any(v.kind != "position" for v in rate_violations(motion, problem.robot, problem.limits))
        else (high, best)
    )


def is_reached(problem: Problem, points: FloatArray, duration: float, adversary: Adversary) -> bool | None:
    """Return whether the adversary reaches a motion that is not proven, in stops that have least left; none: it is."""
    motion = paced(problem, points, duration)
    found = stops_of(motion, problem.proof, problem.limits, problem.people)
    if found.left.min() >= 0:
        return None
    begins = found.cells.edges[:-1][np.argsort(found.left)[:20]] + 1e-9
    return any(adversary.stopped(MotionStop(motion, found, begin))[0] <= 0 for begin in begins.tolist())


PARTS = {"stops": stops, "motions": motions}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--stops", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--motions", type=int, default=1400, help="stops of others' motions")
