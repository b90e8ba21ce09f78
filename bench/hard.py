"""Hard problems: whether keeping away from danger ever costs a solution, and what it costs in time.

112 narrow openings of seven kinds for four robots, made by rule from a seed. An arm is drawn at random with its hand at
a place, and drawn back along its last link: the way out. Then an opening is built around that way, as wide as what
passes through it and a few millimetres more, of one of several kinds. The way out, and the straight motion from its
end to the start, are proven free among what was built; a draw whose way is not is drawn anew. So each problem is
solvable, and no draw is left out. Tables are those of `planners`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pinocchio as pin

from bench._harness import Report
from bench._planning import Problem, add_options as add_planning_options, compare
from safe_ompl import CollisionChecker, MotionProver, Obstacle, Pose, Robot, SafeSetup, Scene
from safe_ompl.common import FloatArray
from safe_ompl.geometry import Box, Capsule, Shape, bounding_hull
from safe_ompl.robot.ik import TargetPose, approach

CLAIM = "safe planners solve as many narrow problems as their classical counterparts"
COUNT = 112
ROBOTS = ("panda", "ur5", "xarm7", "z1")
_STEP = 0.01  # [m] of the hand between two configurations of the way out
_JUMP = 0.25  # [rad] larger steps of the joints on it are another posture
_STARTS = 40  # tried for each way out
_FAR = 1.2  # [rad] from the end of the way out to the start, at least
_THICK = 0.015  # [m] of plates
_BAR = 0.008  # [m] radius of bars
_WIDE = 0.25  # [m] plates and bars reach this far beyond an opening
_SPARE = (0.004, 0.015)  # [m] between the opening and what passes through it
_BOTH_ENDS = 0.3  # share of the problems whose start is in an opening, too
_FLOOR = Obstacle("floor", Box((3.0, 3.0, 0.02)), Pose((0.0, 0.0, -0.06)))


@dataclass(frozen=True)
class _Opening:
    """Where an opening is, and what must pass: its frame looks along z into it, the hand's tip at its origin."""

    frame: pin.SE3
    low: FloatArray  # (2,) corners of what passes, across
    high: FloatArray
    front: float  # [m] along z
    back: float


Piece = tuple[Shape, pin.SE3]
Builder = Callable[[_Opening, np.random.Generator], Iterator[Piece]]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    add_planning_options(parser, 5.0)


def main(options: argparse.Namespace, report: Report) -> None:
    """Compare the planners."""
    compare(report, problems(range(COUNT)[options.problems]), options)


def problems(numbers: Iterable[int]) -> Iterator[Problem]:
    """Yield the problems of these numbers; robots and kinds take turns. The tip's place at the goal is a goal, too."""
    built = {name: Robot.from_example(name) for name in ROBOTS}
    kinds = tuple(KINDS)
    for k in numbers:
        robot = built[ROBOTS[k % len(ROBOTS)]]
        kind = kinds[(k // len(ROBOTS)) % len(kinds)]
        rng = np.random.default_rng((0, k))
        setup = None
        while setup is None:
            setup = _draw(robot, kind, rng)
        yield Problem(kind, setup)


def _draw(robot: Robot, kind: str, rng: np.random.Generator) -> SafeSetup | None:
    checker = CollisionChecker(robot, Scene((_FLOOR,)))
    way = _way_out(robot, checker, rng)
    if way is None:
        return None
    pieces = _pieces(robot, kind, way, rng)
    obstacles = [_FLOOR, *_placed(pieces, "goal")]
    back: FloatArray | None = None
    if rng.random() < _BOTH_ENDS:
        other = tuple(KINDS)[int(rng.integers(len(KINDS)))]
        back = _way_out(robot, checker, rng)
        if back is None:
            return None
        obstacles += _placed(_pieces(robot, other, back, rng), "start")
    scene = Scene(tuple(obstacles))
    motion = MotionProver(CollisionChecker(robot, scene))
    if not _proven(motion, way):
        return None
    witness = _to_start(robot, motion, way, rng) if back is None else _joined(robot, motion, back, way, rng)
    if witness is None:
        return None
    setup = SafeSetup(robot, scene)
    setup.setConfigurations(witness[0], witness[-1])
    setup.setWorkspaceGoal(robot.tip_pose(witness[-1]).translation)
    return setup


def _way_out(robot: Robot, checker: CollisionChecker, rng: np.random.Generator) -> FloatArray | None:
    """Return configurations (N, n) from outside to inside: the hand is drawn back along its last link."""
    q = rng.uniform(robot.lower, robot.upper)
    tip = robot.tip_pose(q)
    reach = float(robot.bounds.keypoint_reaches(np.zeros((1, 3))).max())
    out = float(np.hypot(*tip.translation[:2]))
    if not (0.25 * reach < out < 0.6 * reach and 0.1 < tip.translation[2] < 0.7 * reach):
        return None
    if checker.in_collision(q):
        return None
    inwards = _last_link(robot, q)
    if inwards[:2] @ tip.translation[:2] < 0.3 * out:  # it points away from the base
        return None
    way = [q]
    for k in range(1, 1 + int(rng.uniform(0.18, 0.32) / _STEP)):
        place = TargetPose(robot, tip.translation - k * _STEP * inwards, tip.rotation)
        found, distance = approach(place, way[-1], 1e-5)
        if distance > 1e-5 or np.abs(robot.difference(way[-1], found)).max() > _JUMP:
            return None
        way.append(found)
    return np.array(way[::-1])


def _last_link(robot: Robot, q: FloatArray) -> FloatArray:
    points = robot.keypoints(q)
    for other in points[-2::-1]:
        step = points[-1] - other
        length = float(np.linalg.norm(step))
        if length > 0.02:
            direction: FloatArray = step / length
            return direction
    raise ValueError(f"{robot.name} has no last link")


def _pieces(robot: Robot, kind: str, way: FloatArray, rng: np.random.Generator) -> list[Piece]:
    """Return an opening of a kind around the way (N, n) into it."""
    tip, inwards = robot.tip_pose(way[-1]), _last_link(robot, way[-1])
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), inwards).toRotationMatrix()
    about = rng.uniform(-np.pi, np.pi)
    spin = pin.AngleAxis(about, np.array([0.0, 0.0, 1.0])).matrix()
    frame = pin.SE3(turn @ spin, tip.translation)
    travel = float(np.linalg.norm(robot.tip_pose(way[0]).translation - tip.translation))
    front = -rng.uniform(0.3, 0.6) * travel
    points = np.concatenate([_body_points(robot, q) for q in way]) - frame.translation
    local = points @ frame.rotation
    inside = local[local[:, 2] > front - 0.02]
    spare = rng.uniform(*_SPARE)
    opening = _Opening(
        frame,
        inside[:, :2].min(axis=0) - spare,
        inside[:, :2].max(axis=0) + spare,
        front,
        float(inside[:, 2].max()) + spare,
    )
    return [(shape, frame * place) for shape, place in KINDS[kind](opening, rng)]


def _body_points(robot: Robot, q: FloatArray) -> FloatArray:
    """Return points (P, 3) whose hull holds the moving bodies at `q` [m]."""
    data = robot.shared.model.createData()
    pin.forwardKinematics(robot.shared.model, data, robot.pinocchio_configuration(q))
    found = []
    for part in robot.shared.collision_model.geometryObjects:
        if part.parentJoint:
            hull = bounding_hull(part.geometry).moved(part.placement)
            pose = data.oMi[part.parentJoint]
            points = hull.points @ pose.rotation.T + pose.translation
            found.append(points)
            if hull.radius:
                found += [points + side * hull.radius * axis for axis in np.eye(3) for side in (-1, 1)]
    return np.concatenate(found)


# --------------------------------------------------------------------------------------------- kinds of opening


def _plate(low: tuple[float, float, float], high: tuple[float, float, float]) -> Piece:
    size = tuple(float(b - a) for a, b in zip(low, high, strict=True))
    middle = np.array([(a + b) / 2 for a, b in zip(low, high, strict=True)])
    return Box(size), pin.SE3(np.eye(3), middle)


def _bar(start: FloatArray, end: FloatArray) -> Piece:
    axis = end - start
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).toRotationMatrix()
    return Capsule(_BAR, float(np.linalg.norm(axis))), pin.SE3(turn, (start + end) / 2)


def _walls(opening: _Opening, back: float) -> Iterator[Piece]:
    (x0, y0), (x1, y1), z0, t = opening.low, opening.high, opening.front, _THICK
    yield _plate((x0 - t, y0 - t, z0), (x0, y1 + t, back))
    yield _plate((x1, y0 - t, z0), (x1 + t, y1 + t, back))
    yield _plate((x0, y0 - t, z0), (x1, y0, back))
    yield _plate((x0, y1, z0), (x1, y1 + t, back))


def _shelf(opening: _Opening, rng: np.random.Generator) -> Iterator[Piece]:
    """Build a deep compartment: four walls and a back."""
    back = opening.back + rng.uniform(0.0, 0.05)
    yield from _walls(opening, back)
    (x0, y0), (x1, y1) = opening.low, opening.high
    yield _plate((x0 - _THICK, y0 - _THICK, back), (x1 + _THICK, y1 + _THICK, back + _THICK))


def _tube(opening: _Opening, rng: np.random.Generator) -> Iterator[Piece]:
    """Build a tube of many flat staves."""
    middle, count = (opening.low + opening.high) / 2, int(rng.integers(7, 12))
    radius = float(np.linalg.norm(opening.high - opening.low)) / 2
    width = 2.05 * (radius + _THICK) * np.tan(np.pi / count)
    for k in range(count):
        angle = 2 * np.pi * k / count
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        place = (radius + _THICK / 2) * out + [*middle, (opening.front + opening.back) / 2]
        turn = pin.AngleAxis(angle, np.array([0.0, 0.0, 1.0])).matrix()
        yield Box((_THICK, width, opening.back - opening.front)), pin.SE3(turn, place)


def _slot(opening: _Opening, rng: np.random.Generator) -> Iterator[Piece]:
    """Build a wall with one long slot."""
    (x0, y0), (x1, y1) = opening.low - _WIDE, opening.high + _WIDE
    z0, z1 = opening.front, opening.front + rng.uniform(0.02, 0.06)
    yield _plate((x0, y0, z0), (opening.low[0], y1, z1))
    yield _plate((opening.high[0], y0, z0), (x1, y1, z1))


def _window(opening: _Opening, rng: np.random.Generator) -> Iterator[Piece]:
    """Build a wall with one window."""
    yield from _slot(opening, rng)
    (x0, y0), (x1, y1) = opening.low, opening.high
    z0, z1 = opening.front, opening.front + 0.03
    yield _plate((x0, y0 - _WIDE, z0), (x1, y0, z1))
    yield _plate((x0, y1, z0), (x1, y1 + _WIDE, z1))


def _bars(opening: _Opening, rng: np.random.Generator) -> Iterator[Piece]:
    """Build a grate of parallel bars, through two of which the hand must go."""
    width = float(opening.high[0] - opening.low[0]) + 2 * _BAR
    middle = float(opening.high[0] + opening.low[0]) / 2
    (_, y0), (_, y1) = opening.low - _WIDE, opening.high + _WIDE
    for k in range(-3, 3):
        x = middle + (k + 0.5) * width
        yield _bar(np.array([x, y0, opening.front]), np.array([x, y1, opening.front]))


def _cage(opening: _Opening, rng: np.random.Generator) -> Iterator[Piece]:
    """Build a cage: bars along all sides, and behind; the front is open."""
    (x0, y0), (x1, y1) = opening.low - _BAR, opening.high + _BAR
    z0, z1 = opening.front, opening.back + _BAR
    spacing = rng.uniform(0.035, 0.06)
    for x in np.linspace(x0, x1, 2 + int((x1 - x0) / spacing)):
        for y in (y0, y1):
            yield _bar(np.array([x, y, z0]), np.array([x, y, z1]))
        yield _bar(np.array([x, y0, z1]), np.array([x, y1, z1]))
    for y in np.linspace(y0, y1, 2 + int((y1 - y0) / spacing))[1:-1]:
        for x in (x0, x1):
            yield _bar(np.array([x, y, z0]), np.array([x, y, z1]))


def _gap(opening: _Opening, rng: np.random.Generator) -> Iterator[Piece]:
    """Build two boxes, between which the hand is."""
    size = rng.uniform(0.1, 0.2)
    middle = float(opening.high[1] + opening.low[1]) / 2
    for low, high in ((opening.low[0] - size, float(opening.low[0])), (float(opening.high[0]), opening.high[0] + size)):
        yield _plate((low, middle - size, opening.front), (high, middle + size, opening.back))


KINDS: dict[str, Builder] = {
    "shelf": _shelf,
    "tube": _tube,
    "slot": _slot,
    "window": _window,
    "bars": _bars,
    "cage": _cage,
    "gap": _gap,
}


def _placed(pieces: list[Piece], name: str) -> list[Obstacle]:
    return [Obstacle(f"{name} {k}", shape, _pose(place), weight=1.0) for k, (shape, place) in enumerate(pieces)]


def _pose(place: pin.SE3) -> Pose:
    return Pose(tuple(place.translation.tolist()), tuple(pin.Quaternion(place.rotation).coeffs().tolist()))


# ---------------------------------------------------------------------------------------------------- witnesses


def _proven(motion: MotionProver, path: FloatArray) -> bool:
    return all(motion.is_free(a, b) for a, b in pairwise(path))


def _to_start(robot: Robot, motion: MotionProver, way: FloatArray, rng: np.random.Generator) -> FloatArray | None:
    """Return the way with a start before it from which a straight motion leads there."""
    for _ in range(_STARTS):
        start = rng.uniform(robot.lower, robot.upper)
        far = np.linalg.norm(robot.difference(start, way[0])) > _FAR
        if far and motion.is_free(start, way[0]):
            return np.concatenate([start[None], way])
    return None


def _joined(
    robot: Robot, motion: MotionProver, back: FloatArray, way: FloatArray, rng: np.random.Generator
) -> FloatArray | None:
    """Return the way out of one opening, through at most one configuration between, into the other."""
    out = back[::-1]
    if not _proven(motion, out):
        return None
    if motion.is_free(out[-1], way[0]):
        return np.concatenate([out, way])
    for _ in range(_STARTS):
        between = rng.uniform(robot.lower, robot.upper)
        if motion.is_free(out[-1], between) and motion.is_free(between, way[0]):
            return np.concatenate([out, between[None], way])
    return None
