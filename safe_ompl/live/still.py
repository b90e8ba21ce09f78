"""Proofs among what stands still, that hold for ever."""

from __future__ import annotations

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.motion import CertifiedMotion
from safe_ompl.errors import InputError
from safe_ompl.robot.robot import Robot
from safe_ompl.scene.scene import Scene
from safe_ompl.trajectories.blends import ArcProof
from safe_ompl.trajectories.curve import BlendedCurve


def check_motion(motion: CertifiedMotion, robot: Robot, still: Scene) -> None:
    """Raise InputError unless what proves motions is of this robot among all that stands still."""
    checker = motion.checker
    if checker.robot.joint_names != robot.joint_names:
        raise InputError(f"is of the robot {checker.robot.name!r}, not of {robot.name!r}", "motion")
    for name in sorted(set(checker.scene.names) ^ set(still.names)):
        where = "in its scene, but it moves" if name in checker.scene.names else "not in its scene"
        raise InputError(f"{name!r} is {where}: give it the scene of what stands still", "motion")


def prove(curve: BlendedCurve, motion: CertifiedMotion) -> None:
    """Raise InputError unless all of a curve is proven free of what stands still."""
    arcs = ArcProof(motion)
    for k, piece in enumerate(curve.pieces):
        if piece.curvature:
            free = arcs.holds(piece)
        else:
            end: FloatArray = piece.start + piece.length * piece.forward
            free = motion.is_free(piece.start, end)
        if not free:
            raise InputError(
                f"piece {k} of the trajectory, from {piece.start.round(3).tolist()} on, is not free of what stands "
                "still"
            )
