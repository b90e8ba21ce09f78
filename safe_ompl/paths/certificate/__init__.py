"""Certificates of paths, and their verification by independent code."""
