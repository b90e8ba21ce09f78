"""Certificates whose content was changed."""

import copy
import json
from functools import reduce
from operator import getitem

from safe_ompl.io.schema import digest


def claimed(content, number=0):
    """Return what is claimed of a stretch of a certificate, by default of the first one."""
    return content["stretches"][number]


def signed(content):
    """Return the content with the digest that belongs to it: whoever tampers can compute that."""
    return {**content, "digest": digest(content)}


def travelled(data):
    """Return what arrives when plain data is written to a file and read again."""
    return json.loads(json.dumps(data, allow_nan=False))


def tampered(content, change):
    """Return a changed copy of the content, signed."""
    content = copy.deepcopy(content)
    change(content)
    return signed(content)


def replaced(*at, by):
    """Return a change of what is at a place: to `by` of it, or to `by` if that is no function; None takes it out."""
    *path, key = at

    def change(content):
        inner = reduce(getitem, path, content)
        inner[key] = by(inner[key]) if callable(by) else by
        if inner[key] is None:
            del inner[key]

    return change
