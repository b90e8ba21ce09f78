from .danger import MAXIMUM as MAXIMUM, PointDanger as PointDanger, dangers as dangers, high_levels as high_levels
from .kinetostatic import CellMotions as CellMotions, cell_bounds as cell_bounds
