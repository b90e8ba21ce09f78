from typing import NamedTuple, TypeAlias

from safe_ompl.common import BoolArray, FloatArray, IntArray

_Frames: TypeAlias = tuple[FloatArray, FloatArray, FloatArray]
_Sets: TypeAlias = tuple[FloatArray, IntArray, FloatArray, FloatArray]
_Borne: TypeAlias = tuple[FloatArray, FloatArray]

class MarginQuery(NamedTuple):
    left: float
    enough: float
    close: float
    stop_at_first: bool

class BodyHulls:
    carriers: IntArray
    vertices: FloatArray
    first_vertex: IntArray
    pads: FloatArray
    middles: FloatArray
    extents: FloatArray
    count: int
    def __init__(
        self,
        carriers: IntArray,
        vertices: FloatArray,
        first_vertex: IntArray,
        pads: FloatArray,
        middles: FloatArray,
        extents: FloatArray,
    ) -> None: ...
    def gaps(
        self, at: IntArray, until: FloatArray, borne: _Borne, cells: _Frames, sets: _Sets, query: MarginQuery
    ) -> tuple[float, int, int, int]: ...
    def cell_gaps(
        self, at: IntArray, borne: _Borne, cells: _Frames, sets: _Sets, left: float, far: float, close: float
    ) -> FloatArray: ...
    def separating_axes(self, cells: _Frames, sets: _Sets, far: float) -> tuple[FloatArray, FloatArray]: ...
    def chords_ahead(
        self, cells: _Frames, axes: FloatArray, apart: FloatArray, curvatures: FloatArray
    ) -> BoolArray: ...
