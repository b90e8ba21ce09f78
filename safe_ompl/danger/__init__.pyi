from .certified import CertifiedDanger as CertifiedDanger, DangerBounds as DangerBounds, DangerLimit as DangerLimit
from .field import DangerField as DangerField
from .kinetostatic import KinetostaticField as KinetostaticField
from .moving import CellMotions as CellMotions, cell_bounds as cell_bounds
