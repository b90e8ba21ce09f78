"""Shared by all rooms: array types, checks of input, errors, documents, what models share, compiled kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.common import documents, files, polynomials
    from safe_ompl.common.compilation import (
        caller,
        clock,
        compile_together,
        compiled,
        ctrl_c_as_such,
        maker,
        part,
        until_ctrl_c,
    )
    from safe_ompl.common.documents import Section, key, within
    from safe_ompl.common.errors import (
        CertificateError,
        CollisionError,
        InputError,
        PlanningError,
        SafeOmplError,
        StaleSceneError,
        UnknownNameError,
        pass_on,
        warn_once,
    )
    from safe_ompl.common.inputs import (
        RATE_BOUNDS,
        BoolArray,
        FloatArray,
        IntArray,
        configuration,
        configurations,
        finite_array,
        flag,
        float_array,
        fraction,
        halton_point,
        instance,
        listed,
        motion_ends,
        number,
        positive,
        seed,
        shaped_configuration,
        shown,
        whole_number,
    )
    from safe_ompl.common.models import Changes, Counts, PerThread, notebook_html

__all__ = [
    "RATE_BOUNDS",
    "BoolArray",
    "CertificateError",
    "Changes",
    "CollisionError",
    "Counts",
    "FloatArray",
    "InputError",
    "IntArray",
    "PerThread",
    "PlanningError",
    "SafeOmplError",
    "Section",
    "StaleSceneError",
    "UnknownNameError",
    "caller",
    "clock",
    "compile_together",
    "compiled",
    "configuration",
    "configurations",
    "ctrl_c_as_such",
    "documents",
    "files",
    "finite_array",
    "flag",
    "float_array",
    "fraction",
    "halton_point",
    "instance",
    "key",
    "listed",
    "maker",
    "motion_ends",
    "notebook_html",
    "number",
    "part",
    "pass_on",
    "polynomials",
    "positive",
    "seed",
    "shaped_configuration",
    "shown",
    "until_ctrl_c",
    "warn_once",
    "whole_number",
    "within",
]

__getattr__, __dir__ = lazily(__name__, __file__)
