"""Contact with people: how fast the robot may be where it touches a limb, and where it may clamp one.

In a *transient* contact the limb yields. A point of the robot that touches it may be as fast as v = F/√(μK), with 1/μ =
1/m_H + 1/m_R: the largest force, mass and stiffness of the body region, and the robot's mass. By default the robot
counts as infinitely heavy, μ = m_H. Then F is proven whatever its motors do: let a mass m behind a spring K be pushed
by a point whose speed is ẋ ≤ v, and let c ≥ 0 be the compression. In the frame that moves with v the energy ½Kc² + ½m(v
− ẏ)² changes by Kc(ẋ − v) ≤ 0, and it is ½mv² where the mass is at rest first, so Kc ≤ v√(mK). A finite mass
would assume that the motors let go, but a position servo pushes on while the limb yields. What counts is the speed of
the robot where it touches; that of the person is not counted.

A limb is *clamped* if it touches a body of the robot and, on its other side, a partner: an obstacle, a part of the
robot that stands still, or a link that moves otherwise. It cannot yield: half of the force counts, and μ = m_R. There
the robot must stop or yield by itself when it touches, and m_R is half of its links' mass, the public choice. What
counts is how fast the gap closes. Two points of rigid bodies g and h, with velocity fields V_g and V_h, approach each
other by (V_g(p) − V_h(p))·n, because V_h changes no distance. So they approach by no more than

    w_gh = Σ_j R̄_gj |q′_j| + Σ_i R̄_hi |q′_i|    per arc length,

with the joints j that move g only and i that move h only, and by no more than the sum of the largest speeds of their
points. A limb of thickness d touches both only where their distance is d at most. Over a cell of length 2l that is at
least the proven bound at its centre less l·w_gh. Where that is more than d the limb cannot be clamped; elsewhere the
robot is so slow that w_gh ṡ stays below what the clamped limb bears.

The thickness of arms, hands, legs and feet is the diameter of their capsule, that of the trunk its breadth across the
shoulders. Not counted are limbs that are held lengthwise, several of them in a row, and what another person is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from math import inf
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.common import FloatArray, InputError, IntArray, compiled
from safe_ompl.geometry import LIMBS, STANDING
from safe_ompl.geometry.kernels import POSE, Shapes, distance_bound, place_bodies
from safe_ompl.robot import ConvexBodies, Robot, plain
from safe_ompl.robot.kernels import place_joints
from safe_ompl.scene import BodyRegion, People, Scene

CONTACT_RULES = SEPARATION, CONTACT, CLAMPING = "separation", "contact", "clamping"
_TRUNK = ("neck", "shoulders", "torso", "hips", "left_flank", "right_flank")
_SLOWEST = 1e-12  # [m/rad] bodies that move less stand still
_ROUNDING = 1e-9  # [m]


def contact_speed(region: BodyRegion, mass: float, *, clamped: bool = False) -> float:
    """Return the speed [m/s] at which contact with a body region stays below its limit.

    It is F/√(μK) with 1/μ = 1/m_H + 1/m_R; where the region is clamped, (F/2)/√(m_R K).

    Parameters
    ----------
    region : BodyRegion
        Force, mass and stiffness.
    mass : float
        Effective mass m_R of the robot, which may be infinite [kg].
    clamped : bool
        Whether the region cannot yield.
    """
    reduced = mass if clamped else 1 / (1 / region.mass + 1 / mass)
    force = region.force / 2 if clamped else region.force
    return float(force / np.sqrt(reduced * 1e3 * region.stiffness))


def robot_mass(robot: Robot, *, clamped: bool = False) -> float:
    """Return the effective mass of the robot in a contact [kg]: infinite; half of its links' where it clamps a limb."""
    if not clamped:
        return np.inf
    mass = sum(inertia.mass for inertia in list(robot.shared.model.inertias)[1:]) / 2
    if mass <= 0:
        raise InputError("needs the masses of the robot's links, and the URDF knows none", "people.contact")
    return float(mass)


def limb_contact_speed(robot: Robot, people: People, limb: str, *, clamped: bool = False) -> float:
    """Return the speed [m/s] with which a point of the robot may touch a limb; see `contact_speed`."""
    return contact_speed(people.region_of(limb), robot_mass(robot, clamped=clamped), clamped=clamped)


def limb_thickness(limb: str, height: float) -> float:
    """Return how thick a limb of a person of a height is [m]; infinite for what is no limb."""
    if limb in _TRUNK:
        across = float(np.linalg.norm(STANDING["left_shoulder"] - STANDING["right_shoulder"]))
        return height * (across + 2 * LIMBS["shoulders"][2])
    return 2 * LIMBS[limb][2] * height if limb in LIMBS else np.inf


class _Gaps(NamedTuple):
    """The P gaps of a robot with G moving bodies, and the K widths of limbs."""

    pairs: IntArray  # (P, 2), bodies among the shapes
    sides: IntArray  # (P, 2), the same among those that move; G: it stands still
    radii: FloatArray  # (P, m), by which each joint closes it at most [m/rad]; 1 for those that slide
    widths: FloatArray  # (K,) [m]
    harmless: FloatArray  # (K,), the share of a body's speed at which gaps may close that clamp no worse than it hits


@compiled
def closing_rates(
    joints: Any,
    shapes: Shapes,
    gaps: _Gaps,
    values: FloatArray,
    sizes: FloatArray,
    slopes: FloatArray,
    bodies: FloatArray,
) -> FloatArray:
    """Return how fast gaps of each body close in which limbs of each width may fit, by arc length (N, G, K) [m/rad].

    Gaps that close at a harmless rate do not count. Distances are asked only of those that close faster than another
    of the body in which the limb fits.

    Parameters
    ----------
    joints : (m,)
        A table (`safe_ompl.robot.kernels.kinematics`).
    shapes : Shapes
        The bodies.
    gaps : _Gaps
        The gaps.
    values : (N, m)
        The joints in the middle of the cells.
    sizes, slopes : (N,), (N, m)
        Lengths of the cells [rad], and bounds of the joints' |q′| in them.
    bodies : (N, G + 1)
        Bounds of the speeds of the bodies that move [m/rad], and 0.
    """
    N, m, G, K = len(values), values.shape[1], bodies.shape[1] - 1, len(gaps.widths)
    poses, simplex = np.empty(len(shapes.bodies), POSE), np.empty((4, 3))
    axes, found = np.zeros((len(gaps.pairs), 3)), np.zeros((N, G, K))
    rotations, origins, joint_axes = np.empty((m, 3, 3)), np.empty((m, 3)), np.empty((m, 3))
    for row in range(N):
        place_joints(joints, values[row], rotations, origins, joint_axes)
        if row == 0:
            place_bodies(shapes.bodies, poses, rotations, origins, False)
        place_bodies(shapes.bodies, poses, rotations, origins, True)
        for p in range(len(gaps.pairs)):
            g, rate = gaps.sides[p, 0], 0.0
            for i in range(m):
                rate += gaps.radii[p, i] * slopes[row, i]
            rate = min(rate, bodies[row, g] + bodies[row, gaps.sides[p, 1]])
            half, apart = 0.5 * sizes[row] * rate, -inf
            for k in range(K - 1, -1, -1):
                width = gaps.widths[k]
                if rate <= max(found[row, g, k], gaps.harmless[k] * bodies[row, g]):
                    continue
                if width < inf and not apart > width:
                    a, b, enough = gaps.pairs[p, 0], gaps.pairs[p, 1], width + half + _ROUNDING
                    apart = distance_bound(shapes, poses, a, b, axes[p], simplex, enough) - half
                if not apart > width:
                    found[row, g, k] = rate
    return found


class ContactLimits:
    """How fast a robot may follow a curve where it may touch people, as proven over whole cells.

    Parameters
    ----------
    robot : Robot
        The robot, with G moving bodies.
    still : Scene
        What stands still: a limb may be clamped against it.
    people : People
        What people bear.
    limbs : sequence of (str, str)
        Person and limb of each of the M limbs.
    heights : mapping of str to float
        How tall the people are [m]. Who is not among them is not touched.
    always_clamped : bool
        Limbs count as clamped wherever they are, such as beside things that move.

    Attributes
    ----------
    bears, bears_clamped : ndarray, shape (M,)
        How fast a point of the robot may be that touches a limb, and how fast a gap may close that clamps it [m/s].
    thickness : ndarray, shape (M,)
        How thick the limbs are [m].
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
        self.bears, self.bears_clamped = (
            np.array(
                [
                    limb_contact_speed(robot, people, limb, clamped=clamped) if who in heights else 0.0
                    for who, limb in limbs
                ]
            )
            for clamped in (False, True)
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
        if not bodies.bounded:  # any limb may fit between what has no end
            widths = np.full_like(widths, inf)
        self._data = robot.kinematics.joints, bodies.shapes
        self._gaps = _Gaps(np.sort(pair_bodies, axis=1), sides[pair_bodies], radii, widths, harmless)

    def speeds(
        self, Q: FloatArray, sizes: FloatArray, slopes: FloatArray, bodies: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the largest ṡ (N, G, M) with which body g may touch limb m in a cell, and the same if none is clamped.

        Parameters
        ----------
        Q : ndarray, shape (N, n)
            Configurations in the middle of cells.
        sizes, slopes : ndarray, shape (N,), (N, n)
            Lengths of the cells [rad], and bounds of |q′| in them.
        bodies : ndarray, shape (N, G)
            Bounds of the speeds of the points of the moving bodies, by arc length [m/rad].
        """
        free = self.bears / np.maximum(bodies, _SLOWEST)[:, :, None]
        if self._always:
            return np.minimum(self.bears_clamped / np.maximum(bodies, _SLOWEST)[:, :, None], free), free
        speeds = np.zeros((len(Q), bodies.shape[1] + 1))
        speeds[:, :-1] = bodies
        values, reach = plain(self._coupling.values(Q)), plain(self._coupling.reach(slopes))
        rates = closing_rates(*self._data, self._gaps, values, plain(sizes), reach, speeds)
        slow = self.bears_clamped / np.maximum(rates, _SLOWEST)[:, :, self._width_of]
        return np.minimum(slow, free), free
