"""How fast a robot is, and gaps close in which a limb may be clamped, by plain means.

A gap is between a moving body and an obstacle that is no person, or between two bodies that joints move against each
other. Both sides hang on a carrier: what all joints move that move both, or the base. Relative to the carrier a point
of a side is no faster than the joints between make it. Two points approach each other by no more than the sum of both
sides, for the motion of the carrier changes no distance; and by no more than the sum of their speeds in the world.

A limb fits where the distance is no more than its thickness. In an interval the distance is not less than that at the
middle, less half the length times the bound of how fast the gap closes.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

import coal
import numpy as np

from safe_ompl.certificates.verifier.bodies import GJK, PlainSpeeds, Separations, corners
from safe_ompl.certificates.verifier.motion import PlainMotion, PlainPiece
from safe_ompl.common import FloatArray, IntArray
from safe_ompl.geometry import Person
from safe_ompl.robot import Robot
from safe_ompl.scene import Scene

_PARTS = 4  # of a cell, for the bounds over whole cells
_SLENDER = ("upper_arm", "forearm", "hand", "thigh", "shank", "foot", "head")


def thicknesses(scene: Scene, name: str) -> dict[str, float]:
    """Return how thick the parts of somebody are [m]; infinite for what is no limb of a person.

    It is the diameter of their capsules, and of all parts of the trunk the breadth of the shoulders of somebody as
    tall who stands.
    """
    somebody = scene[name].shape
    if not isinstance(somebody, Person):
        return {part: inf for part, _, _ in scene[name].geometries()}
    shoulders = next(part.geometry for part in Person(somebody.height).parts() if part.name == "shoulders")
    breadth = 2.0 * (shoulders.halfLength + shoulders.radius)
    found = {}
    for part, shape, _ in scene[name].geometries():
        limb = part[len(name) + 1 :]
        found[part] = 2.0 * shape.radius if limb.endswith(_SLENDER) else breadth if limb else inf
    return found


def ball(shape: coal.CollisionGeometry) -> tuple[FloatArray, float]:
    """Return the centre (3,) and the radius of a ball that holds a shape, in its frame [m]."""
    points, pad = corners(shape)
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max()) + pad


class PlainGaps:
    """Gaps of a robot in a scene without people, and how fast they close.

    Parameters
    ----------
    robot : Robot
        The robot.
    scene : Scene
        Where everything is.
    who : sequence of str
        Obstacles that are people: no gaps are between these and the robot.
    """

    def __init__(self, robot: Robot, scene: Scene, who: tuple[str, ...]) -> None:
        self._speeds = speeds = PlainSpeeds(robot)
        links = list(robot.shared.collision_model.geometryObjects)
        obstacles = [
            (shape, coal.Transform3s(place.rotation, place.translation))
            for obstacle in scene
            if obstacle.name not in who
            for _, shape, place in obstacle.geometries()
        ]
        self._links, self._obstacles = links, obstacles
        still = [coal.Transform3s.Identity()] * len(links) + [pose for _, pose in obstacles]
        shapes = [link.geometry for link in links] + [shape for shape, _ in obstacles]
        balls = [ball(shape) for shape in shapes]
        # Those of links in their own frames, those of obstacles in the world.
        centres = [at.transform(centre) for at, (centre, _) in zip(still, balls, strict=True)]
        self._centres, self._radii = (
            np.array(centres).reshape(-1, 3),
            np.array([radius for _, radius in balls]),
        )
        pairs: list[tuple[int, int]] = []  # bodies, and obstacles after them
        sides_of_pairs: list[tuple[int, int]] = []  # in `_relative`; −1: it hangs on the base
        self._relative: list[tuple[int, list[int]]] = []  # links, and joints that move them alone
        known: dict[tuple[int, tuple[int, ...]], int] = {}

        def side(of: int, other: int) -> int:
            mine = speeds.links[of].movers if of < len(links) else []
            others = speeds.links[other].movers if other < len(links) else []
            own = tuple(joint for joint in mine if joint not in others)
            if not own:
                return -1
            if (of, own) not in known:
                known[of, own] = len(self._relative)
                self._relative.append((of, list(own)))
            return known[of, own]

        for a in range(len(links)):
            for b in range(a + 1, len(links) + len(obstacles)):
                sides = side(a, b), side(b, a)
                if sides != (-1, -1):
                    pairs.append((a, b))
                    sides_of_pairs.append(sides)
        self._pairs: IntArray = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        self._sides: IntArray = np.array(sides_of_pairs, dtype=np.intp).reshape(-1, 2)

    def closing(self, motion: PlainMotion, widths: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds by arc length in the C cells of a motion [m/rad].

        They are those of the speed of all points (C,), and of how fast gaps close (C, K) that are no wider than
        `widths: (K,)`.
        """
        swiftness, found = np.zeros(len(motion.of)), np.zeros((len(motion.of), len(widths)))
        for j, number in enumerate(motion.of):
            edges = np.linspace(motion.edges[j], motion.edges[j + 1], _PARTS + 1) - motion.starts[number]
            half = float(edges[1] - edges[0]) / 2
            for middle in ((edges[1:] + edges[:-1]) / 2).tolist():
                world = self._speeds.each(motion.pieces[number], middle, half)
                swiftness[j] = max(swiftness[j], world.max())
                gaps = self._closing(motion.pieces[number], middle, half, widths, world[:-1])
                found[j] = np.maximum(found[j], gaps)
        return swiftness, found

    def _closing(
        self, piece: PlainPiece, middle: float, half: float, widths: FloatArray, world: FloatArray
    ) -> FloatArray:
        """Return the same (K,) of an interval in which links are no faster than `world` [m/rad]."""
        world = np.append(world, np.zeros(len(self._obstacles)))
        own = np.append(self._speeds.of_movers(piece, middle, half, self._relative), 0.0)
        rates = np.minimum(own[self._sides].sum(axis=1), world[self._pairs].sum(axis=1))
        # Whatever is of no known thickness may be caught in any gap.
        found = np.where(np.isinf(widths), rates.max(initial=0.0), 0.0)
        left = np.where(np.isinf(widths), -inf, widths)
        places = [self._speeds.place_of(link) for link in self._links]
        sides_of = [*zip((link.geometry for link in self._links), places, strict=True), *self._obstacles]
        nearest, widest = self._balls_apart(places) - half * rates, left.max(initial=-inf)
        for p in np.argsort(-rates).tolist():  # the first one that a limb fits in says how fast
            if widest == -inf or rates[p] <= 0:
                break
            if nearest[p] > widest:
                continue
            a, b = self._pairs[p].tolist()
            apart = Separations.distance(*sides_of[a], *sides_of[b]) - GJK - half * float(rates[p])
            fits = apart <= left
            found[fits], left[fits] = rates[p], -inf
            widest = left.max()
        return found

    def _balls_apart(self, places: list[coal.Transform3s]) -> FloatArray:
        """Return the distances (P,) of the balls about both bodies of each pair, links in their places [m]."""
        a, b = self._pairs.T
        centres = self._centres.copy()
        for k, place in enumerate(places):
            centres[k] = place.transform(centres[k])
        between = centres[a] - centres[b]
        found: FloatArray = np.sqrt((between * between).sum(axis=1)) - self._radii[a] - self._radii[b] - GJK
        return found


def slowest(
    contact: Mapping[str, tuple[float, ...]],
    robot: Robot,
    scene: Scene,
    who: tuple[str, ...],
    motion: PlainMotion,
) -> dict[str, FloatArray]:
    """Return for each part ṡ (C,) in the cells of a motion at which contact and clamping are as slow as is claimed."""
    thick = {part: width for name in who for part, width in thicknesses(scene, name).items()}
    widths = np.unique([thick[part] for part in contact])
    swiftness, closing = PlainGaps(robot, scene, who).closing(motion, widths)
    with np.errstate(divide="ignore", invalid="ignore"):
        return {
            part: np.fmin(free / swiftness, clamped / closing[:, np.searchsorted(widths, thick[part])])
            for part, (free, clamped) in contact.items()
        }
