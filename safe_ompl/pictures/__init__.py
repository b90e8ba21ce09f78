"""Pictures: curves of danger and time, and renderings of robots along their paths."""
