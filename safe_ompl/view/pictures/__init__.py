"""Three-dimensional pictures of robots along paths, drawn without a display."""
