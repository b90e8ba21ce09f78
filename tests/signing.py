"""Certificates whose content was changed."""

import copy
import json

from safe_ompl.io.schema import digest


def claimed(content, number=0):
    """Return what is claimed of a stretch of a certificate, by default of the first one."""
    return content["stretches"][number]


def signed(content):
    """Return the content with the digest that belongs to it: whoever tampers can compute that."""
    return {**content, "digest": digest(content)}


def travelled(content):
    """Return the content as it is read from a file."""
    return json.loads(json.dumps(content))


def tampered(content, change):
    """Return a changed copy of the content, signed."""
    content = copy.deepcopy(content)
    change(content)
    return signed(content)
