"""Curves, bands and boxes: what the danger along paths and the times of planners look like.

All functions take numbers and write one picture file; the ending of its name decides the format (PNG,
SVG or PDF).
"""

from safe_ompl.plots.plan import plot_plan
from safe_ompl.plots.planners import plot_bands, plot_clearance_danger, plot_profiles, plot_times

__all__ = ["plot_bands", "plot_clearance_danger", "plot_plan", "plot_profiles", "plot_times"]
