from collections.abc import Sequence
from typing import Any, NamedTuple

from safe_ompl.common import BoolArray, Counts, FloatArray, IntArray
from safe_ompl.geometry import ConvexBodies
from safe_ompl.geometry.convex import ShapeTable
from safe_ompl.robot import Robot
from safe_ompl.robot.kinematics import EdgeTable, JointTable

ALLOWANCE: float
BLOCK: int

class BoundsProof(NamedTuple):
    proven: bool
    at: float
    left: list[list[float]]
    blocked: bool = False
    def covers(self, low: float, high: float) -> bool: ...

class SomePairs(NamedTuple):
    bodies: Any
    exact: BoolArray

class Required:
    def __init__(self, distances: FloatArray) -> None: ...

class DistanceBounds:
    exact: BoolArray
    groups: Any
    shapes: ShapeTable
    joints: JointTable
    def __init__(
        self, robot: Robot, bodies: ConvexBodies, pairs: IntArray, radii: FloatArray, counts: Counts
    ) -> None: ...
    @property
    def bounded(self) -> bool: ...
    def of(self, Q: FloatArray, pairs: IntArray, enough: float) -> FloatArray: ...
    def clearances(self, Q: FloatArray, enough: float) -> FloatArray: ...
    def nearer(self, q: FloatArray, margins: FloatArray, largest: float) -> tuple[IntArray, bool]: ...
    def near(self, Q: FloatArray, some: SomePairs, within: float, *, least: bool = False) -> FloatArray: ...
    def some(self, pairs: IntArray) -> SomePairs: ...
    def prove(self, curve: Sequence[FloatArray], required: Required, floor: float) -> BoundsProof: ...
    def prove_edge(
        self, start: FloatArray, end: FloatArray, limits: EdgeTable, required: Required, floor: float
    ) -> BoundsProof | None: ...
    def prove_many(self, curves: FloatArray, required: Required, floor: float, workers: int = 1) -> IntArray: ...

def bound_reaches(shapes: ShapeTable, lower: FloatArray, upper: FloatArray, distance: float) -> IntArray: ...
def distance_gradients(joints: JointTable, values: FloatArray, carriers: IntArray, near: FloatArray) -> FloatArray: ...
def hinge_costs(
    joints: JointTable, values: FloatArray, carriers: IntArray, near: FloatArray, hinges: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]: ...
