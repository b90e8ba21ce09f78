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
        Environment variable that names a folder with sources, if pip is to install these instead.
    options : dict
        What the runner is given.
    """

    name: str
    runner: str
    environment: str = ""
    requirements: tuple[str, ...] = ()
    options: dict[str, object] = field(default_factory=dict)
    sources: str = ""


SYSTEMS = (
    System("safe_ompl", "safe_ompl_"),
    System("safe_ompl, raw", "safe_ompl_", options={"simplify": 0}),
    System("OMPL RRTConnect + simplifier, 0.02", "ompl_", options={"resolution": 0.02}),
    *(System(f"roboplan, {x}", "roboplan_", "roboplan", ("roboplan",), {"resolution": x}) for x in (0.05, 0.01, 0.005)),
    System("MPlib", "mplib_", "mplib", ("mplib", "setuptools<80")),
    *(System(f"plainmp, {x}", "plainmp_", "plainmp", ("plainmp",), {"resolution": x}) for x in (0.05, 0.005)),
    System("VAMP", "vamp_", "vamp", ("vamp-planner",), sources="VAMP_DIR"),
)

REPAIR = System("our proof and repair", "repair_")  # of every path of another system
