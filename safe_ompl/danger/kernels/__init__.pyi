from .danger import MAXIMUM as MAXIMUM, PointDanger as PointDanger, dangers as dangers, high_levels as high_levels
