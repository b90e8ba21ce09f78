from . import bubbles as bubbles
from .bounds import ALLOWANCE as ALLOWANCE, DistanceBounds as DistanceBounds
from .bubbles import INSIDE as INSIDE, Bubble as Bubble
from .checker import Clearance as Clearance, CollisionChecker as CollisionChecker
from .distances import NearPairs as NearPairs, PairDistances as PairDistances
from .kernels.distances import hinge_costs as hinge_costs
from .kernels.proofs import prove_curve as prove_curve, prove_edge as prove_edge
from .kernels.tables import EdgeTables as EdgeTables, Required as Required
from .motion import (
    FLOOR as FLOOR,
    MotionLimit as MotionLimit,
    MotionProver as MotionProver,
    MotionVerdict as MotionVerdict,
    Verdict as Verdict,
)
from .pairs import PairSet as PairSet
from .self_filter import robot_points as robot_points, without_robot as without_robot
from .separation import (
    TOUCHING_ONLY as TOUCHING_ONLY,
    MinClearance as MinClearance,
    RequiredDistances as RequiredDistances,
    Separation as Separation,
)
from .tool_limits import TipBounds as TipBounds, ToolLimit as ToolLimit, ToolOrientation as ToolOrientation
