"""Safety-oriented robot arm motion planning for OMPL (Lacevic & Rocco, Robotica 2013)."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from safe_ompl.collision.checker import CollisionChecker
from safe_ompl.collision.motion import CertifiedMotion, Verdict
from safe_ompl.collision.tool_limits import TipBounds, ToolOrientation
from safe_ompl.danger.certified import CertifiedDanger, DangerLimit
from safe_ompl.danger.field import DangerField
from safe_ompl.danger.kinetostatic import KinetostaticField
from safe_ompl.errors import (
    CertificateError,
    CollisionError,
    InputError,
    PlanningError,
    SafeOmplError,
    StaleSceneError,
    UnknownNameError,
)
from safe_ompl.paths.report import PathReport
from safe_ompl.paths.simplify.simplifier import simplify_danger
from safe_ompl.people.tracking import Tracker
from safe_ompl.planners.bubble import BubblePlanner
from safe_ompl.planners.jt_rrt import SafeJTRRT
from safe_ompl.planners.prm import SafePRM
from safe_ompl.planners.registry import make_planner, planner_names
from safe_ompl.planners.rrt_connect import SafeRRTConnect
from safe_ompl.plugins.constraints import Constraints
from safe_ompl.plugins.duration import DurationObjective
from safe_ompl.plugins.goals import WorkspaceGoal
from safe_ompl.plugins.motion import CertifiedMotionValidator
from safe_ompl.plugins.objective import DangerObjective, PeakDangerObjective
from safe_ompl.plugins.region_goal import RegionGoal
from safe_ompl.plugins.validity import CollisionFreeValidity
from safe_ompl.robot.ik_search import inverse_kinematics
from safe_ompl.robot.region import GoalRegion
from safe_ompl.robot.robot import Robot
from safe_ompl.scenario.people import People
from safe_ompl.scenario.scenario import Scenario
from safe_ompl.scene.obstacle import Obstacle
from safe_ompl.scene.pose import Pose
from safe_ompl.scene.scene import Scene
from safe_ompl.scene.shapes.basic import Box, Capsule, Cylinder, Sphere
from safe_ompl.scene.shapes.cloud import PointCloud
from safe_ompl.scene.shapes.mesh import Mesh
from safe_ompl.scene.shapes.person import Person
from safe_ompl.setup.from_scenario import plan
from safe_ompl.setup.given_planner import planner_data
from safe_ompl.setup.result import PlanResult
from safe_ompl.setup.safe_setup import SafeSetup
from safe_ompl.trajectories.caps import StandstillError
from safe_ompl.trajectories.limits import RateLimits
from safe_ompl.trajectories.timing import PathTimer, time_path
from safe_ompl.trajectories.trajectory import Trajectory
from safe_ompl.version import __version__ as __version__

if TYPE_CHECKING:
    from safe_ompl.benchmark.benchmark import Benchmark
    from safe_ompl.exchange.files import load, save
    from safe_ompl.exchange.joint_path import JointPath
    from safe_ompl.paths.certificate.issue import certificate
    from safe_ompl.paths.certificate.verifier.verify import verify
    from safe_ompl.people.replanning import Replanner
    from safe_ompl.view import view

_LATER = {  # what planning does without is imported when it is first asked for
    "Benchmark": "safe_ompl.benchmark.benchmark",
    "JointPath": "safe_ompl.exchange.joint_path",
    "Replanner": "safe_ompl.people.replanning.replanner",
    "certificate": "safe_ompl.paths.certificate.issue",
    "load": "safe_ompl.exchange.files",
    "save": "safe_ompl.exchange.files",
    "verify": "safe_ompl.paths.certificate.verifier.verify",
}
_ROOMS = ("view",)  # modules that are public names; `view` can be called

__all__ = [
    "Benchmark",
    "Box",
    "BubblePlanner",
    "Capsule",
    "CertificateError",
    "CertifiedDanger",
    "CertifiedMotion",
    "CertifiedMotionValidator",
    "CollisionChecker",
    "CollisionError",
    "CollisionFreeValidity",
    "Constraints",
    "Cylinder",
    "DangerField",
    "DangerLimit",
    "DangerObjective",
    "DurationObjective",
    "GoalRegion",
    "InputError",
    "JointPath",
    "KinetostaticField",
    "Mesh",
    "Obstacle",
    "PathReport",
    "PathTimer",
    "PeakDangerObjective",
    "People",
    "Person",
    "PlanResult",
    "PlanningError",
    "PointCloud",
    "Pose",
    "RateLimits",
    "RegionGoal",
    "Replanner",
    "Robot",
    "SafeJTRRT",
    "SafeOmplError",
    "SafePRM",
    "SafeRRTConnect",
    "SafeSetup",
    "Scenario",
    "Scene",
    "Sphere",
    "StaleSceneError",
    "StandstillError",
    "TipBounds",
    "ToolOrientation",
    "Tracker",
    "Trajectory",
    "UnknownNameError",
    "Verdict",
    "WorkspaceGoal",
    "certificate",
    "inverse_kinematics",
    "load",
    "make_planner",
    "plan",
    "planner_data",
    "planner_names",
    "save",
    "simplify_danger",
    "time_path",
    "verify",
    "view",
]


def __getattr__(name: str) -> object:
    """Import one of the names in `_LATER` or `_ROOMS`, and keep it."""
    if name in _ROOMS:
        return import_module(f"{__name__}.{name}")
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    found: object = getattr(import_module(_LATER[name]), name)
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """Return all public names, those not yet imported too."""
    return sorted({*globals(), *__all__})
