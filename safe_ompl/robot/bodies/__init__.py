"""The bodies of a robot: which pairs of them are checked, and how far joints move them."""
