from safe_ompl.common import BoolArray, FloatArray, IntArray
from safe_ompl.geometry.convex import ShapeTable
from safe_ompl.robot.kinematics import JointTable

class BodyCorners:
    joints: JointTable
    def __init__(self, joints: JointTable, carriers: IntArray, corners: FloatArray, pads: FloatArray) -> None: ...
    def speeds(self, values: FloatArray, rates: FloatArray) -> FloatArray: ...

class ClosingGaps:
    joints: JointTable
    shapes: ShapeTable
    def __init__(
        self,
        joints: JointTable,
        shapes: ShapeTable,
        pairs: IntArray,
        sides: IntArray,
        radii: FloatArray,
        widths: FloatArray,
        harmless: FloatArray,
    ) -> None: ...
    def rates(self, values: FloatArray, sizes: FloatArray, dq_ds: FloatArray, bodies: FloatArray) -> FloatArray: ...

class LimbArrivals:
    joints: JointTable
    shapes: ShapeTable
    def __init__(
        self,
        joints: JointTable,
        shapes: ShapeTable,
        bodies: IntArray,
        limbs: IntArray,
        speeds: FloatArray,
        clearance: float,
        reaction: float,
    ) -> None: ...
    def along(
        self, values: FloatArray, half: FloatArray, soon: float, short: float
    ) -> tuple[FloatArray, FloatArray, IntArray]: ...

def acceleration_bounds(radii: FloatArray, turned: BoolArray, dq_ds: FloatArray, d2q_ds2: FloatArray) -> FloatArray: ...
