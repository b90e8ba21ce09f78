"""One certificate for a program: its stretches, each as a certificate of its own, and robots and scenes once."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from safe_ompl.certificates.issue import motion_certificate
from safe_ompl.certificates.verifier.program import PROGRAM_FORMAT, VERSION, verify_program
from safe_ompl.common import CertificateError, PlanningError, within
from safe_ompl.io import schema
from safe_ompl.motions import MotionCheck

_SHARED = ("robot", "scene")


def program_certificate(
    stretches: Iterable[tuple[float, MotionCheck]],
    source: Mapping[str, Any] | None = None,
    steps: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Return the certificate of a program, as plain numbers, lists and strings, verified.

    Parameters
    ----------
    stretches : iterable of (float, MotionCheck)
        When each begins [s], and what is proven of it, as `ProgramResult.stretches` has them.
    source : mapping, optional
        Where robot and scene come from: kept as it is.
    steps : sequence of str, optional
        What each stretch is for, in words: kept as it is.

    Raises
    ------
    PlanningError
        If a stretch is not proven, or they do not follow each other.
    InputError
        As `motion_certificate`, which see.
    """
    shared: dict[str, list[Any]] = {name: [] for name in _SHARED}
    said = []
    for k, (begin, check) in enumerate(stretches):
        with within(f"stretch {k}", ": "):
            whole = motion_certificate(check, source=source)
        for name in _SHARED:
            if whole[name] not in shared[name]:
                shared[name].append(whole[name])
            whole[name] = shared[name].index(whole[name])
        said.append({"begin": float(begin), "certificate": whole} | ({"step": steps[k]} if steps else {}))
    content = {"format": PROGRAM_FORMAT, "version": VERSION, "robots": shared["robot"], "scenes": shared["scene"]}
    content["stretches"] = said
    content["digest"] = schema.digest(content)
    try:
        verify_program(content, joints_only=True)
    except CertificateError as error:
        raise PlanningError(f"the stretches are proven, but not one program: {error}") from None
    return content
