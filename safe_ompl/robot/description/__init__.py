"""The files that describe a robot: URDF, SRDF, xacro, packages, and the shapes in them."""
