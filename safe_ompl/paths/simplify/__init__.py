"""Danger-aware simplification of paths."""
