"""Formulas compiled by Numba, where NumPy would take too long: each kernel is written as its formula."""
