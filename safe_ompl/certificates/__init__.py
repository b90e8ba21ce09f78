"""Certificates of paths: what they claim, how they are issued, and how independent code verifies them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.certificates.issue import Pairs as Pairs
    from safe_ompl.certificates.issue import certificate as certificate
    from safe_ompl.certificates.issue import motion_certificate as motion_certificate
    from safe_ompl.certificates.issue import terms_of as terms_of
    from safe_ompl.certificates.verifier.verify import Verified as Verified
    from safe_ompl.certificates.verifier.verify import verify as verify

__all__, __getattr__, __dir__ = lazily(__name__, __file__)
