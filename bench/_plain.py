"""A judge of anybody's motions: dense samples, Pinocchio and coal; it uses none of the package's proofs.

A motion is sampled every `SPACING` rad. A body moves no farther than each joint's motion times the length of the chain
from there to the body's far end; samples at which a pair cannot touch by that, as it was too far apart before, are left
out.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from safe_ompl import Motion, Robot, Scene
from safe_ompl.common import BoolArray, FloatArray, InputError, IntArray, polynomials

SPACING, COARSE = 0.0002, 0.01  # [rad] between samples, for contact and for means
ROUNDING = 1e-4  # [rad or m] by which a motion may miss its start and goal, or pass limits
NEAR = 0.05  # [m]
TOLERANCE = 2e-5  # [m] of coal's distances, and of clearances that are searched for
_MOST = 2_000_000  # samples of a motion


@dataclass(frozen=True)
class Worst:
    """Where two bodies are nearest [m], or deepest in each other: their distance is negative there."""

    distance: float
    link: str
    other: str  # An obstacle or another link
    q: tuple[float, ...]


@dataclass(frozen=True)
class Verdict:
    """What the samples of a motion show. Clearances are distances to obstacles, means over arc length."""

    touching: bool  # Whether a sample touches an obstacle or the robot itself
    min_clearance: float | None  # [m], None where there is no obstacle
    mean_clearance: float | None
    near: float  # Length that is nearer than 50 mm [rad]
    mean_danger: float | None  # The static danger field at its worst point; None where nothing is dangerous
    peak_danger: float | None
    integral_danger: float | None
    length: float  # [rad]
    outside: str  # Which joint leaves its limits, if one does
    worst: Worst


class PlainGeometry:
    """The bodies of a robot among obstacles, as Pinocchio and coal have them.

    `pairs` are all pairs of bodies that are checked: link, obstacle and its part; or link, "" and another link.
    """

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self.robot, self.model = robot, robot.shared.model
        self.geometry = robot.collision_model.copy()
        bodies = list(robot.collision_model.geometryObjects)  # those of the copy move in memory when some are added
        links = [body.name.rsplit("_", 1)[0] for body in bodies]
        self.pairs = [(links[pair.first], "", links[pair.second]) for pair in self.geometry.collisionPairs]
        for obstacle in scene:
            for part, shape, place in obstacle.geometries():
                number = self.geometry.addGeometryObject(pin.GeometryObject(f"{part}!", 0, place, shape))
                for k, body in enumerate(bodies):
                    if body.parentJoint:
                        self.geometry.addCollisionPair(pin.CollisionPair(k, number))
                        self.pairs.append((links[k], obstacle.name, part))
        chains = [self._chains(body) for body in self.geometry.geometryObjects]
        ends = np.array([(pair.first, pair.second) for pair in self.geometry.collisionPairs], dtype=np.intp)
        first, second = np.array(chains)[ends.reshape(-1, 2).T]
        # A joint that moves both bodies of a pair changes nothing between them.
        self._chains_of_pairs = np.where((first > 0) != (second > 0), first + second, 0.0)
        self.data, self._results = self.model.createData(), pin.GeometryData(self.geometry)
        # Without contacts coal misses some overlaps of cylinders.
        for request in self._results.collisionRequests:
            request.enable_contact = True

    def _chains(self, body: pin.GeometryObject) -> FloatArray:
        """Return how far (m,) the end of a body can be from each joint that moves it [m]; 1 where the joint slides."""
        model, found = self.model, np.zeros(self.model.njoints - 1)
        shape = body.geometry.clone()  # what is computed stays in the shape, and this one is the robot's
        shape.computeLocalAABB()
        far = float(np.linalg.norm(body.placement.act(shape.aabb_center))) + shape.aabb_radius
        joint = body.parentJoint
        while joint:
            slides = model.joints[joint].shortname().startswith("JointModelP")
            found[joint - 1] = 1.0 if slides else far
            if slides:
                at = model.joints[joint].idx_q
                far += float(np.abs([model.lowerPositionLimit[at], model.upperPositionLimit[at]]).max())
            far += float(np.linalg.norm(model.jointPlacements[joint].translation))
            joint = model.parents[joint]
        return found

    def distances(self, q: FloatArray) -> FloatArray:
        """Return the distance of every pair at `q: (n,)` [m]; negative where they overlap."""
        full = self.robot.pinocchio_configuration(q)
        pin.computeDistances(self.model, self.data, self.geometry, self._results, full)
        return np.array([result.min_distance for result in self._results.distanceResults])

    def touches(self, q: FloatArray) -> bool:
        """Return whether the robot touches anything, or itself, at `q: (n,)`."""
        full = self.robot.pinocchio_configuration(q)
        return bool(pin.computeCollisions(self.model, self.data, self.geometry, self._results, full, True))

    def least(self, Q: FloatArray, enough: float) -> tuple[float, int, int]:
        """Return the least distance [m] at configurations along a curve `Q: (S, n)`, its pair and its sample.

        The search ends at the first contact; above contact the distance is found to within `TOLERANCE`. Where none
        is below `enough`, that is returned, with the first pair and sample.
        """
        steps = np.abs(self.robot.coupling.motions(np.diff(Q, axis=0)))
        travelled = np.vstack([np.zeros(steps.shape[1]), np.cumsum(steps, axis=0)])
        due = np.zeros(len(self.pairs), dtype=np.intp)  # the next sample at which a pair is looked at
        best = enough, 0, 0
        while True:
            s = int(due.min(initial=len(Q)))
            if s >= len(Q):
                return best
            full = self.robot.pinocchio_configuration(Q[s])
            pin.updateGeometryPlacements(self.model, self.data, self.geometry, self._results, full)
            now = np.flatnonzero(due <= s + 50)
            measured = [pin.computeDistance(self.geometry, self._results, int(k)).min_distance for k in now]
            apart = np.array(measured)
            if apart.min() < best[0]:
                best = float(apart.min()), int(now[apart.argmin()]), s
            if apart.min() <= 0.0:
                return best
            moved = self._chains_of_pairs[now] @ (travelled[s + 1 : s + 1000] - travelled[s]).T
            room = apart - best[0] + (TOLERANCE if best[0] > TOLERANCE else 0.0)
            due[now] = s + 1 + np.count_nonzero(moved < room[:, None], axis=1)


class Judge:
    """Judges motions of a robot in a scene."""

    def __init__(self, robot: Robot, scene: Scene) -> None:
        self.robot = robot
        self.plain = PlainGeometry(robot, scene)
        self._obstacles: BoolArray = np.array([bool(obstacle) for _, obstacle, _ in self.plain.pairs])
        self._danger = scene.danger_points()[:2]

    def verdict(self, motion: Motion) -> Verdict:
        """Return what the samples of a motion show."""
        Q = samples(motion, SPACING)
        steps = np.diff(Q, axis=0)
        along = np.append(0.0, np.cumsum(np.linalg.norm(steps, axis=1)))
        length = float(along[-1])
        chosen = np.unique(np.searchsorted(along, np.append(np.arange(0.0, length, COARSE), length)))
        apart = np.array([self.plain.distances(Q[k]) for k in chosen])
        row, number = np.unravel_index(int(apart.argmin()), apart.shape)
        least = float(apart[row, number]), int(number), int(chosen[row])
        if least[0] > 0:
            finer = self.plain.least(Q, least[0])
            least = finer if finer[0] < least[0] else least
        pair = self.plain.pairs[least[1]]
        along, danger = along[chosen], self._dangers(Q[chosen])
        clearance = apart[:, self._obstacles].min(axis=1) if self._obstacles.any() else None
        nearest = np.inf if clearance is None else float(clearance.min())
        return Verdict(
            least[0] <= 0,
            None if clearance is None else min(nearest, least[0]) if pair[1] else nearest,
            None if clearance is None else _mean(clearance, along),
            0.0 if clearance is None else length * _mean((clearance < NEAR).astype(float), along),
            None if danger is None else _mean(danger, along),
            None if danger is None else float(danger.max()),
            None if danger is None else length * _mean(danger, along),
            length,
            self._outside(Q),
            Worst(least[0], pair[0], pair[1] or pair[2], tuple(Q[least[2]].tolist())),
        )

    def _outside(self, Q: FloatArray) -> str:
        over = np.maximum(self.robot.lower - Q, Q - self.robot.upper).max(axis=0)
        joint = int(np.where(self.robot.continuous, -np.inf, over).argmax())
        name = self.robot.joint_names[joint]
        return f"joint {name!r} is {over[joint]:.3g} outside its limits" if over[joint] > ROUNDING else ""

    def _dangers(self, Q: FloatArray) -> FloatArray | None:
        """Return the cumulative danger field (Lacevic & Rocco, eqs. 4, 5) at its worst point, for each of `Q`."""
        points, weights = self._danger
        if not len(points):
            return None
        worst = []
        for keys in self.robot.keypoints_batch(Q):
            a, b = keys[self.robot.segments[:, 0]], keys[self.robot.segments[:, 1]]
            ell = np.linalg.norm(b - a, axis=1)
            S = np.linalg.norm(points[:, None] - a, axis=2) + np.linalg.norm(points[:, None] - b, axis=2)
            worst.append((weights * (2 / ell * np.arctanh(ell / S)).sum(axis=1)).max())
        return np.array(worst)


def _mean(values: FloatArray, along: FloatArray) -> float:
    """Return the mean over arc length, by the trapezoid rule."""
    return float(np.trapezoid(values, along) / along[-1]) if along[-1] else float(values[0])


def sample_counts(motion: Motion, spacing: float) -> IntArray:
    """Return how many samples each piece needs so that they are no farther than a spacing [rad] apart.

    A piece moves no faster than its degree times the longest step between its Bernstein coefficients. Raises InputError
    if there would be more than two million.
    """
    steps = np.linalg.norm(np.diff(polynomials.bernstein(motion.coefficients), axis=1), axis=2)
    counts = np.maximum(np.ceil(motion.degree * steps.max(axis=1, initial=0.0) / spacing), 1.0)
    if counts.sum() > _MOST:
        raise InputError(f"may be longer than {_MOST * spacing:g} rad", "length")
    return np.asarray(counts, dtype=np.intp)


def samples(motion: Motion, spacing: float) -> FloatArray:
    """Return configurations (M, n) along a motion, its ends among them, no farther than a spacing [rad] apart."""
    pieces = zip(motion.times[:-1], motion.times[1:], sample_counts(motion, spacing), strict=True)
    times = [np.linspace(start, end, count + 1)[1:] for start, end, count in pieces]
    return motion.at(np.concatenate([motion.times[:1], *times]))


def fresh_data(geometry: pin.GeometryModel) -> pin.GeometryData:
    """Return memory in which no query starts from the result of another, which changes distances by micrometres."""
    data = pin.GeometryData(geometry)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # in favour of an option that Pinocchio overrides
        for request in (*data.collisionRequests, *data.distanceRequests):
            request.enable_cached_gjk_guess = False
    return data
