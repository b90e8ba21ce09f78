"""Proofs as tests: `assert_proven`, and what pytest loads where it is installed, the marker `proven`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

# pytest loads this file in every run, so imports are kept out of it.
if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from safe_ompl.scene import Scenario

_MARKER = "proven(motion, scenario, tube=None): fail unless the recorded motion is proven; files beside the test's"


def assert_proven(
    motion: Any, scenario: Scenario | str | Path, *, tube: ArrayLike | Mapping[str, float] | None = None
) -> None:
    """Raise AssertionError unless a motion is proven in a scenario.

    Joint limits, collision, and the scenario's `limits` are proven of the whole motion; not its times.

    Parameters
    ----------
    motion : Motion, what `Motion.of` takes, or a file that `read_motion` reads
        The motion.
    scenario : Scenario, path-like, or name of a scenario
        Robot, scene, and what else must hold.
    tube : optional
        As `check` takes it.

    Raises
    ------
    AssertionError
        Names kind, time, the pair that is too near, and by how much.
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
    """Make the marker known."""
    config.addinivalue_line("markers", _MARKER)


def pytest_runtest_call(item: Any) -> None:
    """Prove the motions of a test's markers before the test itself runs."""
    for mark in item.iter_markers("proven"):
        motion, scenario = (_beside(item.path.parent, given) for given in mark.args)
        assert_proven(motion, scenario, **mark.kwargs)


def _beside(folder: Path, given: Any) -> Any:
    """Return a file beside the test; whatever else is given stays."""
    beside = folder / given if isinstance(given, (str, Path)) else None
    return beside if beside is not None and beside.is_file() else given
