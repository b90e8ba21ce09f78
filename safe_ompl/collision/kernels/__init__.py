"""Compiled queries and proofs of pairs of bodies."""
