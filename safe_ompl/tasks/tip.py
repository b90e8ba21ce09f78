"""The tip of a robot at many configurations at once: poses, Jacobians, inverse kinematics, bounds of its motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.common import BoolArray, FloatArray
from safe_ompl.geometry import rotation_vectors
from safe_ompl.robot import METRES_PER_RADIAN, Robot, motion_limits
from safe_ompl.tasks.tool_path import Frames

_DAMPING = 1e-8  # [m²/rad²]
_CAUTION = 0.05  # [1/rad²] damping by squared error, as `robot.ik.cautious_step`
_LONGEST = 0.5  # [rad or m] of a step
_SEEDS, _ITERATIONS, _PRECISION = 40, 40, 1e-7  # of `configurations_at`; [m]
_PARALLEL = 1e-7  # sine of the angle below which axes count as parallel
_SAME = 0.2  # [rad or m] configurations that differ by less are one branch


class TipState(NamedTuple):
    """The tip at B configurations: positions (B, 3), rotations (B, 3, 3), Jacobians (B, 6, n) in world axes."""

    positions: FloatArray
    rotations: FloatArray
    jacobians: FloatArray


@dataclass(frozen=True)
class Tip:
    """The tip of a robot, and an axis of it about which it may turn freely, (3,) in its own frame, or None."""

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
        lever = np.where(slides[:, None], own, _cross(own, positions[:, None] - origins[:, moving]))
        jacobians[:, :3, moving] = np.swapaxes(lever, 1, 2)
        jacobians[:, 3:, moving] = np.swapaxes(np.where(slides[:, None], 0.0, own), 1, 2)
        return TipState(positions, turned @ robot.tip_placement.rotation, robot.coupling.columns(jacobians))

    def errors(self, state: TipState, frames: Frames) -> FloatArray:
        """Return the errors (B, 6): [m] from the tip to the frames, and rotation vectors [rad], in world axes."""
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
        """Return errors (B, 6) and Jacobians (B, 6, n) of the task in metres; a radian counts METRES_PER_RADIAN."""
        errors, jacobians = self.errors(state, frames), state.jacobians.copy()
        if self.free_axis is not None:
            own = state.rotations @ self.free_axis
            jacobians[:, 3:] -= own[:, :, None] * (own[:, None] @ jacobians[:, 3:])
        errors[:, 3:] *= METRES_PER_RADIAN
        jacobians[:, 3:] *= METRES_PER_RADIAN
        return errors, jacobians

    def solved(self, Q: FloatArray, frames: Frames, precision: float, iterations: int) -> tuple[FloatArray, BoolArray]:
        """Return configurations (B, n) near `Q` whose tip is at the frames, and which of them are, (B,).

        Steps Jᵀ(JJᵀ + μ‖e‖²)⁻¹e within the joint limits, all of them together.
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
            step = _least_squares(jacobians, errors, _CAUTION * square)
            length = np.linalg.norm(step, axis=1, keepdims=True)
            Q[left] = np.clip(Q[left] + step * np.minimum(1.0, _LONGEST / np.maximum(length, 1e-12)), low, high)
        return Q, arrived

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper limits (n,) of the joints, none for continuous ones [rad or m]."""
        return motion_limits(self.robot)

    def null_motion(self, jacobians: FloatArray, wanted: FloatArray) -> FloatArray:
        """Return the part (B, n) of wanted joint motions that leaves the task as it is; `jacobians` are of `task`."""
        moved = np.einsum("bxn,bn->bx", jacobians, wanted)
        return wanted - _least_squares(jacobians, moved, np.zeros(len(wanted)))

    def following(self, state: TipState, frames: Frames, jacobians: FloatArray, wanted: FloatArray) -> FloatArray:
        """Return the joint rates (B, n) that follow a curve, the nearest to wanted ones; `jacobians` are of `task`."""
        spins = METRES_PER_RADIAN * frames.spins
        if self.free_axis is not None:
            own = state.rotations @ self.free_axis
            spins = spins - own * np.einsum("bx,bx->b", own, spins)[:, None]
        missing = np.hstack([frames.velocities, spins]) - np.einsum("bxn,bn->bx", jacobians, wanted)
        return wanted + _least_squares(jacobians, missing, np.zeros(len(wanted)))

    @cached_property
    def order(self) -> list[int]:
        """The joints of Pinocchio's model (from 0) that move the tip, from the base on."""
        return self.robot.shared.chain.path_to_root(self.robot.tip_joint)[::-1]


def configurations_at(robot: Robot, pose: pin.SE3, near: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return configurations (K, n) whose tip is at a pose, different branches, those near a configuration first."""
    seeds = np.vstack([near, rng.uniform(robot.lower, robot.upper, (_SEEDS, robot.n))])
    frames = (np.broadcast_to(part, (len(seeds), *part.shape)) for part in (pose.translation, pose.rotation))
    still = np.zeros((2, len(seeds), 3))
    Q, arrived = Tip(robot).solved(seeds, Frames(*frames, *still), _PRECISION, _ITERATIONS)
    Q = robot.difference(np.zeros_like(near), Q[arrived])  # continuous joints between ±π
    found: list[FloatArray] = []
    for q in Q[np.abs(robot.difference(near, Q)).max(axis=1).argsort()]:
        if all(np.abs(robot.difference(q, other)).max() > _SAME for other in found):
            found.append(q)
    return np.reshape(found, (-1, robot.n))


def _reversing_axis(axis: FloatArray, jacobian: FloatArray) -> FloatArray:
    """Return the unit vector (3,) across an axis of the tool about which joints can best reverse that axis.

    Every one of them leads to the opposite direction; about some the robot may not be able to turn at all. `jacobian`
    (3, n) is the rotational one. The first component above 0.3 is positive.
    """
    across = np.linalg.svd(axis[None])[2][1:]
    best: FloatArray = np.linalg.svd(across @ jacobian)[0][:, 0] @ across
    return np.asarray(best * np.sign(best[np.abs(best) > 0.3][0]))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b (…, 3); NumPy's own takes three times as long for few rows."""
    (a0, a1, a2), (b0, b1, b2) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def _least_squares(jacobians: FloatArray, errors: FloatArray, damping: FloatArray) -> FloatArray:
    """Return Jᵀ(JJᵀ + μ)⁻¹e (B, n)."""
    square = jacobians @ np.swapaxes(jacobians, 1, 2)
    square[:, range(6), range(6)] += damping[:, None] + _DAMPING
    return np.asarray(np.einsum("bxn,bx->bn", jacobians, np.linalg.solve(square, errors[..., None])[..., 0]))
