"""Collision, distance and margin queries on coal, and proofs of whole motions."""
