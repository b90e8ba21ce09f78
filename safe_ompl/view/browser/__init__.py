"""The view in the browser; the only folder that knows viser."""
