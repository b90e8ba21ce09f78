"""An extension of griffe: planners are documented with their parameters, which they get when they are imported."""

import inspect
from importlib import import_module
from typing import Any

import griffe


class PlannerDocstrings(griffe.Extension):
    """Replaces the docstrings of planners by those that they have at run time."""

    def on_class_instance(self, *, cls: griffe.Class, **options: Any) -> None:
        """Look at a class that griffe has read."""
        if "SafePlanner" in map(str, cls.bases):
            cls.docstring.value = inspect.getdoc(getattr(import_module(cls.module.path), cls.name))
