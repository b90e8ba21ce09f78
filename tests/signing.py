"""Certificates whose content was changed."""

from safe_ompl.io.schema import digest


def claimed(content, number=0):
    """Return what is claimed of a stretch of a certificate, by default of the first one."""
    return content["stretches"][number]


def signed(content):
    """Return the content with the digest that belongs to it: whoever tampers can compute that."""
    return {**content, "digest": digest(content)}
