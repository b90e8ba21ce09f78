"""Plain checks of claimed speeds of the tool and of all links of a timed motion: for the verifier of certificates.

At the centre of an interval of the curve the velocity x′ of a point, by arc length, is the sum of what the joints add;
no point of a body is faster than its fastest corner. Away from it x′ changes by no more than ‖x″‖ allows: with joint
j nearer to the base than joint k, ‖∂²x/∂q_j∂q_k‖ is no more than R_k if k turns, 1 if it slides, and 0 where j slides.
R_k is the length of the chain from joint k to the farthest point.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from safe_ompl.certificates.verifier.distances import corners, joints_below
from safe_ompl.certificates.verifier.motion import PlainMotion, PlainPiece
from safe_ompl.common import FloatArray
from safe_ompl.robot import Robot

_ROUNDING = 1e-9  # relative
_SMALLEST = 1e-7  # [rad] intervals that are not divided any more
_PARTS = 4  # of a cell, for the bounds over whole cells


class _Body(NamedTuple):
    """Points in the frame of a joint, the radius of the balls about them, and the joints below, deepest first."""

    points: FloatArray
    pad: float
    carrier: int
    movers: list[int]


class PlainSpeeds:
    """The largest speeds of the tip, or of every body and the tip.

    Parameters
    ----------
    robot : Robot
        The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._model, self._data = robot.shared.model, robot.shared.model.createData()
        self._axes = robot.shared.chain.axes
        frame = self._model.frames[robot.tip_frame]
        self._tip = self._body(np.array(frame.placement.translation)[None], 0.0, int(frame.parentJoint))
        self._all = [self._tip]
        for link in robot.shared.collision_model.geometryObjects:
            points, pad = corners(link.geometry)
            place = link.placement
            points = points @ place.rotation.T + place.translation
            self._all.append(self._body(points, pad, int(link.parentJoint)))
        self._all = [body for body in self._all if body.movers]

    def _body(self, points: FloatArray, pad: float, carrier: int) -> _Body:
        return _Body(points, pad, carrier, joints_below(self._robot, carrier))

    def exceeded(self, motion: PlainMotion, limit: float, *, tool: bool) -> float | None:
        """Return where on the curve [rad] the tip, or any body, is not proven to keep to a speed [m/s]; else None."""
        bodies = [self._tip] if tool else self._all
        for j, rate in enumerate(motion.fastest.tolist()):
            start = motion.starts[motion.of[j]]
            piece = motion.pieces[motion.of[j]]
            waiting = [(float(motion.edges[j]) - start, float(motion.edges[j + 1]) - start)]
            while waiting:
                first, last = waiting.pop()
                middle, half = (first + last) / 2, (last - first) / 2
                exact, bound = self._bounds(piece, middle, half, bodies)
                if bound * rate <= limit * (1 + _ROUNDING):
                    continue
                if exact * rate > limit * (1 + _ROUNDING) or half < _SMALLEST:
                    return start + middle
                waiting += [(first, middle), (middle, last)]
        return None

    def bounds(self, motion: PlainMotion) -> FloatArray:
        """Return bounds (C,) of the speed of all points by arc length in the cells of a motion [m/rad]."""
        found = np.zeros(len(motion.of))
        for j, number in enumerate(motion.of):
            edges = np.linspace(motion.edges[j], motion.edges[j + 1], _PARTS + 1) - motion.starts[number]
            half = (edges[1] - edges[0]) / 2
            for middle in (edges[1:] + edges[:-1]) / 2:
                bound = self._bounds(motion.pieces[number], float(middle), float(half), self._all)[1]
                found[j] = max(found[j], bound)
        return found

    def _bounds(
        self, piece: PlainPiece, middle: float, half: float, bodies: list[_Body]
    ) -> tuple[float, float]:
        """Return the largest ‖x′‖ at the middle of an interval, and a bound of it throughout."""
        robot = self._robot
        q, coupling = piece.at(middle), robot.coupling
        pin.forwardKinematics(self._model, self._data, robot.pinocchio_configuration(q))
        turns, drifts = self._joint_motions(coupling.motions(piece.slope(middle)))
        steps = coupling.reach(piece.steps(1.0))
        slid = np.abs(coupling.values(q)) + half * steps
        exact = bound = 0.0
        for body in bodies:
            here = self._speed(body, turns, drifts)
            exact, bound = max(exact, here), max(bound, here + half * self._bend(body, steps, piece, slid))
        return exact, bound

    def _joint_motions(self, rates: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what each joint (m, 3) adds to the motion of what it carries: x moves with turn × x + drift."""
        joints = list(self._data.oMi)[1:]
        axes = [joint.rotation @ axis for joint, axis in zip(joints, self._axes, strict=True)]
        motions = rates[:, None] * np.array(axes)
        sliding = self._robot.joint_prismatic[:, None]
        about = np.cross(np.array([joint.translation for joint in joints]), motions)
        return np.where(sliding, 0.0, motions), np.where(sliding, motions, about)

    def _speed(self, body: _Body, turns: FloatArray, drifts: FloatArray) -> float:
        place = self._data.oMi[body.carrier]
        turning, drift = turns[body.movers].sum(axis=0), drifts[body.movers].sum(axis=0)
        points = body.points @ place.rotation.T + place.translation
        velocity = np.cross(turning, points) + drift
        return float(np.linalg.norm(velocity, axis=1).max() + body.pad * np.linalg.norm(turning))

    def _bend(self, body: _Body, steps: FloatArray, piece: PlainPiece, slid: FloatArray) -> float:
        """Return a bound of ‖x″‖ of the points of a body, by arc length."""
        length = float(np.linalg.norm(body.points, axis=1).max()) + body.pad
        bends = self._robot.coupling.reach(piece.bends)
        return bend_bound(self._robot, body.movers, length, steps, bends, slid)


def bend_bound(
    robot: Robot, movers: list[int], length: float, steps: FloatArray, bends: FloatArray, slid: FloatArray
) -> float:
    """Return a bound of ‖x″‖ of points, by arc length.

    Parameters
    ----------
    robot : Robot
        The robot.
    movers : list of int
        The joints that move the points, deepest first.
    length : float
        How far the points are from the origin of the first of them at most [m].
    steps, bends : ndarray, shape (m,)
        Bounds of |q′| and |q″| of the joints of the model.
    slid : ndarray, shape (m,)
        How far sliding joints are out at most [m].
    """
    sliding = robot.joint_prismatic
    beneath = float(sum(steps[i] for i in movers if not sliding[i]))
    found = 0.0
    for i in movers:
        radius, own = (1.0, 0.0) if sliding[i] else (length, float(steps[i]))
        beneath -= own
        found += radius * float(steps[i] * (2 * beneath + own) + bends[i])
        length += float(np.linalg.norm(robot.shared.model.jointPlacements[i + 1].translation))
        length += float(slid[i]) if sliding[i] else 0.0
    return found
