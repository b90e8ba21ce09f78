"""The progress of a tree that heads for a goal."""

from __future__ import annotations

_LEAST_GAIN = 2e-3  # [m] a turn ends where the tree comes less near to its goal in a step than this, …
_GAIN_SHARE = 0.2  # … or than this share of its best step


class Progress:
    """Judges whether a tree that heads for a goal still comes nearer to it."""

    def __init__(self) -> None:
        self._left: float | None = None
        self._best = 0.0

    def goes_on(self, before: float, after: float) -> bool:
        """Take the distances from the goal before and after a step; return whether the gain was worth it."""
        gain = (before if self._left is None else self._left) - after
        worthwhile = gain >= max(_LEAST_GAIN, _GAIN_SHARE * self._best)
        self._left, self._best = after, max(self._best, gain)
        return worthwhile
