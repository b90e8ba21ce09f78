"""Safety-oriented robot arm motion planning for OMPL (Lacevic & Rocco, Robotica 2013)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily
from safe_ompl.version import __version__ as __version__

if TYPE_CHECKING:
    from safe_ompl.apps import assert_proven
    from safe_ompl.apps.benchmark import Benchmark
    from safe_ompl.certificates import certificate, verify
    from safe_ompl.collision import CollisionChecker, MotionProver, TipBounds, ToolOrientation, Verdict
    from safe_ompl.common import (
        CertificateError,
        CollisionError,
        InputError,
        PlanningError,
        SafeOmplError,
        StaleSceneError,
        UnknownNameError,
    )
    from safe_ompl.danger import CertifiedDanger, DangerField, DangerLimit, KinetostaticField
    from safe_ompl.geometry import Box, Capsule, Cylinder, Mesh, Obstacle, Person, PointCloud, Pose, Sphere
    from safe_ompl.io import JointPath, load, read_motion, save
    from safe_ompl.motions import Motion, check, retime, widest_tube
    from safe_ompl.paths import Constraints, PathReport, Simplifier
    from safe_ompl.people import Surroundings, Tracker
    from safe_ompl.people.replanning import Replanner, Shield
    from safe_ompl.planning import (
        PlanResult,
        ProgramResult,
        SafeSetup,
        Tradeoff,
        plan,
        plan_program,
        planner_data,
        repair,
        tradeoff,
    )
    from safe_ompl.planning.ompl import (
        CertifiedMotionValidator,
        CollisionFreeValidity,
        DangerObjective,
        RegionGoal,
        WorkspaceGoal,
    )
    from safe_ompl.planning.planners import (
        BubblePlanner,
        SafeJTRRT,
        SafePRM,
        SafeRRTConnect,
        make_planner,
        planner_names,
    )
    from safe_ompl.robot import GoalRegion, Robot, inverse_kinematics
    from safe_ompl.scene import People, Program, Scenario, Scene
    from safe_ompl.tasks import Corridor, ToolMotion, ToolPath, tool_motion
    from safe_ompl.trajectories import PathTimer, RateLimits, StandstillError, Trajectory, time_path
    from safe_ompl.view import view

__all__ = [
    "Benchmark",
    "Box",
    "BubblePlanner",
    "Capsule",
    "CertificateError",
    "CertifiedDanger",
    "CertifiedMotionValidator",
    "CollisionChecker",
    "CollisionError",
    "CollisionFreeValidity",
    "Constraints",
    "Corridor",
    "Cylinder",
    "DangerField",
    "DangerLimit",
    "DangerObjective",
    "GoalRegion",
    "InputError",
    "JointPath",
    "KinetostaticField",
    "Mesh",
    "Motion",
    "MotionProver",
    "Obstacle",
    "PathReport",
    "PathTimer",
    "People",
    "Person",
    "PlanResult",
    "PlanningError",
    "PointCloud",
    "Pose",
    "Program",
    "ProgramResult",
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
    "Shield",
    "Simplifier",
    "Sphere",
    "StaleSceneError",
    "StandstillError",
    "Surroundings",
    "TipBounds",
    "ToolMotion",
    "ToolOrientation",
    "ToolPath",
    "Tracker",
    "Tradeoff",
    "Trajectory",
    "UnknownNameError",
    "Verdict",
    "WorkspaceGoal",
    "assert_proven",
    "certificate",
    "check",
    "inverse_kinematics",
    "load",
    "make_planner",
    "plan",
    "plan_program",
    "planner_data",
    "planner_names",
    "read_motion",
    "repair",
    "retime",
    "save",
    "time_path",
    "tool_motion",
    "tradeoff",
    "verify",
    "view",
    "widest_tube",
]

__getattr__, __dir__ = lazily(__name__, __file__)
