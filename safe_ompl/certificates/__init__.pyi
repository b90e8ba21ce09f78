from .claims import PROGRAM_FORMAT as PROGRAM_FORMAT, ProgramCertificate as ProgramCertificate
from .issue import (
    Claims as Claims,
    certificate as certificate,
    clearance_claim as clearance_claim,
    motion_certificate as motion_certificate,
    program_certificate as program_certificate,
    terms_of as terms_of,
)
from .verifier.program import RecordedCell as RecordedCell, verify_program as verify_program
from .verifier.verify import TIME as TIME, Verified as Verified, verify as verify
