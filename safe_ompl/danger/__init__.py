"""The danger field of a robot, its gradients, and proven bounds of it."""
