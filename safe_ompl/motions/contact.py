"""Contact with people: the largest speeds at which the robot may touch a limb, and at which it may clamp a limb.

In a *transient* contact the limb yields. A point of the robot that touches the limb may have the speed v = F/√(m_H K),
from the largest force, the mass and the stiffness of the body region. The robot counts as infinitely heavy. Then F is
proven for any action of the motors: a mass m behind a spring K is pushed by a point with speed ẋ ≤ v, and c ≥ 0 is the
compression. In the frame that moves with v, the energy ½Kc² + ½m(v − ẏ)² changes by Kc(ẋ − v) ≤ 0. Its initial value is
½mv² if the mass is at rest first, so Kc ≤ v√(mK). The speed is that of the robot at the point of contact. The speed of
the person is not counted.

A limb is *clamped* between a body of the robot and a partner (`docs/how-it-works.md` §9). It cannot yield: half of the
force is allowed, with the mass m_R, half of the mass of the robot's links, which is the published choice. An infinite
mass would forbid all motion there. The thickness of arms, hands, legs and feet is the diameter of their capsule, that
of the trunk its breadth across the shoulders. Not covered are limbs held lengthwise, several limbs in a row, and
another person as the partner.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from math import inf

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, IntArray
from safe_ompl.geometry import LIMBS, STANDING, ConvexBodies
from safe_ompl.motions.bodies import ClosingGaps
from safe_ompl.robot import Robot, plain
from safe_ompl.scene import BodyRegion, People, Scene

CONTACT_RULES = SEPARATION, CONTACT, CLAMPING = "separation", "contact", "clamping"
_TRUNK = ("neck", "shoulders", "torso", "hips", "left_flank", "right_flank")
# A body that moves less than this per radian of the path stands still.
_NEGLIGIBLE_SPEED = 1e-12  # [m/rad]


def contact_speed(region: BodyRegion, clamped_by: float | None = None) -> float:
    """Return the speed [m/s] at which contact with a body region stays below its force limit.

    The speed is F/√(m_H K). If a robot of an effective mass m_R [kg] clamps the region, the speed is (F/2)/√(m_R K).
    """
    mass, force = (region.mass, region.force) if clamped_by is None else (clamped_by, region.force / 2)
    return float(force / np.sqrt(mass * 1e3 * region.stiffness))


def limb_thickness(limb: str, height: float) -> float:
    """Return the thickness [m] of a limb of a person of the given height [m]; infinite for unknown limbs."""
    if limb in _TRUNK:
        across = float(np.linalg.norm(STANDING["left_shoulder"] - STANDING["right_shoulder"]))
        return height * (across + 2 * LIMBS["shoulders"][2])
    return 2 * LIMBS[limb][2] * height if limb in LIMBS else np.inf


class ContactLimits:
    """Largest path velocities at which a robot may touch M limbs of people, proven over whole cells.

    Limbs are pairs (person, limb). They may be clamped against bodies that stand still, or anywhere with
    `always_clamped`, such as beside moving obstacles. Persons without a height [m] in `heights` must not be touched.
    `bears` (M,) [m/s] is the largest speed of a point of the robot that touches a limb, `bears_clamped` (M,) [m/s] the
    largest closing speed of a gap that clamps a limb. `thickness: (M,)` [m] is that of the limbs.
    """

    def __init__(
        self,
        robot: Robot,
        still: Scene,
        people: People,
        limbs: Sequence[tuple[str, str]],
        heights: Mapping[str, float],
        *,
        always_clamped: bool = False,
    ) -> None:
        self.limbs = tuple(limbs)
        links = sum(inertia.mass for inertia in list(robot.shared.model.inertias)[1:])
        if links <= 0:
            raise InputError("needs the masses of the robot's links, but the URDF has none", "people.contact")
        regions = [people.region_of(limb) if who in heights else None for who, limb in limbs]
        self.bears, self.bears_clamped = (
            np.array([0.0 if region is None else contact_speed(region, mass) for region in regions])
            for mass in (None, float(links / 2))
        )
        self.thickness: FloatArray = np.array([limb_thickness(limb, heights.get(who, np.inf)) for who, limb in limbs])
        self._coupling, self._always = robot.coupling, always_clamped
        parts = [part for obstacle in still for part in obstacle.geometries()]
        obstacles = [pin.GeometryObject(name, 0, place, shape) for name, shape, place in parts]
        bodies = robot.bounds.convex_bodies.joined(ConvexBodies.of(obstacles))
        joints = bodies.bodies["joint"].tolist()
        moving = [k for k, joint in enumerate(joints) if joint != 0]
        pairs = [(a, b) for a, b in product(moving, range(len(joints))) if joints[a] != joints[b]]
        pair_bodies: IntArray = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        of_joints = np.zeros((len(joints), robot.bounds.joint_radii.shape[1]))
        of_joints[: len(robot.bounds.joint_radii)] = robot.bounds.joint_radii
        first, second = of_joints[pair_bodies[:, 0]], of_joints[pair_bodies[:, 1]]
        radii = np.where(second > 0, 0.0, first) + np.where(first > 0, 0.0, second)
        sides = np.full(len(joints), len(moving), dtype=np.intp)
        sides[moving] = np.arange(len(moving))
        touched = self.bears > 0
        shares = np.divide(self.bears_clamped, self.bears, out=np.full(len(limbs), inf), where=touched)
        widths, self._width_of = np.unique(self.thickness, return_inverse=True)
        harmless = np.full(len(widths), inf)
        np.minimum.at(harmless, self._width_of, shares)
        tables = robot.kinematics.table, bodies.table
        self._gaps = ClosingGaps(*tables, np.sort(pair_bodies, axis=1), sides[pair_bodies], radii, widths, harmless)

    def speeds(
        self, Q: FloatArray, sizes: FloatArray, dq_ds: FloatArray, bodies: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the largest ṡ (N, G, M) at which body g may touch limb m in each cell, and the same without clamping.

        `Q: (N, n)` are the configurations at the centres of the cells, `sizes` (N,) their lengths [rad], `dq_ds` (N, n)
        bounds of |q′|, and `bodies: (N, G)` bounds of the speeds of points of moving bodies [m/rad].
        """
        free = self.bears / np.maximum(bodies, _NEGLIGIBLE_SPEED)[:, :, None]
        if self._always:
            return np.minimum(self.bears_clamped / np.maximum(bodies, _NEGLIGIBLE_SPEED)[:, :, None], free), free
        speeds = np.zeros((len(Q), bodies.shape[1] + 1))
        speeds[:, :-1] = bodies
        values, reach = plain(self._coupling.values(Q)), plain(self._coupling.reach(dq_ds))
        rates = self._gaps.rates(values, plain(sizes), reach, speeds)
        slow = self.bears_clamped / np.maximum(rates, _NEGLIGIBLE_SPEED)[:, :, self._width_of]
        return np.minimum(slow, free), free
