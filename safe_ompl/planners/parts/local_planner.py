"""The local planner of a roadmap: which milestones are valid, and which edges are free and keep a margin."""

from __future__ import annotations

from itertools import pairwise
from math import inf

from safe_ompl.planners.graphs.roadmap import Roadmap
from safe_ompl.planners.parts.task import Task


class LocalPlanner:
    """Connects milestones by straight motions; what it once found out it notes in the roadmap, and does not ask again.

    Parameters
    ----------
    task : Task
        Says what is valid and free.
    roadmap : Roadmap
        The milestones.
    """

    def __init__(self, task: Task, roadmap: Roadmap) -> None:
        self._task = task
        self._roadmap = roadmap

    def is_valid(self, milestone: int) -> bool:
        """Return whether a milestone is valid."""
        roadmap = self._roadmap
        if not (roadmap.valid[milestone] or roadmap.invalid[milestone]):
            found = (
                roadmap.valid if self._task.is_valid(roadmap.configurations[milestone]) else roadmap.invalid
            )
            found[milestone] = True
        return bool(roadmap.valid[milestone])

    def is_free(self, start: int, end: int, margin: float = 0.0) -> bool:
        """Return whether the edge from one milestone to another is free, or that back, and keeps a margin [m]."""
        verdict = self._roadmap.verdict(start, end)
        if margin and verdict is not False:
            return self._keeps(start, end, margin)
        return self.check(start, end) if verdict is None else verdict

    def can_be_driven(self, path: list[int]) -> bool:
        """Return whether the edges of a path are free in this direction too, where only the way back was asked for."""
        edges = self._roadmap.edges
        return all(edges[edge] if edge in edges else self.check(*edge) for edge in pairwise(path))

    def check(self, start: int, end: int) -> bool:
        """Ask whether the motion from one milestone to another is free, and note it."""
        configurations = self._roadmap.configurations
        verdict = self._task.motion_is_free(configurations[start], configurations[end])
        self._roadmap.edges[start, end] = verdict
        return verdict

    def _keeps(self, start: int, end: int, margin: float) -> bool:
        kept, refused = self._roadmap.margins_of(start, end)
        if kept < margin < refused:
            # What did not keep a larger margin is more often blocked than narrow.
            if refused < inf and self._roadmap.verdict(start, end) is None and not self.check(start, end):
                return False
            configurations = self._roadmap.configurations
            if self._task.motion_is_free(configurations[start], configurations[end], margin):
                kept = margin
                self._roadmap.edges[start, end] = True
            else:
                refused = margin
            self._roadmap.note_margins(start, end, kept, refused)
        return margin <= kept
