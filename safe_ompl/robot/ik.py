"""Inverse kinematics: target poses, task space errors, and joint steps within limits.

`TargetPose` is a target, and `approach` searches from one configuration. `Tip` searches from a batch of configurations,
also along curves of `Frames`.

Errors and Jacobians are in metres: 1 rad of rotation counts as `METRES_PER_RADIAN` metres, so that one number gives
the distance of the tip from its target.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import BoolArray, FloatArray, InputError, finite_array, whole_number
from safe_ompl.geometry import rotation_vectors
from safe_ompl.robot.kinematics import damped_pseudoinverse_step
from safe_ompl.robot.robot import Robot

# This is c of `docs/how-it-works.md` §7, about the size of a hand with an object.
METRES_PER_RADIAN = 0.25
# Elements of R·Rᵀ may differ from the identity by this.
_ORTHONORMAL = 1e-6
# A quaternion whose norm is this close to 1 is normalised; any other is refused as a mistake.
_UNIT = 1e-3

# Singular values of J below this are damped.
_SINGULAR = 0.05  # [m/rad]
# Maximal damping of a singular value.
_DAMPING = 0.05  # [m/rad]

_SAMPLES = 50
# A joint range of at least this counts as a full turn, since many URDF files write 3.14 for π.
_FULL_TURN = 6.27  # [rad]

# The tip must come this near to a target pose.
_PRECISION = 1e-4  # [m]
# Limit of iterations from a seed. Nearly all solutions are found within 20.
_ITERATIONS = 60
# Damping μ per squared error. A larger value is slower, a smaller one fails more often.
_STEP_DAMPING = 0.05  # [1/rad²]
# This is added to the diagonal, so that singular matrices can be solved.
_REGULAR = 1e-9  # [m²/rad²]
# An iteration that leaves more than this share of the error counts as no progress.
_STALLED = 0.99
# The search from a seed ends after this many consecutive iterations without progress.
_PATIENCE = 4

# The following constants are for batches of configurations (`Tip`).
# This is added to the diagonal, so that singular matrices can be solved.
_REGULAR_BATCH = 1e-8  # [m²/rad²]
# Maximal step of an iteration.
_LONGEST = 0.5  # [rad or m]
# Numbers of seeds and iterations, and the precision [m], of `configurations_at`.
_BRANCH_SEEDS, _BRANCH_ITERATIONS, _BRANCH_PRECISION = 40, 40, 1e-7
# Axes count as parallel if the sine of the angle between them is below this.
_PARALLEL = 1e-7
# Configurations that differ by less than this belong to the same branch.
_SAME_BRANCH = 0.2  # [rad or m]


class TargetPose:
    """Target of the tip: a position (3,) in the world frame [m], or a full pose if a rotation is given.

    The rotation is a matrix (3, 3), a quaternion x, y, z, w, or a pin.Quaternion. The `dimension` m is the number of
    task coordinates, 3 or 6. Raises InputError for a wrong shape, NaN, or a matrix that is not a rotation.
    """

    def __init__(self, robot: Robot, position: ArrayLike, rotation: ArrayLike | None = None) -> None:
        self.robot = robot
        self.position = finite_array(position, (3,), "position of the tip")
        self.rotation = None if rotation is None else _matrix(rotation)
        self.dimension = 3 if rotation is None else 6

    @cached_property
    def redundancy(self) -> int:
        """Dimension of the null space, n − rank J, maximal rank over sampled configurations."""
        return self.robot.n - int(np.linalg.matrix_rank(self._sampled_jacobians).max())

    @cached_property
    def lever_arm(self) -> float:
        """Typical lever arm, the tip motion per joint motion [m/rad]: the median of ‖J‖/√n."""
        return float(np.median(np.linalg.norm(self._sampled_jacobians, axis=(1, 2))) / np.sqrt(self.robot.n))

    @cached_property
    def _sampled_jacobians(self) -> FloatArray:
        # The random seed is fixed, so that the samples of a robot are always the same.
        robot, rng = self.robot, np.random.default_rng(0)
        return np.array([self.jacobian(q) for q in rng.uniform(robot.lower, robot.upper, (_SAMPLES, robot.n))])

    def sample(self, rng: np.random.Generator) -> TargetPose:
        """Sample a target pose. This target has only one, itself."""
        return self

    def error(self, q: FloatArray) -> FloatArray:
        """Return the error Δx (m,) [m] from the tip at `q: (n,)` to the target, in world axes; see `error_from`."""
        return error_from(self.robot.tip_pose(q), self.position, self.rotation)

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Return the Jacobian J (m, n) [m/rad] of the tip at `q: (n,)` in the coordinates of `error`."""
        jacobian = self.robot.tip_jacobian(q)[: self.dimension]
        jacobian[3:] *= METRES_PER_RADIAN
        return jacobian

    def nearest_position(self, point: FloatArray) -> FloatArray:
        """Return the position (3,) [m] of the target nearest to a point, which is its only position."""
        return self.position

    def distance(self, q: FloatArray) -> float:
        """Return WS_DISTANCE = ‖Δx‖ = √(‖p‖² + c²‖ω‖²) [m] at `q: (n,)`."""
        error = self.error(q)
        return float(np.sqrt(error @ error))


def error_from(pose: pin.SE3, position: FloatArray, rotation: FloatArray | None) -> FloatArray:
    """Return the error Δx [m] in world axes from a pose to a position, (3,), or to position and orientation, (6,).

    The rotational part is c·log(R_goal Rᵀ). The logarithm of the full transform, log6, mixes position and rotation.
    With separate logarithms ½‖Δx‖² has exactly the gradient −JᵀΔx, and the tip moves on a straight line.
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
    """Return Δq (n,) = J†Δx + (I − J†J)Δq₀, the joint step with JΔq = Δx (m,) that is nearest to Δq₀ (n,); J is (m, n).

    It is computed as Δq₀ + Jᵀ(JJᵀ + Λ²)⁻¹(Δx − JΔq₀). The damping Λ acts only on directions with singular values of J
    below 0.05 m/rad, and grows as they decrease. In other directions the pseudoinverse is exact.
    """
    # Compiled, the step takes a ninth of the time of np.linalg.eigh.
    return damped_pseudoinverse_step(np.ascontiguousarray(jacobian), error, drift, _SINGULAR, _DAMPING)


def transpose_step(jacobian: FloatArray, error: FloatArray, drift: FloatArray) -> FloatArray:
    """Return Δq (n,) = γJᵀΔx with the γ = ‖JᵀΔx‖²/‖JJᵀΔx‖² that minimizes the error; Δq₀ is ignored."""
    pull = jacobian.T @ error
    moved = jacobian @ pull
    square = float(moved @ moved)
    return pull * (float(pull @ pull) / square if square > 0 else 0.0)


def damped_step(jacobian: FloatArray, error: FloatArray, drift: FloatArray) -> FloatArray:
    """Return the damped step Δq (n,) = Jᵀ(JJᵀ + μ‖Δx‖²)⁻¹Δx (Levenberg-Marquardt; Sugihara 2011); Δq₀ is ignored."""
    square = jacobian @ jacobian.T
    square.flat[:: len(error) + 1] += _STEP_DAMPING * float(error @ error) + _REGULAR
    return jacobian.T @ np.linalg.solve(square, error)


Rule: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""(J, Δx, Δq₀) → Δq."""


StepLimits: TypeAlias = tuple[FloatArray, FloatArray]
"""Lower and upper joint limits (n,) of steps [rad or m]; infinite for joints without limits."""


def motion_limits(robot: Robot, free: BoolArray | None = None) -> StepLimits:
    """Return the joint limits of steps. The `free: (n,)` joints, by default the continuous ones, have none."""
    free = robot.continuous if free is None else free
    return np.where(free, -np.inf, robot.lower), np.where(free, np.inf, robot.upper)


def limited_step(
    rule: Rule,
    target: TargetPose,
    q: FloatArray,
    limits: StepLimits,
    largest: float = np.inf,
    drift: FloatArray | None = None,
) -> FloatArray:
    """Return a joint step Δq (n,) that moves the tip towards a target and stays within the limits.

    Joints that would pass a limit stop at the limit, and the other joints compensate for the missing tip motion. The
    rule is `pseudoinverse_step`, `transpose_step` or `damped_step`. The arm is at `q: (n,)`, within its limits [rad
    or m]. The norm of the step is at most `largest` [rad or m]; `drift: (n,)` is the desired posture motion Δq₀.
    """
    jacobian, error = target.jacobian(q), target.error(q)
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


def approach(target: TargetPose, seed: FloatArray, precision: float) -> tuple[FloatArray, float]:
    """Search from `seed: (n,)`. Return a configuration (n,) within the joint limits and its distance [m] to the target.

    The search ends at a distance of `precision` [m].
    """
    # Joints with a range of a full turn may pass their limits, and are wrapped afterwards.
    limits = motion_limits(target.robot, _full_turns(target.robot))
    q, distance, stalls = seed, target.distance(seed), 0
    for _ in range(_ITERATIONS):
        if distance <= precision or stalls == _PATIENCE:
            break
        q = _within_limits(target.robot, q + limited_step(damped_step, target, q, limits))
        before, distance = distance, target.distance(q)
        stalls = stalls + 1 if distance > _STALLED * before else 0
    return q, distance


def tip_reach(robot: Robot) -> tuple[FloatArray, float]:
    """Return centre (3,) and radius [m] of a ball that contains the tip at all configurations within the limits.

    The tip position is a sum of offsets that revolute joints rotate, and of prismatic displacements. Offsets that no
    joint rotates, and offsets along the axis of the first revolute joint, move the centre. Any other offset adds its
    length to the radius, and a prismatic joint half its range, by the triangle inequality.
    """
    chain, centre, radius, rotation = robot.shared.chain, np.zeros(3), 0.0, np.eye(3)
    # The number of frames so far that a joint rotates, and the axis of the first such joint.
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
    """Return `q` within the joint limits: joints with a full range by turns of 2π, the others clipped."""
    over, under = (q - robot.upper) % (2 * np.pi), (robot.lower - q) % (2 * np.pi)
    turned = np.where(q > robot.upper, robot.upper - 2 * np.pi + over, robot.lower + 2 * np.pi - under)
    outside = (q > robot.upper) | (q < robot.lower)
    return np.clip(np.where(outside & _full_turns(robot), turned, q), robot.lower, robot.upper)


def target_pose(robot: Robot, position: Any, rotation: Any = None) -> TargetPose:
    """Return the target for a position (3,) [m] and a rotation, see `TargetPose`, or for a pin.SE3 alone."""
    if not isinstance(position, pin.SE3):
        return TargetPose(robot, position, rotation)
    if rotation is not None:
        raise InputError("rotation of the tip: the pose has one already; give the pose alone")
    return TargetPose(robot, position.translation, position.rotation)


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
    """Return a configuration (n,) within the joint limits whose tip is at a target to 0.1 mm, or None if none is found.

    1 rad of rotation counts as 0.25 m.

    Parameters
    ----------
    robot : Robot
        The robot.
    position, rotation
        Target as in `target_pose`; without a rotation the orientation is free.
    near : array_like, shape (n,), optional
        Start of the first search [rad or m]. If given, the solution nearest to `near` is returned.
    seeds, seed : int
        Number of start configurations, `near` included, and random seed: the same seed gives the same solution.
    valid : callable, optional
        Returns whether a configuration (n,) is acceptable: ``lambda q: not checker.in_collision(q)``.

    Raises
    ------
    InputError
        For a wrong shape, NaN, a matrix that is not a rotation, or no seeds.

    Examples
    --------
    >>> q = inverse_kinematics(Robot.from_example("ur5"), [0.4, 0.1, 0.5], [0.0, 1.0, 0.0, 0.0])
    >>> q.shape
    (6,)
    """
    target, number = target_pose(robot, position, rotation), whole_number("seeds", seeds, at_least=1)
    begin = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (number, robot.n))
    if near is not None:
        near = finite_array(near, (robot.n,), "near")
        begin[0] = np.where(robot.continuous, near, np.clip(near, robot.lower, robot.upper))
    found: list[FloatArray] = []
    for start in begin:
        q, distance = approach(target, start, _PRECISION)
        if distance <= _PRECISION and (valid is None or valid(q)):
            if near is None:
                return q
            found.append(q)
    if near is None:
        return None
    return min(found, key=lambda q: float(np.linalg.norm(robot.difference(near, q))), default=None)


# ------------------------------------------------------------------------------------- many configurations at once


class Frames(NamedTuple):
    """S poses of a tool along a curve, with derivatives by the curve's parameter s [m]."""

    positions: FloatArray  # (S, 3) [m]
    rotations: FloatArray  # (S, 3, 3)
    velocities: FloatArray  # (S, 3) dc/ds
    # Angular velocities (S, 3) with respect to s, in world axes [rad/m].
    spins: FloatArray


class TipState(NamedTuple):
    """The tip at B configurations: positions (B, 3), rotations (B, 3, 3), Jacobians (B, 6, n) in world axes."""

    positions: FloatArray
    rotations: FloatArray
    jacobians: FloatArray


@dataclass(frozen=True)
class Tip:
    """The tip of a robot, with an optional axis (3,) in the tip frame about which the tip may rotate freely."""

    robot: Robot
    free_axis: FloatArray | None = None

    def at(self, Q: FloatArray) -> TipState:
        """Return the tip at configurations (B, n)."""
        robot = self.robot
        rotations, origins, axes = robot.joint_frames(Q)
        carrier = robot.tip_joint - 1
        turned = rotations[:, carrier]
        positions = origins[:, carrier] + turned @ robot.tip_placement.translation
        moving = self.order
        slides = robot.joint_prismatic[moving]
        own = axes[:, moving]
        jacobians = np.zeros((len(Q), 6, len(robot.joint_prismatic)))
        lever_arm = np.where(slides[:, None], own, _cross(own, positions[:, None] - origins[:, moving]))
        jacobians[:, :3, moving] = np.swapaxes(lever_arm, 1, 2)
        jacobians[:, 3:, moving] = np.swapaxes(np.where(slides[:, None], 0.0, own), 1, 2)
        return TipState(positions, turned @ robot.tip_placement.rotation, robot.coupling.columns(jacobians))

    def errors(self, state: TipState, frames: Frames) -> FloatArray:
        """Return the errors (B, 6) of the tip: offsets [m] and rotation vectors [rad] to the frames, in world axes."""
        offset = frames.positions - state.positions
        if self.free_axis is None:
            turn = rotation_vectors(frames.rotations @ np.swapaxes(state.rotations, 1, 2))
        else:
            own, wanted = state.rotations @ self.free_axis, frames.rotations @ self.free_axis
            across = _cross(own, wanted)
            sine = np.linalg.norm(across, axis=1)
            cosine = np.einsum("bx,bx->b", own, wanted)
            turn = across * (np.arctan2(sine, cosine) / np.maximum(sine, 1e-300))[:, None]
            for k in np.flatnonzero((sine < _PARALLEL) & (cosine < 0)):
                turn[k] = np.arctan2(sine[k], cosine[k]) * _reversing_axis(own[k], state.jacobians[k, 3:])
        return np.hstack([offset, turn])

    def task(self, state: TipState, frames: Frames) -> tuple[FloatArray, FloatArray]:
        """Return errors (B, 6) and Jacobians (B, 6, n) of the task in metres; 1 rad counts as `METRES_PER_RADIAN`."""
        errors, jacobians = self.errors(state, frames), state.jacobians.copy()
        if self.free_axis is not None:
            own = state.rotations @ self.free_axis
            jacobians[:, 3:] -= own[:, :, None] * (own[:, None] @ jacobians[:, 3:])
        errors[:, 3:] *= METRES_PER_RADIAN
        jacobians[:, 3:] *= METRES_PER_RADIAN
        return errors, jacobians

    def solved(self, Q: FloatArray, frames: Frames, precision: float, iterations: int) -> tuple[FloatArray, BoolArray]:
        """Solve inverse kinematics for a batch. Return configurations (B, n) near `Q`, and which have converged (B,).

        All configurations take steps Jᵀ(JJᵀ + μ‖e‖²)⁻¹e within the joint limits together. `approach` takes the same
        steps for one configuration, 7 to 11 times as fast as a batch of one.
        """
        Q = Q.copy()
        low, high = self.limits
        left = np.arange(len(Q))
        arrived = np.zeros(len(Q), dtype=bool)
        for k in range(iterations + 1):
            errors, jacobians = self.task(self.at(Q[left]), Frames(*(part[left] for part in frames)))
            square = np.einsum("bi,bi->b", errors, errors)
            there = square <= precision**2
            arrived[left[there]] = True
            left = left[~there]
            if k == iterations or not len(left):
                break
            errors, jacobians, square = errors[~there], jacobians[~there], square[~there]
            step = _least_squares(jacobians, errors, _STEP_DAMPING * square)
            length = np.linalg.norm(step, axis=1, keepdims=True)
            Q[left] = np.clip(Q[left] + step * np.minimum(1.0, _LONGEST / np.maximum(length, 1e-12)), low, high)
        return Q, arrived

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper joint limits (n,) [rad or m]; infinite for continuous joints."""
        return motion_limits(self.robot)

    def null_motion(self, jacobians: FloatArray, wanted: FloatArray) -> FloatArray:
        """Project desired joint motions (B, n) onto the null space of the Jacobians of `task`."""
        moved = np.einsum("bxn,bn->bx", jacobians, wanted)
        return wanted - _least_squares(jacobians, moved, np.zeros(len(wanted)))

    def following(self, state: TipState, frames: Frames, jacobians: FloatArray, wanted: FloatArray) -> FloatArray:
        """Return the dq/ds (B, n) that follow a curve and are nearest to `wanted`, for Jacobians of `task`."""
        spins = METRES_PER_RADIAN * frames.spins
        if self.free_axis is not None:
            own = state.rotations @ self.free_axis
            spins = spins - own * np.einsum("bx,bx->b", own, spins)[:, None]
        missing = np.hstack([frames.velocities, spins]) - np.einsum("bxn,bn->bx", jacobians, wanted)
        return wanted + _least_squares(jacobians, missing, np.zeros(len(wanted)))

    @cached_property
    def order(self) -> list[int]:
        """The joints of Pinocchio's model (0-based) that move the tip, in order from the base."""
        return self.robot.shared.chain.path_to_root(self.robot.tip_joint)[::-1]


def configurations_at(robot: Robot, pose: pin.SE3, near: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return configurations (K, n) of different branches whose tip is at a pose, sorted by distance from `near`."""
    seeds = np.vstack([near, rng.uniform(robot.lower, robot.upper, (_BRANCH_SEEDS, robot.n))])
    frames = (np.broadcast_to(part, (len(seeds), *part.shape)) for part in (pose.translation, pose.rotation))
    still = np.zeros((2, len(seeds), 3))
    Q, arrived = Tip(robot).solved(seeds, Frames(*frames, *still), _BRANCH_PRECISION, _BRANCH_ITERATIONS)
    # The difference from zero wraps continuous joints to ±π.
    Q = robot.difference(np.zeros_like(near), Q[arrived])
    found: list[FloatArray] = []
    for q in Q[np.abs(robot.difference(near, Q)).max(axis=1).argsort()]:
        if all(np.abs(robot.difference(q, other)).max() > _SAME_BRANCH for other in found):
            found.append(q)
    return np.reshape(found, (-1, robot.n))


def _reversing_axis(axis: FloatArray, jacobian: FloatArray) -> FloatArray:
    """Return the unit vector (3,) perpendicular to `axis` about which the joints can rotate the tool best.

    A half turn about any perpendicular vector reverses the axis, but the robot may be unable to rotate about some.
    `jacobian` (3, n) is the rotational part. The first component above 0.3 is positive.
    """
    across = np.linalg.svd(axis[None])[2][1:]
    best: FloatArray = np.linalg.svd(across @ jacobian)[0][:, 0] @ across
    return np.asarray(best * np.sign(best[np.abs(best) > 0.3][0]))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b (…, 3); `numpy.cross` takes three times as long for few rows."""
    (a0, a1, a2), (b0, b1, b2) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def _least_squares(jacobians: FloatArray, errors: FloatArray, damping: FloatArray) -> FloatArray:
    """Return Jᵀ(JJᵀ + μ)⁻¹e (B, n)."""
    square = jacobians @ np.swapaxes(jacobians, 1, 2)
    square[:, range(6), range(6)] += damping[:, None] + _REGULAR_BATCH
    return np.asarray(np.einsum("bxn,bx->bn", jacobians, np.linalg.solve(square, errors[..., None])[..., 0]))
