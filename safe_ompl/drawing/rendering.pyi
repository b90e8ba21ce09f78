from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from safe_ompl.common import FloatArray, IntArray
from safe_ompl.drawing.light import Light

SUBPIXELS: Final[int]
FLOOR_VALUE: Final[float]

class Painted(NamedTuple):
    vertices: FloatArray
    normals: FloatArray
    faces: IntArray
    owners: IntArray
    paint: FloatArray

class View(NamedTuple):
    eye: FloatArray
    axes: FloatArray
    scale: float
    key: FloatArray

class Shading:
    def __init__(self, solid: Painted, light: Light, view: View) -> None: ...
    def picture(self, faces: NDArray[np.int32], floor_nearness: FloatArray) -> FloatArray: ...

def draw_triangles(
    points: FloatArray, faces: IntArray, first: int, nearness: NDArray[np.float32], owner: NDArray[np.int32]
) -> None: ...
def nearest_triangles(
    points: FloatArray, faces: IntArray, width: int, height: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]: ...
def interpolated(
    vertices: FloatArray, corners: IntArray, values: FloatArray, eye: FloatArray, rays: FloatArray
) -> FloatArray: ...
