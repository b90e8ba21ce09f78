"""Certificates of paths: what they claim, how they are issued, and how independent code verifies them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.certificates.issue import Claims, certificate, clearance_claim, motion_certificate, terms_of
    from safe_ompl.certificates.verifier.verify import TIME, Verified, verify

__all__ = ["TIME", "Claims", "Verified", "certificate", "clearance_claim", "motion_certificate", "terms_of", "verify"]

__getattr__, __dir__ = lazily(__name__, __file__)
