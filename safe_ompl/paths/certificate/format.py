"""The format of certificates: their keys, their version, their digest.

All that the code which issues certificates and the code which verifies them have in common.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from hashlib import sha256
from itertools import pairwise
from typing import Any

from safe_ompl import document
from safe_ompl.arrays import FloatArray
from safe_ompl.errors import InputError

FORMAT, VERSION = "safe-ompl certificate", 2
OBSTACLE = "obstacle:"  # in front of the names of obstacles, so that none can pass for a link
CLAIMS = ("clearance", "danger", "moving_obstacles")  # besides freedom; None where nothing is claimed
OPTIONAL = (
    "tool",
    "trajectory",
)  # claims that came later: a certificate without the key claims nothing of it
KEYS = (
    *("format", "version", "source", "robot", "scene", "joint_names", "path", "pairs"),
    *(*CLAIMS, "also_sampled", "edges", "digest"),
)


def digest(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of all of a certificate but its digest."""
    rest = {key: value for key, value in content.items() if key != "digest"}
    return sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def edges_of(path: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Return the edges of a path (N, n); a path of one configuration is an edge to itself."""
    return pairwise(path) if len(path) > 1 else iter([(path[0], path[0])])


def check_form(content: Any) -> None:
    """Raise InputError unless `content` has the form of a certificate of this version."""
    if not isinstance(content, Mapping) or content.get("format") != FORMAT:
        raise InputError(f"this is not a {FORMAT}")
    version = content.get("version")
    if version == 1 and not isinstance(version, bool):
        raise InputError(
            "version 1 of the format does not say what it claims nothing of, and carries no scene: "
            "write it anew with `safe-ompl plan --certificate`"
        )
    if version != VERSION or isinstance(version, (bool, float)):
        raise InputError(f"version {version!r} of the format is not known, {VERSION} is")
    missing = [key for key in KEYS if key not in content]
    if missing:
        raise InputError(f"the certificate has no {missing[0]!r}")
    with document.within("certificate"):
        document.check_keys(content, (*KEYS, *OPTIONAL))
