"""The verifier of certificates. It shares no code with the packages that plan, prove motions or issue certificates."""
