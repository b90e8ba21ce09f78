"""The verifier of certificates: it shares nothing with what plans, proves motions or issues certificates."""
