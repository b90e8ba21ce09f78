from typing import Any, NamedTuple

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.danger.static import SkeletonTable

def link_terms(
    places: FloatArray, velocities: FloatArray, links: IntArray, points: FloatArray, by_length: bool, isotropic: bool
) -> FloatArray: ...
def gradients(
    places: FloatArray,
    velocities: FloatArray,
    links: IntArray,
    points: FloatArray,
    weights: FloatArray,
    ahead: float,
    spread: float,
    by_length: bool,
) -> FloatArray: ...

class CellMotions(NamedTuple):
    places: FloatArray
    velocities: FloatArray
    speeds: FloatArray
    accelerations: FloatArray
    halves: FloatArray
    strokes: FloatArray
    rates: FloatArray

def cell_bounds(
    cells: CellMotions, links: IntArray, points: FloatArray, gamma: float, by_length: bool, enough: FloatArray
) -> FloatArray: ...
def highest(
    skeleton: SkeletonTable, values: FloatArray, rates: FloatArray, groups: Any, ahead: float, spread: float
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]: ...
