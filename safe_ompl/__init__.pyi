from .apps import assert_proven as assert_proven
from .apps.benchmark import Benchmark as Benchmark
from .certificates import certificate as certificate, verify as verify
from .collision import (
    CollisionChecker as CollisionChecker,
    MotionProver as MotionProver,
    TipBounds as TipBounds,
    ToolOrientation as ToolOrientation,
    Verdict as Verdict,
)
from .common import (
    CertificateError as CertificateError,
    CollisionError as CollisionError,
    InputError as InputError,
    PlanningError as PlanningError,
    SafeOmplError as SafeOmplError,
    StaleSceneError as StaleSceneError,
    UnknownNameError as UnknownNameError,
)
from .danger import (
    CertifiedDanger as CertifiedDanger,
    DangerField as DangerField,
    DangerLimit as DangerLimit,
    KinetostaticField as KinetostaticField,
)
from .drawing import view as view
from .geometry import (
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
from .io import load as load, read_motion as read_motion, save as save
from .live import Surroundings as Surroundings, Tracker as Tracker
from .live.replanning import Replanner as Replanner, Shield as Shield
from .motions import (
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
from .planning import (
    PlanResult as PlanResult,
    SafeSetup as SafeSetup,
    Tradeoff as Tradeoff,
    plan as plan,
    planner_data as planner_data,
    repair as repair,
    setup_scenario as setup_scenario,
    tradeoff as tradeoff,
)
from .planning.ompl import (
    CertifiedMotionValidator as CertifiedMotionValidator,
    CollisionFreeValidity as CollisionFreeValidity,
    DangerObjective as DangerObjective,
    RegionGoal as RegionGoal,
    WorkspaceGoal as WorkspaceGoal,
)
from .planning.planners import (
    BubblePlanner as BubblePlanner,
    SafeJTRRT as SafeJTRRT,
    SafePRM as SafePRM,
    SafeRRTConnect as SafeRRTConnect,
    make_planner as make_planner,
    planner_names as planner_names,
)
from .planning.simplification import PathReport as PathReport, Simplifier as Simplifier
from .robot import GoalRegion as GoalRegion, Robot as Robot, inverse_kinematics as inverse_kinematics
from .scene import People as People, Program as Program, Scenario as Scenario, Scene as Scene
from .tasks import (
    Corridor as Corridor,
    ProgramResult as ProgramResult,
    ToolMotion as ToolMotion,
    ToolPath as ToolPath,
    plan_program as plan_program,
    plan_tool as plan_tool,
    tool_motion as tool_motion,
)

__version__: str
