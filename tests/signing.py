"""Certificates whose content was changed."""

from safe_ompl.io.schema import digest


def signed(content):
    """Return the content with the digest that belongs to it: whoever tampers can compute that."""
    return {**content, "digest": digest(content)}
