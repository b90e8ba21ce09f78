"""Shared by all rooms: array types, checks of input, errors, documents, what models share, compiled kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.common import cache as cache
    from safe_ompl.common import documents as documents
    from safe_ompl.common import polynomials as polynomials
    from safe_ompl.common.compilation import clock as clock
    from safe_ompl.common.compilation import compile_together as compile_together
    from safe_ompl.common.compilation import compiled as compiled
    from safe_ompl.common.compilation import maker as maker
    from safe_ompl.common.compilation import part as part
    from safe_ompl.common.documents import within as within
    from safe_ompl.common.errors import CertificateError as CertificateError
    from safe_ompl.common.errors import CollisionError as CollisionError
    from safe_ompl.common.errors import InputError as InputError
    from safe_ompl.common.errors import PlanningError as PlanningError
    from safe_ompl.common.errors import SafeOmplError as SafeOmplError
    from safe_ompl.common.errors import StaleSceneError as StaleSceneError
    from safe_ompl.common.errors import UnknownNameError as UnknownNameError
    from safe_ompl.common.errors import pass_on as pass_on
    from safe_ompl.common.errors import warn_once as warn_once
    from safe_ompl.common.inputs import BoolArray as BoolArray
    from safe_ompl.common.inputs import FloatArray as FloatArray
    from safe_ompl.common.inputs import IntArray as IntArray
    from safe_ompl.common.inputs import configuration as configuration
    from safe_ompl.common.inputs import configurations as configurations
    from safe_ompl.common.inputs import finite_array as finite_array
    from safe_ompl.common.inputs import flag as flag
    from safe_ompl.common.inputs import float_array as float_array
    from safe_ompl.common.inputs import fraction as fraction
    from safe_ompl.common.inputs import halton_point as halton_point
    from safe_ompl.common.inputs import motion_ends as motion_ends
    from safe_ompl.common.inputs import number as number
    from safe_ompl.common.inputs import positive as positive
    from safe_ompl.common.inputs import seed as seed
    from safe_ompl.common.inputs import shaped_configuration as shaped_configuration
    from safe_ompl.common.inputs import shown as shown
    from safe_ompl.common.inputs import whole_number as whole_number
    from safe_ompl.common.models import Changes as Changes
    from safe_ompl.common.models import Counts as Counts
    from safe_ompl.common.models import PerThread as PerThread

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
