"""Paths: curves, reports, danger-aware simplification and certificates."""
