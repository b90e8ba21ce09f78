"""Robots on Pinocchio: construction from their files, kinematics, and how far their bodies can move."""
