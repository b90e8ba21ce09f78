"""Turns of two trees: they alternate, but one that lags behind a large one has most of them."""

from __future__ import annotations

from safe_ompl.planners.parts.tree import Tree

_LARGE = 64  # nodes; easy problems are solved before a tree has more
_IN_A_ROW = 8  # turns of a tree that lags before the other has one


class Turns:
    """Says which tree grows next: they alternate, or, where they are balanced, one that lags has eight of nine turns.

    A tree in a narrow place hardly grows, while the other fills the space outside, to little avail, and has half of the
    turns. It keeps some of them, however: the tree that lags may be sealed in, and more goals are taken as nodes are
    added.

    Attributes
    ----------
    balanced : bool
        Whether they are balanced; if not, they alternate.
    """

    def __init__(self) -> None:
        self.balanced = False
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._in_a_row = 1

    def again(self, tree: Tree, other: Tree) -> bool:
        """Return whether the tree that had this turn has the next one, too."""
        lags = self.balanced and len(other) > max(_LARGE, len(tree))
        if lags and self._in_a_row < _IN_A_ROW:
            self._in_a_row += 1
            return True
        self._in_a_row = 1
        return False
