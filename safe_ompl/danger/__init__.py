"""The danger field of a robot at rest and in motion, its gradients, and proven bounds of it."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.danger.certified import (
        CertifiedDanger as CertifiedDanger,
        DangerBounds as DangerBounds,
        DangerLimit as DangerLimit,
    )
    from safe_ompl.danger.field import DangerField as DangerField
    from safe_ompl.danger.kinetostatic import KinetostaticField as KinetostaticField

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
