"""Curves, bands and boxes: what the danger along paths and the times of planners look like; and small C-spaces.

All functions take numbers or models and write one picture file; the ending of its name decides the format (PNG,
SVG or PDF).
"""

from safe_ompl.plots.cspace import plot_bubbles, plot_cspace_path
from safe_ompl.plots.field import plot_field
from safe_ompl.plots.plan import plot_plan
from safe_ompl.plots.planners import plot_bands, plot_clearance_danger, plot_profiles, plot_times

__all__ = [
    "plot_bands",
    "plot_bubbles",
    "plot_clearance_danger",
    "plot_cspace_path",
    "plot_field",
    "plot_plan",
    "plot_profiles",
    "plot_times",
]
