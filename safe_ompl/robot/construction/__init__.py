"""Construction of robots: from files or models, placed on a base, with objects in its gripper, beside others."""
