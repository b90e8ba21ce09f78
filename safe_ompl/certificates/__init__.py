"""Certificates of paths: what they claim, how they are issued, and how independent code verifies them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.certificates.issue import Claims, certificate, clearance_claim, motion_certificate, terms_of
    from safe_ompl.certificates.program import program_certificate
    from safe_ompl.certificates.verifier.program import PROGRAM_FORMAT, verify_program
    from safe_ompl.certificates.verifier.verify import TIME, Verified, verify

__all__ = [
    "PROGRAM_FORMAT",
    "TIME",
    "Claims",
    "Verified",
    "certificate",
    "clearance_claim",
    "motion_certificate",
    "program_certificate",
    "terms_of",
    "verify",
    "verify_program",
]

__getattr__, __dir__ = lazily(__name__, __file__)
