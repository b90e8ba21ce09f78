"""Places of the tip: how users write them, and inverse kinematics from several seeds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from safe_ompl.common import FloatArray, InputError, finite_array, positive
from safe_ompl.robot.ik import Place, solve_from_seed
from safe_ompl.robot.robot import Robot

_UNIT = 1e-3  # quaternions whose norm is as near to 1 are normalised; others are taken for mistakes
SEEDS = 16
PRECISION = 1e-4  # [m]


def place_of(robot: Robot, position: Any, rotation: Any = None) -> Place:
    """Return the place that a position, with or without a rotation, or a pose means.

    Parameters
    ----------
    robot : Robot
        The robot.
    position : array_like, shape (3,), or pin.SE3
        Of the tip in the world frame [m]; or its whole pose.
    rotation : array_like, shape (3, 3) or (4,), or pin.Quaternion, optional
        A matrix or a quaternion, x, y, z, w.

    Raises
    ------
    InputError
        Wrong shape, NaN, what is not a rotation; a rotation beside a pose.
    """
    if not isinstance(position, pin.SE3):
        return Place(robot, position, None if rotation is None else _matrix(rotation))
    if rotation is not None:
        raise InputError("rotation of the tip: the pose has one already; give the pose alone")
    return Place(robot, position.translation, position.rotation)


def _matrix(rotation: ArrayLike | pin.Quaternion) -> ArrayLike:
    if isinstance(rotation, pin.Quaternion):
        rotation = rotation.coeffs()
    if np.shape(rotation) != (4,):
        return rotation
    xyzw: FloatArray = finite_array(rotation, (4,), "rotation of the tip")
    norm = float(np.linalg.norm(xyzw))
    if abs(norm - 1) > _UNIT:
        raise InputError(
            f"rotation of the tip: a quaternion (x, y, z, w) must be of unit length, got {xyzw.tolist()}"
        )
    matrix: FloatArray = pin.Quaternion(xyzw / norm).matrix()
    return matrix


def inverse_kinematics(
    robot: Robot,
    position: Any,
    rotation: Any = None,
    *,
    near: ArrayLike | None = None,
    seeds: int = SEEDS,
    seed: int = 0,
    tolerance: float = PRECISION,
    valid: Callable[[FloatArray], bool] | None = None,
) -> FloatArray | None:
    """Return a configuration within the joint limits whose tip is at a place, or None if none is found.

    Parameters
    ----------
    robot : Robot
        The robot.
    position : array_like, shape (3,), or pin.SE3
        Of the tip in the world frame [m]; or its whole pose.
    rotation : array_like, shape (3, 3) or (4,), or pin.Quaternion, optional
        A matrix or a quaternion x, y, z, w; without it any orientation will do.
    near : array_like, shape (n,), optional
        Where the first search begins [rad or m]; with it, of the solutions the one nearest to it is returned.
    seeds : int
        From how many configurations to search, `near` included.
    seed : int
        Of the random numbers that the others come from: the same one gives the same solution.
    tolerance : float
        Largest distance left between tip and place [m]; a radian counts as 0.25 m.
    valid : callable, optional
        From a configuration (n,) to whether it will do: ``lambda q: not checker.in_collision(q)``.

    Returns
    -------
    ndarray, shape (n,), or None
        [rad or m]

    Raises
    ------
    InputError
        Wrong shape, NaN, what is not a rotation, no seeds, or a tolerance that is not positive.

    Examples
    --------
    >>> inverse_kinematics(robot, [0.4, 0.1, 0.5], [0.0, 1.0, 0.0, 0.0])  # doctest: +SKIP
    """
    place = place_of(robot, position, rotation)
    precision = positive(tolerance, "tolerance", "length [m]")
    if isinstance(seeds, bool) or not isinstance(seeds, (int, np.integer)) or seeds < 1:
        raise InputError(f"seeds must be a number of seeds >= 1, got {seeds!r}")
    home = None if near is None else finite_array(near, (robot.n,), "near")
    begin = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (int(seeds), robot.n))
    if home is not None:
        begin[0] = np.where(robot.continuous, home, np.clip(home, robot.lower, robot.upper))
    best: FloatArray | None = None
    for start in begin:
        q = solve_from_seed(place, start, precision)
        if q is None or (valid is not None and not valid(q)):
            continue
        if home is None:
            return q
        if best is None or _apart(robot, home, q) < _apart(robot, home, best):
            best = q
    return best


def _apart(robot: Robot, a: FloatArray, b: FloatArray) -> float:
    return float(np.linalg.norm(robot.difference(a, b)))
