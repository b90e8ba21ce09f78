"""Xacro files that are taken for URDFs: recognised, and the command that expands them."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from safe_ompl.errors import InputError

_XACRO_TAG = re.compile(r"\{[^}]*xacro[^}]*\}")
_PREFIX = re.compile(r"[\s<]([A-Za-z_][\w.-]*):[A-Za-z_]")
_EXPRESSION = re.compile(r"\$[{(][^})]*[})]")


def parsed(path: Path) -> ElementTree.Element:
    """Return the outermost tag of a URDF, whose name spaces need not be declared: many leave out `drake:`.

    Raises
    ------
    ParseError
        If it is not XML, or uses xacro's name space, which says that it is not a URDF yet.
    """
    try:
        return ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        text = path.read_text(encoding="utf-8", errors="replace")
        if "unbound prefix" not in str(error) or "<xacro:" in text:
            raise
    unknown = {prefix for prefix in _PREFIX.findall(text) if not f"{prefix}:".startswith(("xml:", "xmlns:"))}
    unknown = {prefix for prefix in unknown if f"xmlns:{prefix}=" not in text}
    declared = " ".join(f'xmlns:{prefix}="{prefix}"' for prefix in sorted(unknown))
    return ElementTree.fromstring(re.sub(r"<robot\b", f"<robot {declared}", text, count=1).encode())


def check_expanded(root: ElementTree.Element, path: Path, source: str) -> None:
    """Raise InputError if `root` holds xacro's tags, or expressions in what describes links and joints.

    A declared name space alone says nothing: xacro leaves it in what it writes.
    """
    for element in root.iter():
        if isinstance(element.tag, str) and _XACRO_TAG.match(element.tag):
            raise _not_expanded(path, source, f"<xacro:{element.tag.partition('}')[2]}>")
    for part in (part for part in root if part.tag in ("link", "joint")):
        for text in (text for element in part.iter() for text in element.attrib.values()):
            expression = _EXPRESSION.search(text)
            if expression is not None:
                raise _not_expanded(path, source, expression.group())


def unreadable(path: Path, source: str, error: ElementTree.ParseError) -> InputError:
    """Return the error about a file that is not XML, or XML but for xacro's undeclared name space."""
    if "unbound prefix" in str(error) and "<xacro:" in path.read_text(encoding="utf-8", errors="replace"):
        return _not_expanded(path, source, "xacro's tags")
    return InputError(f"not well-formed XML ({error})", source)


def _not_expanded(path: Path, source: str, evidence: str) -> InputError:
    stem = path.name.removesuffix(".xacro").removesuffix(".urdf")
    target = f"{stem}.urdf" if path.name != f"{stem}.urdf" else f"{stem}_expanded.urdf"
    return InputError(
        f"a xacro file, not yet a URDF (it holds {evidence}); expand it with: xacro {path.name} -o {target}",
        source,
    )
