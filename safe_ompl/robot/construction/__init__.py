"""How a robot is built: from files or models, placed on a base, with objects in its gripper, beside others."""
