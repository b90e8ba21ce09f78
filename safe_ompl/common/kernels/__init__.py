"""Formulas compiled by Numba, where NumPy would take too long: each kernel is written as its formula.

Kernels check nothing. They take C-contiguous, writable arrays of the types that their docstrings name: for any other
sort of array Numba would compile them once more.
"""
