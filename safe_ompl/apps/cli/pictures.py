"""Pictures of commands: a check that they can be drawn (extra `safe-ompl[plots]`), and those of `compare`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from safe_ompl.apps.benchmark import Summary
from safe_ompl.apps.cli.files import check_writable
from safe_ompl.common import InputError
from safe_ompl.planning import SafeSetup
from safe_ompl.view import drawn_path, plots, render_comparison

EXTRAS = ("matplotlib",)


def how_to_get_pictures() -> str | None:
    """Return what to install before pictures can be drawn, or None."""
    missing = [module for module in EXTRAS if find_spec(module) is None]
    if not missing:
        return None
    return f"{' and '.join(missing)} missing; get pictures with: pip install 'safe-ompl[plots]'"


def check_picture(file: str | None, option: str) -> None:
    """Raise InputError, naming `option`, if a picture cannot be drawn or written."""
    if file is None:
        return
    if Path(file).suffix.lower() != ".png":
        raise InputError(f"{file!r} must end in .png", option)
    advice = how_to_get_pictures()
    if advice:
        raise InputError(advice, option)
    check_writable(file, option)


def draw_comparison(setup: SafeSetup, summaries: Sequence[Summary], folder: Path) -> None:
    """Draw what a campaign found: danger profiles and bands, times, and the robot along the typical paths."""
    profiles = {summary.planner: summary.profiles for summary in summaries}
    plots.plot_profiles(profiles, folder / "profiles.png")
    plots.plot_bands(profiles, folder / "bands.png")
    plots.plot_times({s.planner: s.metrics["planning_time"] for s in summaries}, folder / "times.png")
    plots.plot_clearance_danger(
        {s.planner: s.metrics["clearance_min"] for s in summaries},
        {s.planner: s.metrics["danger_mean"] for s in summaries},
        folder / "clearances.png",
    )
    # Without accents: planners beside each other choose their colours together.
    typical = {s.planner: replace(drawn_path(s.typical), accent=None) for s in summaries if s.typical}
    if typical:
        render_comparison(setup.robot, setup.scene, typical, folder / "paths.png")
