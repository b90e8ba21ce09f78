"""Collision, distance and margin queries on coal, proofs of whole motions, bubbles."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.collision import bubbles as bubbles
    from safe_ompl.collision.broad_phase import DISTANCE_ERROR as DISTANCE_ERROR
    from safe_ompl.collision.broad_phase import fresh_data as fresh_data
    from safe_ompl.collision.bubbles import BUBBLE_SHAPES as BUBBLE_SHAPES
    from safe_ompl.collision.bubbles import INSIDE as INSIDE
    from safe_ompl.collision.bubbles import Bubble as Bubble
    from safe_ompl.collision.checker import Clearance as Clearance
    from safe_ompl.collision.checker import CollisionChecker as CollisionChecker
    from safe_ompl.collision.distances import PairDistances as PairDistances
    from safe_ompl.collision.distances import Proximity as Proximity
    from safe_ompl.collision.distances import Witnesses as Witnesses
    from safe_ompl.collision.motion import FLOOR as FLOOR
    from safe_ompl.collision.motion import MotionLimit as MotionLimit
    from safe_ompl.collision.motion import MotionProver as MotionProver
    from safe_ompl.collision.motion import MotionVerdict as MotionVerdict
    from safe_ompl.collision.motion import Verdict as Verdict
    from safe_ompl.collision.pairs import DistanceBounds as DistanceBounds
    from safe_ompl.collision.pairs import PairSet as PairSet
    from safe_ompl.collision.self_filter import robot_points as robot_points
    from safe_ompl.collision.self_filter import without_robot as without_robot
    from safe_ompl.collision.separation import TOUCHING_ONLY as TOUCHING_ONLY
    from safe_ompl.collision.separation import MinClearance as MinClearance
    from safe_ompl.collision.separation import Separation as Separation
    from safe_ompl.collision.tool_limits import TipBounds as TipBounds
    from safe_ompl.collision.tool_limits import ToolLimit as ToolLimit
    from safe_ompl.collision.tool_limits import ToolOrientation as ToolOrientation

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
