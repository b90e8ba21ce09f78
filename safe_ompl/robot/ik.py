"""Bringing the tip of a robot to a place: task errors, joint steps within limits, inverse kinematics.

Errors and Jacobians are in metres throughout: the rotational part of a pose counts `METRES_PER_RADIAN` metres
for each radian, so that one number says how far the tip is from where it should be.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import BoolArray, FloatArray, InputError, finite_array, whole_number
from safe_ompl.robot.robot import Robot

METRES_PER_RADIAN = 0.25  # c of `docs/mathematics.md` §7: about the reach of a hand and what it holds
_ORTHONORMAL = 1e-6  # largest error of a rotation matrix
_UNIT = 1e-3  # quaternions whose norm is as near to 1 are normalised; others are taken for mistakes

_SINGULAR = 0.05  # [m/rad] singular values of J below this are damped,
_DAMPING = 0.05  # [m/rad] by up to this much

_SAMPLES = 50
_FULL_TURN = 6.27  # [rad] many a URDF says 3.14 for π

_PRECISION = 1e-4  # [m] how near the tip must come to a place
_ITERATIONS = 60  # of the inverse kinematics: nearly all solutions are found within 20
_CAUTION = 0.05  # μ [1/rad²], damping per squared error; more is slower, less fails more often
_REGULAR = 1e-9  # [m²/rad²] keeps singular matrices solvable
_STALLED = 0.99  # an iteration that leaves more than this share of the error makes no progress,
_PATIENCE = 4  # and after so many of them in a row the seed is given up


class Place:
    """Where the tip of a robot is to be: a position (3,) in the world frame [m], or with a rotation a full pose.

    The rotation is a matrix (3, 3), a quaternion x, y, z, w, or a pin.Quaternion. The `dimension` m is the number of
    task coordinates, 3 or 6. Raises InputError for a wrong shape, NaN, or what is not a rotation.
    """

    def __init__(self, robot: Robot, position: ArrayLike, rotation: ArrayLike | None = None) -> None:
        self.robot = robot
        self.position = finite_array(position, (3,), "position of the tip")
        self.rotation = None if rotation is None else _matrix(rotation)
        self.dimension = 3 if rotation is None else 6

    @cached_property
    def redundancy(self) -> int:
        """Number of degrees of freedom that the place leaves to the arm, n − rank J: its null space."""
        return self.robot.n - int(np.linalg.matrix_rank(self._sampled_jacobians).max())

    @cached_property
    def lever(self) -> float:
        """How far the tip typically moves for one radian of joint motion [m/rad]: median of ‖J‖/√n."""
        return float(np.median(np.linalg.norm(self._sampled_jacobians, axis=(1, 2))) / np.sqrt(self.robot.n))

    @cached_property
    def _sampled_jacobians(self) -> FloatArray:
        robot, rng = self.robot, np.random.default_rng(0)  # always the same: they belong to the robot
        return np.array([self.jacobian(q) for q in rng.uniform(robot.lower, robot.upper, (_SAMPLES, robot.n))])

    def sample(self, rng: np.random.Generator) -> Place:
        """Return a place at random of those that will do: this one."""
        return self

    def error(self, q: FloatArray) -> FloatArray:
        """Return Δx (m,) [m] from the tip at `q: (n,)` to the place, in world axes; see `error_from`."""
        return error_from(self.robot.tip_pose(q), self.position, self.rotation)

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Return the Jacobian J (m, n) [m/rad] of the tip at `q: (n,)` in the coordinates of `error`."""
        jacobian = self.robot.tip_jacobian(q)[: self.dimension]
        jacobian[3:] *= METRES_PER_RADIAN
        return jacobian

    def nearest_position(self, point: FloatArray) -> FloatArray:
        """Return the position (3,) [m] of the place that is nearest to a point."""
        return self.position

    def distance(self, q: FloatArray) -> float:
        """Return WS_DISTANCE = ‖Δx‖ = √(‖p‖² + c²‖ω‖²) [m] at `q: (n,)`."""
        error = self.error(q)
        return float(np.sqrt(error @ error))


def error_from(pose: pin.SE3, position: FloatArray, rotation: FloatArray | None) -> FloatArray:
    """Return Δx (3,) or (6,) [m] from a pose to a position and perhaps an orientation, in world axes.

    The rotational part is c·log(R_goal Rᵀ). In the logarithm of the whole motion, log6, position and
    rotation mix; taken apart, ½‖Δx‖² has the gradient −JᵀΔx exactly, and the tip moves on a straight line.
    """
    offset = position - pose.translation
    if rotation is None:
        return np.asarray(offset)
    return np.concatenate([offset, METRES_PER_RADIAN * pin.log3(rotation @ pose.rotation.T)])


def _matrix(rotation: ArrayLike | pin.Quaternion) -> FloatArray:
    """Return a rotation as a matrix (3, 3), from a matrix, a quaternion x, y, z, w, or a pin.Quaternion."""
    given = rotation.coeffs() if isinstance(rotation, pin.Quaternion) else rotation
    if np.shape(given) == (4,):
        xyzw = finite_array(given, (4,), "rotation of the tip")
        norm, text = float(np.linalg.norm(xyzw)), "rotation of the tip: a quaternion (x, y, z, w)"
        if abs(norm - 1) > _UNIT:
            raise InputError(f"{text} must be of unit length, got {xyzw.tolist()}")
        return pin.Quaternion(xyzw / norm).matrix()  # type: ignore[no-any-return]
    matrix = finite_array(given, (3, 3), "rotation of the tip")
    if np.abs(matrix @ matrix.T - np.eye(3)).max() > _ORTHONORMAL or np.linalg.det(matrix) < 0:
        raise InputError(f"rotation of the tip must be orthonormal with determinant 1, got {matrix.tolist()}")
    return matrix


def pseudoinverse_step(jacobian: FloatArray, error: FloatArray, drift: FloatArray) -> FloatArray:
    """Return Δq (n,) = J†Δx + (I − J†J)Δq₀: of the joint motions to Δx (m,) the one nearest to Δq₀ (n,), with J (m, n).

    Computed as Δq₀ + Jᵀ(JJᵀ + Λ²)⁻¹(Δx − JΔq₀). The damping Λ acts on directions in which the arm is nearly
    singular, and grows as they become so; elsewhere the pseudoinverse is exact.
    """
    squares, directions = np.linalg.eigh(jacobian @ jacobian.T)
    damped = squares + _DAMPING**2 * np.maximum(0.0, 1.0 - squares / _SINGULAR**2)
    residual = directions.T @ (error - jacobian @ drift)
    return drift + jacobian.T @ (directions @ (residual / damped))


def transpose_step(jacobian: FloatArray, error: FloatArray, drift: FloatArray) -> FloatArray:
    """Return Δq (n,) = γJᵀΔx with the γ that leaves the least error, ‖JᵀΔx‖²/‖JJᵀΔx‖²; Δq₀ is ignored."""
    pull = jacobian.T @ error
    moved = jacobian @ pull
    square = float(moved @ moved)
    return pull * (float(pull @ pull) / square if square > 0 else 0.0)


def cautious_step(jacobian: FloatArray, error: FloatArray, drift: FloatArray) -> FloatArray:
    """Return Δq (n,) = Jᵀ(JJᵀ + μ‖Δx‖²)⁻¹Δx (Levenberg-Marquardt; Sugihara 2011); Δq₀ is ignored."""
    square = jacobian @ jacobian.T
    square.flat[:: len(error) + 1] += _CAUTION * float(error @ error) + _REGULAR
    return jacobian.T @ np.linalg.solve(square, error)


Rule: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""(J, Δx, Δq₀) → Δq."""


StepLimits: TypeAlias = tuple[FloatArray, FloatArray]
"""Lower and upper joint limits (n,) that steps respect [rad or m]; infinite for joints without limits."""


def motion_limits(robot: Robot, free: BoolArray | None = None) -> StepLimits:
    """Return the limits of motions: the joints that are `free: (n,)`, by default continuous ones, have none."""
    free = robot.continuous if free is None else free
    return np.where(free, -np.inf, robot.lower), np.where(free, np.inf, robot.upper)


def limited_step(
    rule: Rule,
    place: Place,
    q: FloatArray,
    limits: StepLimits,
    largest: float = np.inf,
    drift: FloatArray | None = None,
) -> FloatArray:
    """Return a joint motion Δq (n,) that brings the tip nearer to a place and stays within limits.

    Joints that would pass a limit stop at it, and the others take over what the tip would lose by that. The rule is
    `pseudoinverse_step`, `transpose_step` or `cautious_step`; the arm is at `q: (n,)`, within its limits [rad or m].
    The step is shortened to the norm `largest` [rad or m]; the `drift: (n,)` is Δq₀, posture motion wanted besides.
    """
    jacobian, error = place.jacobian(q), place.error(q)
    posture = np.zeros(len(q)) if drift is None else drift
    step = rule(jacobian, error, posture)
    share = _shortening(step, largest)
    step *= share
    low, high = limits[0] - q, limits[1] - q
    free = np.ones(len(q), dtype=bool)
    while ((step < low) | (step > high)).any():
        free &= (step > low) & (step < high)
        step = np.clip(step, low, high)
        residual = share * error - jacobian[:, ~free] @ step[~free]
        step[free] = rule(jacobian[:, free], residual, share * posture[free])
    return step * _shortening(step, largest)


def _shortening(step: FloatArray, largest: float) -> float:
    length = float(np.sqrt(step @ step))
    return largest / length if length > largest else 1.0


def approach(place: Place, seed: FloatArray, precision: float) -> tuple[FloatArray, float]:
    """Return a configuration (n,) within the joint limits, and how far [m] its tip is from the place."""
    limits = motion_limits(place.robot, _full_turns(place.robot))  # whichever way joints turn
    q, distance, stalls = seed, place.distance(seed), 0
    for _ in range(_ITERATIONS):
        if distance <= precision or stalls == _PATIENCE:
            break
        q = _within_limits(place.robot, q + limited_step(cautious_step, place, q, limits))
        before, distance = distance, place.distance(q)
        stalls = stalls + 1 if distance > _STALLED * before else 0
    return q, distance


def tip_reach(robot: Robot) -> tuple[FloatArray, float]:
    """Return a ball that the tip never leaves, at any configuration within the limits: its centre (3,) and radius [m].

    The tip is a sum of constant offsets that joints turn, and of what prismatic joints add. Offsets that no joint
    turns, and those along the axis of the first one that does, move the centre; every other one counts with its length,
    and a prismatic joint with half its range. The triangle inequality does the rest.
    """
    chain, centre, radius, rotation = robot.shared.chain, np.zeros(3), 0.0, np.eye(3)
    # How many of the frames so far a joint turns, and the axis of the first one that does.
    turned, first = 0, np.zeros(3)
    for i in (*reversed(chain.path_to_root(robot.tip_joint)), None):
        placement = robot.tip_placement if i is None else chain.placements[i]
        offset = placement.translation.copy()
        if i is not None and chain.prismatic[i]:
            offset += placement.rotation @ chain.axes[i] * (chain.lower[i] + chain.upper[i]) / 2
            radius += float(chain.upper[i] - chain.lower[i]) / 2
        still = offset if not turned else (first @ offset) * first if turned == 1 else np.zeros(3)
        centre = centre + rotation @ still
        radius += float(np.linalg.norm(offset - still))
        if turned:
            turned += 1
        elif i is not None:
            rotation = rotation @ placement.rotation
            if not chain.prismatic[i]:
                turned, first = 1, chain.axes[i]
    return centre, radius


def _full_turns(robot: Robot) -> BoolArray:
    return robot.continuous | (~robot.prismatic & (robot.upper - robot.lower > _FULL_TURN))


def _within_limits(robot: Robot, q: FloatArray) -> FloatArray:
    """Return `q` with the joints that reach every angle brought within their limits by full turns."""
    over, under = (q - robot.upper) % (2 * np.pi), (robot.lower - q) % (2 * np.pi)
    turned = np.where(q > robot.upper, robot.upper - 2 * np.pi + over, robot.lower + 2 * np.pi - under)
    outside = (q > robot.upper) | (q < robot.lower)
    return np.clip(np.where(outside & _full_turns(robot), turned, q), robot.lower, robot.upper)


def place_of(robot: Robot, position: Any, rotation: Any = None) -> Place:
    """Return the place that a position (3,) [m] and a rotation mean, see `Place`, or a pose (pin.SE3) alone."""
    if not isinstance(position, pin.SE3):
        return Place(robot, position, rotation)
    if rotation is not None:
        raise InputError("rotation of the tip: the pose has one already; give the pose alone")
    return Place(robot, position.translation, position.rotation)


def inverse_kinematics(
    robot: Robot,
    position: Any,
    rotation: Any = None,
    *,
    near: ArrayLike | None = None,
    seeds: int = 16,
    seed: int = 0,
    valid: Callable[[FloatArray], bool] | None = None,
) -> FloatArray | None:
    """Return a configuration within the joint limits whose tip is at a place to 0.1 mm, or None if none is found.

    A radian counts as 0.25 m.

    Parameters
    ----------
    robot : Robot
        The robot.
    position, rotation
        As for `place_of`; without a rotation any orientation will do.
    near : array_like, shape (n,), optional
        Where the first search begins [rad or m]; with it, of the solutions the one nearest to it is returned.
    seeds, seed : int
        From how many configurations to search, `near` included, and what the random numbers come from: the same seed
        gives the same solution.
    valid : callable, optional
        From a configuration (n,) to whether it will do: ``lambda q: not checker.in_collision(q)``.

    Raises
    ------
    InputError
        Wrong shape, NaN, what is not a rotation, or no seeds.

    Examples
    --------
    >>> inverse_kinematics(robot, [0.4, 0.1, 0.5], [0.0, 1.0, 0.0, 0.0])  # doctest: +SKIP
    """
    place, number = place_of(robot, position, rotation), whole_number("seeds", seeds, at_least=1)
    begin = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (number, robot.n))
    if near is not None:
        near = finite_array(near, (robot.n,), "near")
        begin[0] = np.where(robot.continuous, near, np.clip(near, robot.lower, robot.upper))
    found: list[FloatArray] = []
    for start in begin:
        q, distance = approach(place, start, _PRECISION)
        if distance <= _PRECISION and (valid is None or valid(q)):
            if near is None:
                return q
            found.append(q)
    if near is None:
        return None
    return min(found, key=lambda q: float(np.linalg.norm(robot.difference(near, q))), default=None)
