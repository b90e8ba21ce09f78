"""Models of robot, scene, collision and danger on Pinocchio and coal; frozen once built."""
