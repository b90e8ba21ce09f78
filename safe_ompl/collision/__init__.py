"""Collision, distance and margin queries on coal, proofs of whole motions, bubbles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.collision import bubbles as bubbles
    from safe_ompl.collision.bounds import ALLOWANCE as ALLOWANCE, DistanceBounds as DistanceBounds
    from safe_ompl.collision.bubbles import INSIDE as INSIDE, Bubble as Bubble
    from safe_ompl.collision.checker import Clearance as Clearance, CollisionChecker as CollisionChecker
    from safe_ompl.collision.distances import NearPairs as NearPairs, PairDistances as PairDistances
    from safe_ompl.collision.kernels.distances import hinge_costs as hinge_costs
    from safe_ompl.collision.kernels.proofs import prove_curve as prove_curve, prove_edge as prove_edge
    from safe_ompl.collision.kernels.tables import EdgeTables as EdgeTables, Required as Required
    from safe_ompl.collision.motion import (
        FLOOR as FLOOR,
        MotionLimit as MotionLimit,
        MotionProver as MotionProver,
        MotionVerdict as MotionVerdict,
        Verdict as Verdict,
    )
    from safe_ompl.collision.pairs import PairSet as PairSet
    from safe_ompl.collision.self_filter import robot_points as robot_points, without_robot as without_robot
    from safe_ompl.collision.separation import (
        TOUCHING_ONLY as TOUCHING_ONLY,
        MinClearance as MinClearance,
        RequiredDistances as RequiredDistances,
        Separation as Separation,
    )
    from safe_ompl.collision.tool_limits import (
        TipBounds as TipBounds,
        ToolLimit as ToolLimit,
        ToolOrientation as ToolOrientation,
    )
    from safe_ompl.geometry import DISTANCE_ERROR as DISTANCE_ERROR

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
