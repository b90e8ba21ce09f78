from collections.abc import Callable
from typing import NamedTuple

from safe_ompl.collision import DistanceBounds, Required
from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.danger.static import PointDanger
from safe_ompl.robot.kinematics import EdgeTable

UNKNOWN: int
LOOKED_AT: int
PROVEN: int

class DangerTerms:
    danger: PointDanger
    weight: float
    matrix: FloatArray
    shift: FloatArray
    def __init__(self, danger: PointDanger, weight: float, matrix: FloatArray, shift: FloatArray) -> None: ...
    def path_cost(self, path: FloatArray, step: float) -> tuple[float, int]: ...
    def edge_costs(self, path: FloatArray, wanted: BoolArray, continuous: BoolArray) -> tuple[FloatArray, int]: ...

class QuadraticModel(NamedTuple):
    value: float
    near: float
    gradient: FloatArray
    blocks: FloatArray
    beside: FloatArray

class PricedPath:
    value: float
    near: float
    path: FloatArray
    gradient: FloatArray
    danger: FloatArray
    slopes: FloatArray

class Densities:
    terms: DangerTerms
    carriers: IntArray
    near: FloatArray
    hinges: FloatArray
    def __init__(self, terms: DangerTerms, carriers: IntArray, near: FloatArray, hinges: FloatArray) -> None: ...
    def model(
        self, path: FloatArray, danger: FloatArray | None = None, slopes: FloatArray | None = None
    ) -> QuadraticModel: ...
    def retreat_step(
        self, Q: FloatArray, reference: float, excess_weight: float, onset: float, longest: float
    ) -> tuple[float, float, FloatArray]: ...

class Walk:
    evaluations: int
    def __init__(self, lower: FloatArray, upper: FloatArray) -> None: ...
    @property
    def path(self) -> FloatArray: ...
    @property
    def danger(self) -> FloatArray: ...
    @property
    def slopes(self) -> FloatArray: ...
    @property
    def cost(self) -> float: ...
    def restart(
        self, densities: Densities, path: FloatArray, model: QuadraticModel, held: BoolArray | None = None
    ) -> None: ...
    def resume(self, densities: Densities, path: FloatArray, model: QuadraticModel) -> None: ...
    def descend(self, stop: Callable[[], bool], most: int, largest: float, idle: float) -> bool: ...
    def direction(self) -> tuple[FloatArray, float, float]: ...

def arc_lengths(path: FloatArray) -> FloatArray: ...
def at_arc_lengths(points: FloatArray, arc: FloatArray, s: FloatArray) -> FloatArray: ...
def spread(path: FloatArray, step: float) -> tuple[FloatArray, float]: ...
def gauss_points(path: FloatArray) -> FloatArray: ...
def factored(blocks: FloatArray, beside: FloatArray, moving: BoolArray) -> FloatArray: ...
def bounded_step(gradient: FloatArray, vectors: FloatArray, longest: float) -> FloatArray: ...
def chained(costs: FloatArray) -> IntArray: ...
def prove_edges(
    bounds: DistanceBounds, limits: EdgeTable, required: Required, floor: float, starts: FloatArray, ends: FloatArray
) -> tuple[BoolArray, int]: ...
def weeded_chain(
    bounds: DistanceBounds,
    limits: EdgeTable,
    required: Required,
    floor: float,
    costs: FloatArray,
    known: IntArray,
    most: float,
    path: FloatArray,
) -> tuple[IntArray, int]: ...
