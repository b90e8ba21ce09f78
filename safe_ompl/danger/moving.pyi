from typing import Any

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
def cell_bounds(
    places: FloatArray,
    velocities: FloatArray,
    speeds: FloatArray,
    accelerations: FloatArray,
    halves: FloatArray,
    strokes: FloatArray,
    links: IntArray,
    points: FloatArray,
    gamma: float,
    by_length: bool,
    rates: FloatArray,
    enough: FloatArray,
) -> FloatArray: ...
def highest(
    skeleton: SkeletonTable, values: FloatArray, rates: FloatArray, groups: Any, ahead: float, spread: float
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray]: ...
