"""Limits of the tool that every path must keep to: an orientation within an angle, a box for the tip."""

from __future__ import annotations

from typing import Any

from numpy.typing import ArrayLike

from safe_ompl.arrays import FloatArray
from safe_ompl.collision.tool_limits import TipBounds, ToolLimit, ToolOrientation
from safe_ompl.errors import InputError
from safe_ompl.setup.limits import LimitedSetup

UP = (0.0, 0.0, 1.0)


class ToolLimitedSetup(LimitedSetup):
    """The part of `SafeSetup` that sets limits of the tool; parameters as there."""

    _tool: ToolOrientation | None = None
    _tip: TipBounds | None = None

    def _given_start(self) -> FloatArray | None:
        """Return the start configuration (n,) that was given; see `SafeProblem`."""
        return None

    def setToolConstraint(
        self, axis: ArrayLike | None = None, direction: ArrayLike = UP, angle: float | None = None
    ) -> None:
        """Have only paths on which an axis of the tool stays near a direction, proven along whole motions.

        Whoever plans obeys it: ``setToolConstraint(angle=0.5)`` keeps upright what is upright at the start.

        Parameters
        ----------
        axis : array_like, shape (3,), optional
            The axis in the frame of the tip; default: the one that points in the direction at the start.
        direction : array_like, shape (3,)
            In the world frame; default: up.
        angle : float, optional
            [rad] The largest angle between the two. Without arguments: there is no such limit any more.

        Raises
        ------
        InputError
            As `ToolOrientation`; without an axis if no start is set; an axis without an angle.
        CollisionError
            If start or all goals are farther from the direction. Then the limit stays what it was.
        """
        if angle is None and axis is not None:
            raise InputError("give the angle [rad] within which the axis of the tool must stay")
        self._limit_tool(None if angle is None else self._orientation(axis, direction, angle), self._tip)

    def getToolConstraint(self) -> ToolOrientation | None:
        """Return the limit of the tool's orientation; None where there is none."""
        return self._tool

    def setTipBounds(self, lower: ArrayLike | None, upper: ArrayLike | None = None) -> None:
        """Have only paths on which the tip stays inside a box, proven along whole motions.

        Parameters
        ----------
        lower, upper : array_like, shape (3,), optional
            Opposite corners in the world frame [m]; infinite where there is no wall. None: there is no such limit any
            more.

        Raises
        ------
        InputError
            As `TipBounds`; if only one corner is given.
        CollisionError
            If the tip is outside at the start or at all goals. Then the limit stays what it was.
        """
        if lower is None and upper is None:
            self._limit_tool(self._tool, None)
        elif lower is None or upper is None:
            raise InputError("give both corners of the tip's box, or neither")
        else:
            self._limit_tool(self._tool, TipBounds(self.robot, lower, upper))

    def getTipBounds(self) -> TipBounds | None:
        """Return the box that the tip stays in; None where there is none."""
        return self._tip

    def tool_claim(self) -> dict[str, Any] | None:
        """Return what a certificate can claim of the tool (`tool` of `certificate`); None where nothing limits it."""
        claim: dict[str, Any] = {} if self._tool is None else {"orientation": self._tool.as_dict()}
        if self._tip is not None:
            claim["position"] = self._tip.as_dict()
        return claim or None

    def _orientation(self, axis: ArrayLike | None, direction: ArrayLike, angle: float) -> ToolOrientation:
        if axis is not None:
            return ToolOrientation(self.robot, axis, direction, angle)
        start = self._given_start()
        if start is None:
            raise InputError(
                "the axis of the tool is that of the start: set a start before, or give the axis"
            )
        return ToolOrientation.as_at(self.robot, start, direction, angle)

    def _limit_tool(self, tool: ToolOrientation | None, tip: TipBounds | None) -> None:
        """Have the tool keep to limits, if start and goals that were given do; else all stays what it was."""
        before = self._tool, self._tip
        self._require_of_tool(tool, tip)
        try:
            self._check_given()
        except BaseException:
            self._require_of_tool(*before)
            raise

    def _require_of_tool(self, tool: ToolOrientation | None, tip: TipBounds | None) -> None:
        self._tool, self._tip = tool, tip
        self._validity.setToolLimits(self._tool_limits)
        self._validator.setToolLimits(self._tool_limits)

    @property
    def _tool_limits(self) -> tuple[ToolLimit, ...]:
        return tuple(limit for limit in (self._tool, self._tip) if limit is not None)

    def _objection(self, q: FloatArray) -> str | None:
        refusing = (f": {limit.objection(q)}" for limit in self._tool_limits if not limit.allows(q))
        return super()._objection(q) or next(refusing, None)
