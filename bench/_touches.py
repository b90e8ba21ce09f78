"""A judge of contacts: how fast the robot is where it touches people, and how fast gaps close on them."""

from __future__ import annotations

from math import sqrt

import numpy as np
import pinocchio as pin

from bench._plain import fresh_data
from safe_ompl import People, Robot, Scene
from safe_ompl.common import FloatArray
from safe_ompl.live.simulation import ContactMonitor, NearestLimb, Solid

TRUNK = ("neck", "shoulders", "torso", "hips", "left_flank", "right_flank")
DIAMETERS = {"upper_arm": 0.056, "forearm": 0.048, "hand": 0.048, "thigh": 0.09, "shank": 0.064, "foot": 0.044}
SHOULDERS = 0.304  # breadth of the trunk; all as shares of the height
MOST = 10.0  # [m] no gap is wider


class Bearable:
    """What limbs bear [m/s], by the formulas: F/√(m_H K), and where they are clamped (F/2)/√(m_R K)."""

    def __init__(self, robot: Robot, people: People) -> None:
        moving = sum(inertia.mass for inertia in list(robot.shared.model.inertias)[1:])
        self._clamping = moving / 2
        self._people = people

    def speeds(self, limb: str) -> tuple[float, float]:
        """Return the speed in a transient contact, and the one at which a gap may close on the limb."""
        if not self._people.contact:
            return 0.0, 0.0
        force, mass, stiffness = self._people.region_of(limb)
        return force / sqrt(1e3 * stiffness * mass), force / 2 / sqrt(1e3 * stiffness * self._clamping)


def thickness(limb: str, height: float) -> float:
    """Return how thick a limb is [m]; the head bears nothing, and is as thick as the trunk."""
    return height * (SHOULDERS if limb in (*TRUNK, "head") else DIAMETERS[limb.split("_", 1)[1]])


class Gaps:
    """Gaps between the links of a robot, and between them and what stands still, and how fast they close."""

    def __init__(self, robot: Robot, still: Scene) -> None:
        self._robot, self._model = robot, robot.shared.model
        self._geometry = robot.shared.collision_model.copy()
        self._geometry.removeAllCollisionPairs()
        for obstacle in still:
            for part, shape, place in obstacle.geometries():
                self._geometry.addGeometryObject(pin.GeometryObject(f"still {part}", 0, place, shape))
        self.joints = [body.parentJoint for body in self._geometry.geometryObjects]
        self.names = [body.name for body in self._geometry.geometryObjects]
        for a, first in enumerate(self.joints):
            for b in range(a + 1, len(self.joints)):
                if first != self.joints[b]:
                    self._geometry.addCollisionPair(pin.CollisionPair(a, b))
        self.pairs = [(pair.first, pair.second) for pair in self._geometry.collisionPairs]
        self._kinematics, self._data = self._model.createData(), fresh_data(self._geometry)

    def place(self, q: FloatArray, qd: FloatArray) -> None:
        """Put the robot at a configuration with joint velocities, both (n,)."""
        full = self._robot.pinocchio_configuration(q)
        pin.forwardKinematics(self._model, self._kinematics, full, self._robot.coupling.motions(qd))
        pin.updateGeometryPlacements(self._model, self._kinematics, self._geometry, self._data)

    def closing(self, widths: FloatArray, link: str = "") -> FloatArray:
        """Return how fast (K,) a gap closes at most, of all (of a link) no wider than each of `widths: (K,)` [m/s]."""
        pin.computeDistances(self._geometry, self._data)
        widest, found, twists = widths.max(), np.zeros(len(widths)), self._twists()
        for (a, b), result in zip(self.pairs, self._data.distanceResults, strict=True):
            width = result.min_distance
            if not 1e-6 < width <= widest:
                continue
            if link and link not in (self.names[a].rsplit("_", 1)[0], self.names[b].rsplit("_", 1)[0]):
                continue
            p, q = result.getNearestPoint1(), result.getNearestPoint2()
            # (ω × p)·d = ω·(p × d), and p × d = p × q = q × d for d = q - p.
            line = np.append(q - p, (p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]))
            speed = float((twists[a] - twists[b]) @ line) / width
            found[width <= widths] = np.maximum(found[width <= widths], speed)
        return found

    def _twists(self) -> FloatArray:
        """Return the twists (B, 6) of all bodies, velocity at the origin and angular velocity, in the world's frame."""
        known = self._kinematics
        of_joints = [known.oMi[k].act(known.v[k]).vector if k else np.zeros(6) for k in range(self._model.njoints)]
        return np.array(of_joints)[self.joints]


class TouchJudge(ContactMonitor):
    """A contact monitor that compares every contact of a robot that moves with what the limb bears.

    Attributes
    ----------
    fastest, closing : float
        The robot's speed in a contact, and that of a gap of the link in which the limb fits, over what the limb bears.
    too_fast, clamped : int
        How often these were above 1, at instants of the monitor.
    relative : float
        The largest speed of robot and limb together in a contact [m/s].
    """

    def __init__(self, robot: Robot, still: Scene, people: People, height: float) -> None:
        super().__init__(robot)
        self._bearable, self._gaps, self._height = Bearable(robot, people), Gaps(robot, still), height
        self.fastest = self.closing = self.relative = 0.0
        self.clamped = self.too_fast = 0
        self._before: tuple[float, dict[str, FloatArray]] = -np.inf, {}

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
        """Judge one instant."""
        nearest = super().observe(time, q, solids, moving=moving, obeyed=obeyed, qd=qd)
        places = {solid.limb: np.asarray(solid.placement.translation) for solid in solids}
        if nearest.distance <= 0 and moving and obeyed and qd is not None:
            self._gaps.place(q, qd)
            touches = self.touches(q, qd, solids)
            for touch in touches:
                free, clamped = self._bearable.speeds(touch.limb)
                share = touch.speed / max(free, 1e-9)
                width = np.array([thickness(touch.limb, self._height)])
                closes = float(self._gaps.closing(width, touch.link)[0]) / max(clamped, 1e-9)
                self.fastest, self.closing = max(self.fastest, share), max(self.closing, closes)
                self.too_fast += share > 1
                self.clamped += closes > 1
                since = time - self._before[0]
                if 0 < since < 0.02 and touch.limb in self._before[1]:
                    person = np.linalg.norm(places[touch.limb] - self._before[1][touch.limb]) / since
                    self.relative = max(self.relative, touch.speed + float(person))
        self._before = time, places
        return nearest
