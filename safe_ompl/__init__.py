"""Safety-oriented robot arm motion planning for OMPL (Lacevic & Rocco, Robotica 2013)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily
from safe_ompl.version import __version__ as __version__

if TYPE_CHECKING:
    from safe_ompl.apps.benchmark import Benchmark as Benchmark
    from safe_ompl.certificates import certificate as certificate
    from safe_ompl.certificates import verify as verify
    from safe_ompl.collision import CollisionChecker as CollisionChecker
    from safe_ompl.collision import MotionProver as MotionProver
    from safe_ompl.collision import TipBounds as TipBounds
    from safe_ompl.collision import ToolOrientation as ToolOrientation
    from safe_ompl.collision import Verdict as Verdict
    from safe_ompl.common import CertificateError as CertificateError
    from safe_ompl.common import CollisionError as CollisionError
    from safe_ompl.common import InputError as InputError
    from safe_ompl.common import PlanningError as PlanningError
    from safe_ompl.common import SafeOmplError as SafeOmplError
    from safe_ompl.common import StaleSceneError as StaleSceneError
    from safe_ompl.common import UnknownNameError as UnknownNameError
    from safe_ompl.danger import CertifiedDanger as CertifiedDanger
    from safe_ompl.danger import DangerField as DangerField
    from safe_ompl.danger import DangerLimit as DangerLimit
    from safe_ompl.danger import KinetostaticField as KinetostaticField
    from safe_ompl.geometry import Box as Box
    from safe_ompl.geometry import Capsule as Capsule
    from safe_ompl.geometry import Cylinder as Cylinder
    from safe_ompl.geometry import Mesh as Mesh
    from safe_ompl.geometry import Obstacle as Obstacle
    from safe_ompl.geometry import Person as Person
    from safe_ompl.geometry import PointCloud as PointCloud
    from safe_ompl.geometry import Pose as Pose
    from safe_ompl.geometry import Sphere as Sphere
    from safe_ompl.io import JointPath as JointPath
    from safe_ompl.io import load as load
    from safe_ompl.io import read_motion as read_motion
    from safe_ompl.io import save as save
    from safe_ompl.motions import Motion as Motion
    from safe_ompl.motions import check as check
    from safe_ompl.motions import widest_tube as widest_tube
    from safe_ompl.paths import PathReport as PathReport
    from safe_ompl.paths import simplify_danger as simplify_danger
    from safe_ompl.people import Tracker as Tracker
    from safe_ompl.people.replanning import Replanner as Replanner
    from safe_ompl.people.replanning import Shield as Shield
    from safe_ompl.planning import PlanResult as PlanResult
    from safe_ompl.planning import SafeSetup as SafeSetup
    from safe_ompl.planning import plan as plan
    from safe_ompl.planning import planner_data as planner_data
    from safe_ompl.planning import repair as repair
    from safe_ompl.planning.ompl import CertifiedMotionValidator as CertifiedMotionValidator
    from safe_ompl.planning.ompl import CollisionFreeValidity as CollisionFreeValidity
    from safe_ompl.planning.ompl import Constraints as Constraints
    from safe_ompl.planning.ompl import DangerObjective as DangerObjective
    from safe_ompl.planning.ompl import DurationObjective as DurationObjective
    from safe_ompl.planning.ompl import PeakDangerObjective as PeakDangerObjective
    from safe_ompl.planning.ompl import RegionGoal as RegionGoal
    from safe_ompl.planning.ompl import WorkspaceGoal as WorkspaceGoal
    from safe_ompl.planning.planners import BubblePlanner as BubblePlanner
    from safe_ompl.planning.planners import SafeJTRRT as SafeJTRRT
    from safe_ompl.planning.planners import SafePRM as SafePRM
    from safe_ompl.planning.planners import SafeRRTConnect as SafeRRTConnect
    from safe_ompl.planning.planners import make_planner as make_planner
    from safe_ompl.planning.planners import planner_names as planner_names
    from safe_ompl.robot import GoalRegion as GoalRegion
    from safe_ompl.robot import Robot as Robot
    from safe_ompl.robot import inverse_kinematics as inverse_kinematics
    from safe_ompl.scene import People as People
    from safe_ompl.scene import Scenario as Scenario
    from safe_ompl.scene import Scene as Scene
    from safe_ompl.trajectories import PathTimer as PathTimer
    from safe_ompl.trajectories import RateLimits as RateLimits
    from safe_ompl.trajectories import StandstillError as StandstillError
    from safe_ompl.trajectories import Trajectory as Trajectory
    from safe_ompl.trajectories import time_path as time_path
    from safe_ompl.view import view as view

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
