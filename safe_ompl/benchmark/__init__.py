"""Benchmarks in OMPL's form: the runs, their workers, logs and databases."""
