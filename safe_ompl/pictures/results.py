"""Pictures of results: of one plan, and of planners that were compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from safe_ompl.arrays import FloatArray
from safe_ompl.benchmark.campaign import Summary
from safe_ompl.paths.curve import Curve
from safe_ompl.paths.measures import PROFILE_POINTS
from safe_ompl.pictures.plots import plot_bands, plot_clearance_danger, plot_plan, plot_profiles, plot_times
from safe_ompl.pictures.render import render_comparison, render_path, save_png
from safe_ompl.pictures.style import planner_styles
from safe_ompl.scene.shapes.person import Person
from safe_ompl.setup.result import PlanResult
from safe_ompl.setup.safe_setup import SafeSetup

_QUICK_DPI = 100  # of the picture of one plan, which is wanted at once


def draw_plan(setup: SafeSetup, result: PlanResult, file: str) -> None:
    """Draw the robot along a solved plan, and beside it the path's danger and clearance."""
    assert result.path is not None
    assert result.report is not None
    assert result.report.danger is not None
    curves = plot_plan(
        result.report.danger.profile,
        None,
        clearance=_clearances(setup, result.path) or None,
        improvements=[(step.time, step.cost) for step in result.improvements] or None,
        planner=result.planner,
        title=f"{result.planner}, seed {result.seed}",
        dpi=_QUICK_DPI,
    )
    right = np.asarray(curves.canvas.buffer_rgba())[..., :3]
    height = len(right)
    left = render_path(
        setup.robot,
        setup.scene,
        result.path,
        size=(height * 5 // 4, height),
        accent=planner_styles([result.planner])[result.planner].colour,
        closest=result.report.clearance.at,
    )
    save_png(np.hstack([left, right]), file)


def _clearances(setup: SafeSetup, path: FloatArray) -> dict[str, FloatArray]:
    """Return the clearance [m] at equal steps of a path, from what is dangerous and from things, where there are any.

    They are told apart because a shoulder is often as near to its table all along, nearer than the hand to a person.
    """
    curve = Curve(setup.robot, path)
    samples = curve.at(np.linspace(0.0, curve.length, PROFILE_POINTS))
    distances = np.array([setup.checker.distances(q) for q in samples])
    owners = [setup.scene[obstacle] for _, obstacle in setup.checker.distance_names]
    people = all(isinstance(obstacle.shape, Person) for obstacle in owners if obstacle.weight > 0)
    kinds = {
        "people" if people else "what is dangerous": [obstacle.weight > 0 for obstacle in owners],
        "things": [obstacle.weight == 0 for obstacle in owners],
    }
    return {kind: distances[:, chosen].min(axis=1) for kind, chosen in kinds.items() if any(chosen)}


def draw_comparison(setup: SafeSetup, summaries: Sequence[Summary], folder: Path) -> None:
    """Draw what a campaign found: danger profiles and bands, times, and the robot along the typical paths."""
    profiles = {summary.planner: summary.profiles for summary in summaries}
    plot_profiles(profiles, folder / "profiles.png")
    plot_bands(profiles, folder / "bands.png")
    plot_times({s.planner: s.metrics["planning_time"] for s in summaries}, folder / "times.png")
    plot_clearance_danger(
        {s.planner: s.metrics["clearance_min"] for s in summaries},
        {s.planner: s.metrics["danger_mean"] for s in summaries},
        folder / "clearances.png",
    )
    typical = [summary.typical for summary in summaries if summary.typical]
    if typical:
        _draw_paths(setup, typical, folder / "paths.png")


def _draw_paths(setup: SafeSetup, results: Sequence[PlanResult], file: Path) -> None:
    paths, subtitles, closest = {}, {}, {}
    for result in results:
        if result.path is not None and result.report is not None and result.report.danger is not None:
            danger, clearance = result.report.danger, result.report.clearance
            paths[result.planner] = result.path
            closest[result.planner] = clearance.at
            subtitles[result.planner] = (
                f"danger: mean {danger.mean:.1f}, max {danger.max:.1f}; "
                f"clearance: min {1e3 * clearance.min:.0f} mm"
            )
    render_comparison(setup.robot, setup.scene, paths, file, subtitles=subtitles, closest=closest)
