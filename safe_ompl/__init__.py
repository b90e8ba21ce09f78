"""Safety-oriented robot arm motion planning for OMPL (Lacevic & Rocco, Robotica 2013)."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily
from safe_ompl.version import __version__ as __version__

if TYPE_CHECKING:
    from safe_ompl.apps import assert_proven as assert_proven
    from safe_ompl.apps.benchmark import Benchmark as Benchmark
    from safe_ompl.certificates import certificate as certificate, verify as verify
    from safe_ompl.collision import (
        CollisionChecker as CollisionChecker,
        MotionProver as MotionProver,
        TipBounds as TipBounds,
        ToolOrientation as ToolOrientation,
        Verdict as Verdict,
    )
    from safe_ompl.common import (
        CertificateError as CertificateError,
        CollisionError as CollisionError,
        InputError as InputError,
        PlanningError as PlanningError,
        SafeOmplError as SafeOmplError,
        StaleSceneError as StaleSceneError,
        UnknownNameError as UnknownNameError,
    )
    from safe_ompl.danger import (
        CertifiedDanger as CertifiedDanger,
        DangerField as DangerField,
        DangerLimit as DangerLimit,
        KinetostaticField as KinetostaticField,
    )
    from safe_ompl.drawing import view as view
    from safe_ompl.geometry import (
        Box as Box,
        Capsule as Capsule,
        Cylinder as Cylinder,
        Mesh as Mesh,
        Obstacle as Obstacle,
        Person as Person,
        PointCloud as PointCloud,
        Pose as Pose,
        Sphere as Sphere,
    )
    from safe_ompl.io import JointPath as JointPath, load as load, read_motion as read_motion, save as save
    from safe_ompl.live import Surroundings as Surroundings, Tracker as Tracker
    from safe_ompl.live.replanning import Replanner as Replanner, Shield as Shield
    from safe_ompl.motions import (
        Constraints as Constraints,
        Motion as Motion,
        PathTimer as PathTimer,
        RateLimits as RateLimits,
        StandstillError as StandstillError,
        Trajectory as Trajectory,
        check as check,
        check_many as check_many,
        prove_many as prove_many,
        retime as retime,
        time_path as time_path,
        widest_tube as widest_tube,
    )
    from safe_ompl.planning import (
        PlanResult as PlanResult,
        SafeSetup as SafeSetup,
        Tradeoff as Tradeoff,
        plan as plan,
        planner_data as planner_data,
        repair as repair,
        tradeoff as tradeoff,
    )
    from safe_ompl.planning.ompl import (
        CertifiedMotionValidator as CertifiedMotionValidator,
        CollisionFreeValidity as CollisionFreeValidity,
        DangerObjective as DangerObjective,
        RegionGoal as RegionGoal,
        WorkspaceGoal as WorkspaceGoal,
    )
    from safe_ompl.planning.planners import (
        BubblePlanner as BubblePlanner,
        SafeJTRRT as SafeJTRRT,
        SafePRM as SafePRM,
        SafeRRTConnect as SafeRRTConnect,
        make_planner as make_planner,
        planner_names as planner_names,
    )
    from safe_ompl.planning.simplification import PathReport as PathReport, Simplifier as Simplifier
    from safe_ompl.robot import GoalRegion as GoalRegion, Robot as Robot, inverse_kinematics as inverse_kinematics
    from safe_ompl.scene import People as People, Program as Program, Scenario as Scenario, Scene as Scene
    from safe_ompl.tasks import (
        Corridor as Corridor,
        ProgramResult as ProgramResult,
        ToolMotion as ToolMotion,
        ToolPath as ToolPath,
        plan_program as plan_program,
        plan_tool as plan_tool,
        tool_motion as tool_motion,
    )

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
