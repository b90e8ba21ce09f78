"""Planners that subclass ompl.base.Planner."""
