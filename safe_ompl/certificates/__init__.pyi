from .claims import Certificate as Certificate
from .issue import (
    Claims as Claims,
    certificate as certificate,
    clearance_claim as clearance_claim,
    motion_certificate as motion_certificate,
    program_certificate as program_certificate,
    terms_of as terms_of,
)
from .verifier.program import RecordedCell as RecordedCell
from .verifier.verify import TIME as TIME, Verified as Verified, verify as verify
