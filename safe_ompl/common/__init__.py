"""Shared by all rooms: array types, checks of input, errors, documents, threads, and compiled kernels."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.common import cache, documents
    from safe_ompl.common.arrays import BoolArray, FloatArray, IntArray, halton_point
    from safe_ompl.common.compilation import clock, compiled, part
    from safe_ompl.common.counts import Counts
    from safe_ompl.common.documents import within
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
        configuration,
        configurations,
        edge,
        finite_array,
        flag,
        float_array,
        fraction,
        number,
        positive,
        seed,
        shown,
        unchecked,
        whole_number,
    )
    from safe_ompl.common.threads import Changes, PerThread

__all__ = [
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
    "StaleSceneError",
    "UnknownNameError",
    "cache",
    "clock",
    "compiled",
    "configuration",
    "configurations",
    "documents",
    "edge",
    "finite_array",
    "flag",
    "float_array",
    "fraction",
    "halton_point",
    "number",
    "part",
    "pass_on",
    "positive",
    "seed",
    "shown",
    "unchecked",
    "warn_once",
    "whole_number",
    "within",
]

__getattr__, __dir__ = lazily(__name__, __file__)
