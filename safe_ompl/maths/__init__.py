"""Mathematics: pure functions of NumPy arrays."""
