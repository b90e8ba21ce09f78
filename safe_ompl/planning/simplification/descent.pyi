from collections.abc import Callable
from typing import NamedTuple

from safe_ompl.common import FloatArray
from safe_ompl.planning.simplification.cost import DangerDensity, ObstacleCost
from safe_ompl.planning.simplification.costs import DangerTerms, Densities, PricedPath
from safe_ompl.planning.simplification.edges import EdgeProofs
from safe_ompl.robot import Robot, StepLimits

class ActiveSetCost:
    everywhere: DangerDensity
    robot: Robot
    terms: DangerTerms
    ceiling: float
    def __init__(self, danger: DangerDensity, obstacles: ObstacleCost | None, path: FloatArray) -> None: ...
    def look_at(self, path: FloatArray, besides: FloatArray | None = None) -> bool: ...
    def count(self, configurations: int) -> int: ...
    def of(self, path: FloatArray) -> float: ...
    def anchor(self, path: FloatArray) -> int: ...
    def densities(self) -> Densities: ...
    def model(self, path: FloatArray) -> PricedPath: ...

class BestPath:
    path: FloatArray
    ceiling: float
    def __init__(self, path: FloatArray, on_better: Callable[[FloatArray, float], None] | None) -> None: ...
    @property
    def is_confirmed(self) -> bool: ...
    def take(self, path: FloatArray, cost: float) -> bool: ...
    def confirm(self, cost: float) -> bool: ...

class Terms(NamedTuple):
    proofs: EdgeProofs
    limits: StepLimits
    longest: float
    precision: float

class ProvenDescent:
    here: PricedPath
    leads: bool
    def __init__(
        self,
        path: FloatArray,
        retreats: tuple[FloatArray, FloatArray],
        cost: ActiveSetCost,
        terms: Terms,
        best: BestPath,
        stop: Callable[[], bool],
    ) -> None: ...
    def run(self) -> None: ...
