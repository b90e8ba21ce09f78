"""Which bodies of a robot are checked against each other: what several tests compare."""


def self_pairs(robot):
    """Return the pairs of bodies of a robot that are checked, as sets of their two names."""
    names = [body.name for body in robot.collision_model.geometryObjects]
    return {frozenset((names[p.first], names[p.second])) for p in robot.collision_model.collisionPairs}
