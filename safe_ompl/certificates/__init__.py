"""Certificates of paths: what they claim, how they are issued, and how independent code verifies them."""

from typing import TYPE_CHECKING

from safe_ompl.doors import lazily

if TYPE_CHECKING:
    from safe_ompl.certificates.claims import PROGRAM_FORMAT as PROGRAM_FORMAT, ProgramCertificate as ProgramCertificate
    from safe_ompl.certificates.issue import (
        Claims as Claims,
        certificate as certificate,
        clearance_claim as clearance_claim,
        motion_certificate as motion_certificate,
        program_certificate as program_certificate,
        terms_of as terms_of,
    )
    from safe_ompl.certificates.verifier.program import RecordedCell as RecordedCell, verify_program as verify_program
    from safe_ompl.certificates.verifier.verify import TIME as TIME, Verified as Verified, verify as verify

__getattr__, __dir__, __all__ = lazily(__name__, __file__)
