"""Planners of others that OMPL's wheel lacks, to compare with."""
