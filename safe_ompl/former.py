"""Former names of documented modules, which work for one version more, with a DeprecationWarning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

from safe_ompl.doors import RENAMED

FORMER = {  # what the documentation of the version before imported from
    "safe_ompl.exchange": "safe_ompl.io",
    "safe_ompl.exchange.timed_motion": "safe_ompl.io",
    "safe_ompl.live": "safe_ompl.people.replanning",
    "safe_ompl.live.command": "safe_ompl.people.replanning",
    "safe_ompl.live.replanner": "safe_ompl.people.replanning",
    "safe_ompl.live.ticks": "safe_ompl.io",
    "safe_ompl.pictures": "safe_ompl.view",
    "safe_ompl.pictures.plots": "safe_ompl.view.plots",
    "safe_ompl.pictures.render": "safe_ompl.view",
    "safe_ompl.plugins": "safe_ompl.planning.ompl",
    "safe_ompl.plugins.states": "safe_ompl.planning.ompl",
    "safe_ompl.viewer": "safe_ompl.view",
}


class FormerModules(MetaPathFinder, Loader):
    """Makes modules of former names, which hand out what is now in another module."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return how to make the module `name`; None if it is no former name."""
        return ModuleSpec(name, self, is_package=True) if name in FORMER else None

    def exec_module(self, module: ModuleType) -> None:
        """Fill a module of a former name."""
        now = FORMER[module.__name__]
        warnings.warn(f"{module.__name__} is now {now}", DeprecationWarning, stacklevel=2)
        module.__getattr__ = partial(_found, import_module(now))  # type: ignore[method-assign]


def _found(module: ModuleType, name: str) -> object:
    return getattr(module, RENAMED.get(name, name))


def know_former_modules() -> None:
    """Let Python find modules by their former names."""
    if not any(isinstance(finder, FormerModules) for finder in sys.meta_path):
        sys.meta_path.append(FormerModules())
