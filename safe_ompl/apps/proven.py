"""Prove motions in tests, with the function `assert_proven` or the pytest marker `proven`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

# pytest loads this file in every run, so the imports that take time are inside the functions.
if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from safe_ompl.scene import Scenario

_MARKER = "proven(motion, scenario, tube=None): fail unless the recorded motion is proven; files beside the test's"


def assert_proven(
    motion: Any, scenario: Scenario | str | Path, *, tube: ArrayLike | Mapping[str, float] | None = None
) -> None:
    """Raise AssertionError unless a motion is proven in a scenario.

    Joint limits, freedom from collision, and the scenario's `limits` are proven for the whole motion. The times of the
    motion are not checked.

    Parameters
    ----------
    motion : Motion, what `Motion.of` takes, or a file that `read_motion` reads
        The motion.
    scenario : Scenario, path-like, or name of a scenario
        The scenario with robot, scene and limits.
    tube : optional
        The tube around the motion, as for `check`.

    Raises
    ------
    AssertionError
        If the motion is not proven. The message names the kind of violation, the time, the pair that is too near, and
        the missing distance.
    InputError
        If motion or scenario cannot be read.
    """
    from safe_ompl.common import CollisionError
    from safe_ompl.io import read_motion
    from safe_ompl.planning import setup_scenario
    from safe_ompl.scene import Scenario

    if not isinstance(scenario, Scenario):
        scenario = Scenario.load(scenario)
    robot, what = scenario.build_robot(), f"motion of {scenario.name}"
    if isinstance(motion, (str, Path)):
        what, motion = str(motion), read_motion(motion, robot)
    try:
        setup = setup_scenario(scenario, robot)
        if tube is not None:
            setup.setTube(tube)
    except CollisionError as error:
        raise AssertionError(f"{what}: not proven: {error}") from None
    found = setup.check(motion)
    if not found:
        raise AssertionError(f"{what}: {found}")


def pytest_configure(config: Any) -> None:
    """Register the marker `proven`."""
    config.addinivalue_line("markers", _MARKER)


def pytest_runtest_call(item: Any) -> None:
    """Prove the motions that the markers of a test name, before the test runs."""
    for mark in item.iter_markers("proven"):
        motion, scenario = (_beside(item.path.parent, given) for given in mark.args)
        assert_proven(motion, scenario, **mark.kwargs)


def _beside(folder: Path, given: Any) -> Any:
    """Return the path of a file in the folder of the test. If there is no such file, return `given`."""
    beside = folder / given if isinstance(given, (str, Path)) else None
    return beside if beside is not None and beside.is_file() else given
