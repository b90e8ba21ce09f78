"""Planning problems as documents: robot, scene, start, goal, limits and parameters."""
