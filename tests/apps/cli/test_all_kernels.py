"""What `doctor` compiles is nearly all that there is."""

from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name

import safe_ompl
from safe_ompl.apps.cli.doctor import ALL_JOBS
from safe_ompl.common.compilation import sources

RARE = {  # called by few, and compiled when they are
    "danger.kernels.danger.all_shares",
    "geometry.kernels.hull_gaps.chords_ahead",
    "geometry.kernels.hull_gaps.separating_axes",
    "robot.kernels.kinematics.point_jacobians",
    "trajectories.stops._braked",
    "trajectories.stops.braking_squares",
    "trajectories.stops.time_left",
}


def test_jobs_ask_for_all_kernels_but_a_few():
    for job in ALL_JOBS:
        resolve_name(job)()
    package = Path(safe_ompl.__file__).parent
    for path in sources(package):
        module = import_module(".".join(("safe_ompl", *path.relative_to(package).with_suffix("").parts)))
        for name, kernel in vars(module).items():
            if hasattr(kernel, "py_func") and kernel.__module__ == module.__name__:
                place = f"{module.__name__}.{name}".removeprefix("safe_ompl.")
                loaded = kernel.signatures or sum(kernel.stats.cache_hits.values())
                assert loaded or place in RARE or not hasattr(kernel._cache, "_cache_file"), place
