"""Counters of the work of planning; unlike times they are reproducible."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields


@dataclass
class Counts:
    """Numbers of queries, shared by the models of one planning problem.

    Attributes
    ----------
    nodes : int
        Nodes (vertices) that the planner kept.
    collision_queries : int
        Whole-robot boolean collision queries without margin.
    margin_queries : int
        Whole-robot boolean collision queries with security margins (certified motions).
    bound_queries : int
        Places of motions at which lower bounds of distances were looked at (certified motions); no query of coal's.
    distance_queries : int
        Whole-robot distance queries.
    field_configurations : int
        Configurations at which the danger field was evaluated.
    field_points : int
        Sum over those configurations of the danger points looked at.
    """

    nodes: int = 0
    collision_queries: int = 0
    margin_queries: int = 0
    bound_queries: int = 0
    distance_queries: int = 0
    field_configurations: int = 0
    field_points: int = 0

    @property
    def queries(self) -> int:
        """Number of configurations at which the whole robot was checked for collisions, in any way."""
        return self.collision_queries + self.margin_queries + self.bound_queries

    def reset(self) -> None:
        """Set every counter to zero."""
        for field in fields(self):
            setattr(self, field.name, 0)

    def __sub__(self, earlier: Counts) -> Counts:
        """Work done since `earlier` was copied."""
        return Counts(**{key: value - getattr(earlier, key) for key, value in asdict(self).items()})

    def copy(self) -> Counts:
        """Return a snapshot."""
        return Counts(**asdict(self))

    def as_dict(self) -> dict[str, int]:
        """Return the counters by name."""
        return asdict(self)
