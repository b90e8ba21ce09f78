"""The systems that are compared: what pip installs for each, which program runs it, and with which options."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class System:
    """One row of the table.

    Attributes
    ----------
    name : str
        As the table calls it.
    runner : str
        Program in `runners/`.
    environment : str
        Name of its virtual environment; systems with the same one share it.
    requirements : tuple of str
        What pip installs there; empty for the environment that runs the bench.
    sources : str
        Environment variable that names a folder with the system's sources, if pip is to install them instead.
    options : dict
        What the runner is given.
    """

    name: str
    runner: str
    environment: str = ""
    requirements: tuple[str, ...] = ()
    options: dict[str, object] = field(default_factory=dict)
    sources: str = ""


_OMPL = "OMPL RRTConnect + simplifier, 0.02"
_ROBOPLAN = ("roboplan",)

SYSTEMS = (
    System("safe_ompl", "safe_ompl_"),
    System("safe_ompl, simplify 0.05 s", "safe_ompl_", options={"simplify": 0.05}),
    System("safe_ompl, raw", "safe_ompl_", options={"simplify": 0}),
    System("safe_ompl, classical", "safe_ompl_", options={"planner": "ClassicRRTConnect"}),
    System(_OMPL, "ompl_", options={"resolution": 0.02}),
    System("roboplan, 0.05", "roboplan_", "roboplan", _ROBOPLAN, {"resolution": 0.05}),
    System("roboplan, 0.01", "roboplan_", "roboplan", _ROBOPLAN, {"resolution": 0.01}),
    System("roboplan, 0.005", "roboplan_", "roboplan", _ROBOPLAN, {"resolution": 0.005}),
    System("roboplan, 0.002", "roboplan_", "roboplan", _ROBOPLAN, {"resolution": 0.002}),
    System("MPlib", "mplib_", "mplib", ("mplib", "setuptools<80")),
    System("PyRoboPlan, 0.05", "pyroboplan_", "pyroboplan", ("pyroboplan",), {"resolution": 0.05}),
    *(System(f"plainmp, {x}", "plainmp_", "plainmp", ("plainmp",), {"resolution": x}) for x in (0.05, 0.005)),
    System("VAMP", "vamp_", "vamp", sources="VAMP_DIR"),
)

REPAIR = System("our proof and repair", "repair_")  # of every path of another system
REPAIRED = ("roboplan, 0.05", "plainmp, 0.05", "VAMP", _OMPL)  # whose repaired paths are rows of their own
