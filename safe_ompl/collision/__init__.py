"""Collision, distance and margin queries on coal, proofs of whole motions, bubbles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.collision import bubbles
    from safe_ompl.collision.bubbles import INSIDE, Bubble
    from safe_ompl.collision.checker import Clearance, CollisionChecker
    from safe_ompl.collision.distances import PairDistances, Proximity, Witnesses
    from safe_ompl.collision.kernels.proofs import prove_curve
    from safe_ompl.collision.motion import FLOOR, MotionLimit, MotionProver, MotionVerdict, Verdict
    from safe_ompl.collision.pairs import DistanceBounds, PairSet, edge_memory
    from safe_ompl.collision.queries import DISTANCE_ERROR, fresh_data
    from safe_ompl.collision.self_filter import robot_points, without_robot
    from safe_ompl.collision.separation import TOUCHING_ONLY, MinClearance, RequiredDistances, Separation
    from safe_ompl.collision.tool_limits import TipBounds, ToolLimit, ToolOrientation

__all__ = [
    "DISTANCE_ERROR",
    "FLOOR",
    "INSIDE",
    "TOUCHING_ONLY",
    "Bubble",
    "Clearance",
    "CollisionChecker",
    "DistanceBounds",
    "MinClearance",
    "MotionLimit",
    "MotionProver",
    "MotionVerdict",
    "PairDistances",
    "PairSet",
    "Proximity",
    "RequiredDistances",
    "Separation",
    "TipBounds",
    "ToolLimit",
    "ToolOrientation",
    "Verdict",
    "Witnesses",
    "bubbles",
    "edge_memory",
    "fresh_data",
    "prove_curve",
    "robot_points",
    "without_robot",
]

__getattr__, __dir__ = lazily(__name__, __file__)
