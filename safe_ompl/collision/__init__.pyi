from . import bubbles as bubbles
from .bubbles import INSIDE as INSIDE, Bubble as Bubble
from .checker import Clearance as Clearance, CollisionChecker as CollisionChecker
from .distances import NearPairs as NearPairs, PairDistances as PairDistances
from .motion import (
    FLOOR as FLOOR,
    MotionLimit as MotionLimit,
    MotionProver as MotionProver,
    MotionVerdict as MotionVerdict,
    Verdict as Verdict,
)
from .pairs import PairSet as PairSet
from .proofs import ALLOWANCE as ALLOWANCE, DistanceBounds as DistanceBounds, Required as Required
from .self_filter import robot_points as robot_points, without_robot as without_robot
from .separation import (
    TOUCHING_ONLY as TOUCHING_ONLY,
    MinClearance as MinClearance,
    RequiredDistances as RequiredDistances,
    Separation as Separation,
)
from .tool_limits import TipBounds as TipBounds, ToolLimit as ToolLimit, ToolOrientation as ToolOrientation
