from collections.abc import Callable

from safe_ompl.collision import MotionProver
from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.danger import DangerField
from safe_ompl.planning.simplification.cost import ObstacleCost
from safe_ompl.planning.simplification.descent import ActiveSetCost
from safe_ompl.robot import StepLimits

MOST: int
UNKNOWN: int
LOOKED_AT: int
RETREAT_STEP: float

class EdgeProofs:
    def __init__(self, motion: MotionProver, stop: Callable[[], bool] = ...) -> None: ...
    def check(self, path: FloatArray) -> None: ...
    def accept(self, path: FloatArray) -> None: ...
    def inherit(self, path: FloatArray) -> None: ...
    def keep(self, margin: float) -> None: ...
    def refused(self, path: FloatArray) -> list[int]: ...
    def chained(self, path: FloatArray, costs: FloatArray, most: float, known: IntArray) -> list[int]: ...
    def held_back(self, path: FloatArray, known: FloatArray) -> tuple[FloatArray, BoolArray | None]: ...

def retreat(
    end: FloatArray, obstacles: ObstacleCost, field: DangerField, limits: StepLimits, stop: Callable[[], bool]
) -> FloatArray: ...
def shortcut(
    path: FloatArray,
    cost: ActiveSetCost,
    proofs: EdgeProofs,
    stop: Callable[[], bool],
    most: int = 40,
    worth: float = 1.0,
) -> FloatArray | None: ...
def joined(
    path: FloatArray, cost: ActiveSetCost, proofs: EdgeProofs, stop: Callable[[], bool]
) -> FloatArray | None: ...
def cheapest_proven_chain(
    path: FloatArray,
    wanted: BoolArray,
    cost: ActiveSetCost,
    proofs: EdgeProofs,
    stop: Callable[[], bool],
    worth: float = ...,
    known: IntArray | None = None,
) -> FloatArray | None: ...
