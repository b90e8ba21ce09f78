"""Robots on Pinocchio: joints and limits, kinematics, skeleton, collision bodies, and how far they can move."""
