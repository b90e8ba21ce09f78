from collections.abc import Sequence

from safe_ompl.common import BoolArray, FloatArray, IntArray

def stopping_speeds(
    sizes: FloatArray,
    brakes: FloatArray,
    times: FloatArray,
    harmless: FloatArray,
    velocity_limits: FloatArray,
    ends: IntArray,
) -> tuple[FloatArray, IntArray, IntArray, BoolArray]: ...
def spread(edges: FloatArray, radii: FloatArray, stops: IntArray, values: FloatArray, width: float) -> FloatArray: ...
def fastest(sizes: FloatArray, boxes: Sequence[FloatArray], limits: FloatArray, most: FloatArray) -> FloatArray: ...
def ceilings(sizes: FloatArray, squared_limits: FloatArray, brakes: FloatArray, stops: IntArray) -> FloatArray: ...
def drive(
    edges: FloatArray,
    squared_limits: FloatArray,
    brakes: FloatArray,
    ceiling: FloatArray,
    s: float,
    x: float,
    acceleration_share: float,
    tick: float,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]: ...
def squared_velocities_of_stop(
    first: int, last: int, sizes: FloatArray, boxes: Sequence[FloatArray], limits: FloatArray
) -> FloatArray: ...
def time_left(
    sizes: FloatArray,
    boxes: Sequence[FloatArray],
    limits: FloatArray,
    ends: IntArray,
    times: FloatArray,
    harmless: FloatArray,
) -> tuple[FloatArray, IntArray, IntArray, FloatArray, FloatArray]: ...
def derivatives(times: FloatArray, coefficients: FloatArray, pieces: IntArray, s: FloatArray) -> FloatArray: ...
def derivative_ranges(
    times: FloatArray, coefficients: FloatArray, pieces: IntArray, edges: FloatArray
) -> tuple[FloatArray, FloatArray]: ...
