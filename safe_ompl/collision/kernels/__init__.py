"""Compiled bounds of distances along motions."""
