from typing import Any, TypeAlias

import numpy as np

from safe_ompl.common import FloatArray, IntArray

BODY: np.dtype[Any]
NODE: np.dtype[Any]
POSE: np.dtype[Any]
Records: TypeAlias = np.ndarray[Any, np.dtype[Any]]

class ShapeTable:
    bodies: Any
    starts: IntArray
    vertices: FloatArray
    nodes: Any
    count: int
    bounded: bool
    def __init__(self, bodies: Any, starts: IntArray, vertices: FloatArray, nodes: Any) -> None: ...
    def distance_bounds(self, a: int, b: int, axis: FloatArray, enough: float, least: float) -> tuple[float, float]: ...
    def support(self, g: int, direction: FloatArray) -> FloatArray: ...
    def farthest_from_axes(
        self, centers: FloatArray, axes: FloatArray, radii: FloatArray, half_lengths: FloatArray
    ) -> FloatArray: ...

def extreme_vertices(vertices: FloatArray, grid: int) -> tuple[IntArray, IntArray]: ...
