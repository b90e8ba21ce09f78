"""Parameters of planners, declared once as data: default, bounds, unit and meaning."""

from __future__ import annotations

import inspect
import re
import textwrap
import warnings
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Generic, TypeVar, cast, overload

from safe_ompl.errors import InputError, UnknownNameError
from safe_ompl.inputs import flag, number, whole_number

T = TypeVar("T", bool, int, float, str)
_WIDTH = 100  # of generated docstrings


@dataclass(eq=False)
class Parameter(Generic[T]):
    """A parameter of a planner, declared as an attribute of its class.

    >>> class Planner(SafePlanner):  # doctest: +SKIP
    ...     goal_bias = Parameter(0.05, "Share of the extensions towards a goal.", at_least=0, at_most=1)

    The declaration gives `Planner` the methods `setGoalBias` and `getGoalBias`, the keyword argument ``goal_bias`` and
    an entry in its docstring; `planner.goal_bias` is the value. What is set is checked.

    Attributes
    ----------
    default : bool, int, float or str
        The default, always allowed. Its type is the parameter's: flag, whole number, number or text.
    doc : str
        What it means.
    unit : str
        Its unit, such as "rad".
    above, at_least, at_most : float, optional
        Bounds of a number.
    choices : collection of str
        The values that a text may have.
    kept_in : str
        Where the planner keeps the value: the path of an attribute of one of its parts, such as "_danger.alpha". By
        default the planner itself keeps it.
    """

    default: T
    doc: str
    unit: str = ""
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    choices: Collection[str] = ()
    kept_in: str = ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        self._part, _, self._attribute = self.kept_in.rpartition(".")
        for method in (self._setter(), self._getter()):
            if method.__name__ not in vars(owner):
                method.__qualname__ = f"{owner.__qualname__}.{method.__name__}"
                setattr(owner, method.__name__, method)

    @overload
    def __get__(self, planner: None, owner: type) -> Parameter[T]: ...
    @overload
    def __get__(self, planner: object, owner: type) -> T: ...
    def __get__(self, planner: object | None, owner: type) -> Parameter[T] | T:
        if planner is None:
            return self
        if self.kept_in:
            return cast(T, attrgetter(self.kept_in)(planner))
        return cast(T, planner.__dict__[self.name])

    def __set__(self, planner: object, value: T) -> None:
        checked = self.checked(value)
        if self.kept_in:
            setattr(attrgetter(self._part)(planner), self._attribute, checked)
        else:
            planner.__dict__[self.name] = checked

    def checked(self, value: Any) -> T:
        """Return a value as the parameter's type, or raise an InputError that says what would be right."""
        kind, found = type(self.default), value
        if kind is str:
            if value not in tuple(self.choices):
                raise UnknownNameError(self.name, value, self.choices)
        elif kind is bool:
            found = flag(self.name, value)
        elif kind is int:
            low, high = (None if bound is None else int(bound) for bound in (self.at_least, self.at_most))
            found = whole_number(self.name, value, at_least=low, at_most=high)
        elif not (isinstance(value, float) and value == self.default):  # which may be infinite
            bounds = {"above": self.above, "at_least": self.at_least, "at_most": self.at_most}
            found = number(self.name, value, **bounds)
        return cast(T, found)

    @property
    def entry(self) -> str:
        """The parameter as an entry of a NumPy-style docstring."""
        bounds = [
            words.format(bound)
            for words, bound in (
                ("> {:g}", self.above),
                (">= {:g}", self.at_least),
                ("<= {:g}", self.at_most),
            )
            if bound is not None
        ]
        kind = "{" + ", ".join(map(repr, self.choices)) + "}" if self.choices else type(self.default).__name__
        head = ", ".join([kind, *bounds, f"default {self.default!r}"]) + (
            f" [{self.unit}]" if self.unit else ""
        )
        return f"{self.name} : {head}\n" + textwrap.indent(self._text, "    ")

    @property
    def _text(self) -> str:
        return textwrap.fill(" ".join(self.doc.split()), _WIDTH)

    def _setter(self) -> Any:
        def setter(planner: Any, value: Any) -> None:
            setattr(planner, self.name, value)

        setter.__name__ = f"set{camel_case(self.name)}"
        setter.__doc__ = f"Set the parameter `{self.name}`.\n\n{self.entry}"
        return setter

    def _getter(self) -> Any:
        def getter(planner: Any) -> Any:
            return getattr(planner, self.name)

        getter.__name__ = f"get{camel_case(self.name)}"
        getter.__doc__ = f"Return the parameter `{self.name}`.\n\n{self.entry}"
        return getter


def parameters_of(kind: type) -> dict[str, Parameter[Any]]:
    """Return the parameters that a class of planners declares, its own before those of its base."""
    found: dict[str, Parameter[Any]] = {}
    for owner in kind.__mro__:
        for name, value in vars(owner).items():
            if isinstance(value, Parameter):
                found.setdefault(name, value)
    return found


def describe(kind: type) -> None:
    """Append the parameters of a class of planners to its docstring, and name them in its signature."""
    declared = parameters_of(kind)
    lines = ["Other Parameters", "----------------", *(parameter.entry for parameter in declared.values())]
    kind.__doc__ = inspect.cleandoc(kind.__doc__ or kind.__name__) + "\n\n" + "\n".join(lines) + "\n"
    own = list(inspect.signature(kind.__init__).parameters.values())[1:]  # type: ignore[misc]
    keywords = (
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=parameter.default)
        for name, parameter in declared.items()
    )
    given = [parameter for parameter in own if parameter.kind is not inspect.Parameter.VAR_KEYWORD]
    kind.__signature__ = inspect.Signature([*given, *keywords])  # type: ignore[attr-defined]


@dataclass(frozen=True)
class FormerNames:
    """Parameters that a class of planners once had.

    Attributes
    ----------
    renamed : mapping of str to str
        Names that still work, with a DeprecationWarning, and what they are called now.
    removed : mapping of str to str
        Names that no longer work, and what to do instead.
    """

    renamed: Mapping[str, str]
    removed: Mapping[str, str]

    def __contains__(self, name: str) -> bool:
        return name in self.renamed or name in self.removed

    def current(self, planner: str, name: str, stacklevel: int = 3) -> str:
        """Return what a parameter is called now; `name` itself where it was never another.

        Raises
        ------
        InputError
            If it was removed.
        """
        if name in self.removed:
            raise InputError(f"parameter {name!r} of {planner} was removed: {self.removed[name]}")
        if name not in self.renamed:
            return name
        new = self.renamed[name]
        words = f"parameter {name!r} of {planner} is now called {new!r} (set{camel_case(new)}, get{camel_case(new)})"
        warnings.warn(words, DeprecationWarning, stacklevel=stacklevel)
        return new


def camel_case(name: str) -> str:
    """Return goal_bias as GoalBias."""
    return "".join(word.capitalize() for word in name.split("_"))


def snake_case(name: str) -> str:
    """Return GoalBias as goal_bias."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()
