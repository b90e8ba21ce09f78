"""Reading documents (YAML, JSON) and arrays (NPZ), and writing files atomically.

While a file is written, readers see either the old or the complete new content. Errors name file, line, key and value
in one line. All user files are read here, so that hostile and broken files are handled in one module.

The line number in YAML is looked up only for an error, from the key at the beginning of its message:
``scenarios/x.yaml:7: scene.obstacles[2] 'table'.box.size: must be a positive number, got -0.2``. ruamel.yaml stores
line numbers with the data, but takes ten times as long for each document.
"""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from safe_ompl.common.documents import described, within
from safe_ompl.common.errors import InputError, cut, shown

if TYPE_CHECKING:
    _Loader = yaml.SafeLoader
else:
    # The C loader is six times as fast.
    _Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
# Limit of the nesting of lists and mappings.
_MOST_LEVELS = 100
# Limit of the nodes that aliases expand to. 1 kB of nested aliases could expand to any number of nodes.
_MOST_COPIES = 100_000
# Limit of the bits of an integer. Python takes minutes to print longer integers.
_MOST_BITS = 1024
_BROKEN = (ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
MALFORMED = (*_BROKEN, MemoryError, RecursionError)
"""Exceptions that code for documents raises if the content has another structure."""


@contextmanager
def reading(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the mapping in a YAML file. Inside the block, put file and line before the key of each InputError."""
    content = ""
    try:
        content = file_text(path)
        yield parse_document(content)
    except InputError as error:
        message = str(error)
        malformed = re.match(r"line (\d+): malformed", message)
        line = int(malformed[1]) if malformed else _line_of(content, message)
        rest = message.partition(": ")[2] if malformed else message
        error.args = (f"{path}{'' if line is None else f':{line}'}: {rest}",)
        raise


def file_text(path: Path) -> str:
    """Return the text of a UTF-8 file, or raise InputError if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"is not text in UTF-8 ({error})") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})") from None


@contextmanager
def reading_json(file: str | Path) -> Iterator[Any]:
    """Yield the content of a JSON file. Inside the block, put the file name before each InputError.

    Exceptions in `MALFORMED`, which malformed content causes, are converted to InputError.
    """
    with within(str(file), ": "):
        content = parse_json(file_text(Path(file)))
        try:
            yield content
        except InputError:
            raise
        except MALFORMED as error:
            reason = cut(f"{type(error).__name__}: {error}")
            raise InputError(f"is malformed ({reason})") from error


def read_json(file: str | Path) -> Any:
    """Return the content of a JSON file, or raise InputError."""
    with reading_json(file) as content:
        return content


def parse_json(content: str, first: int = 1, *, finite: bool = False) -> Any:
    """Parse JSON text. Raises InputError for malformed JSON, a repeated key and, if `finite`, NaN or Infinity.

    `first` is the number of the first line. Without `finite`, the caller must refuse NaN, with the name of its key.
    """
    try:
        return json.loads(content, object_pairs_hook=_without_repeats, parse_constant=_not_finite if finite else None)
    except InputError:
        raise
    except json.JSONDecodeError as error:
        raise InputError(f"malformed JSON: {error.msg}", f"line {first - 1 + error.lineno}") from None
    except RecursionError:
        raise InputError("malformed JSON: nested too deeply") from None
    except ValueError as error:
        # Python refuses integers of thousands of digits.
        raise InputError(f"malformed JSON: {cut(str(error))}") from None


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise InputError("is there twice", shown(next(key for key in names if names.count(key) > 1)))
    return found


def _not_finite(name: str) -> Any:
    raise InputError(f"malformed JSON: {name} is not finite")


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Return the arrays of an NPZ file by name. Raises InputError for content other than numbers and text."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror or error})", str(path)) from None
    # NumPy raises RuntimeError for an archive with a password.
    except (*MALFORMED, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error):
        raise InputError("is not an NPZ archive of arrays of numbers and text", str(path)) from None


def _line_of(content: str, message: str) -> int | None:
    """Return the line of the key at the start of a message, or of the innermost mapping found; None if unknown."""
    try:
        _check_size(content)
        node, line, rest = yaml.compose(content, Loader=_StrictLoader), None, message
    except (yaml.YAMLError, InputError):
        return None
    while True:
        found = _child(node, rest)
        if found is None:
            return line
        node, line, rest = found


def _child(node: yaml.Node | None, rest: str) -> tuple[yaml.Node, int, str] | None:
    """Return the value for the first key or index in `rest`, its line, and the remaining text."""
    if isinstance(node, yaml.MappingNode):
        for key, value in sorted(node.value, key=lambda pair: -len(str(pair[0].value))):
            name = str(key.value)
            if re.match(rf"{re.escape(name)}(?=[.:\[])", rest):
                return value, key.start_mark.line + 1, rest[len(name) :].removeprefix(".")
    index = re.match(r"\[(\d+)\]", rest)
    if isinstance(node, yaml.SequenceNode) and index and int(index[1]) < len(node.value):
        item = node.value[int(index[1])]
        return item, item.start_mark.line + 1, _after_name(item, rest[index.end() :])
    return None


def _after_name(item: yaml.Node, rest: str) -> str:
    """Return `rest` without the name of a list item, which messages write after its index, and without the dot."""
    entries = item.value if isinstance(item, yaml.MappingNode) else []
    for name in (str(value.value) for key, value in entries if key.value == "name"):
        for written in (f" {name!r}", f" {name}"):
            if rest.startswith(written):
                return rest[len(written) :].removeprefix(".")
    return rest.removeprefix(".")


def parse_document(content: str) -> dict[str, Any]:
    """Parse YAML text to a mapping; empty text gives an empty mapping. Raises InputError for other content."""
    _check_size(content)
    try:
        data = yaml.load(content, Loader=_StrictLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise InputError(
            f"malformed YAML: {cut(str(error.problem))}", f"line {mark.line + 1}" if mark else None
        ) from None
    except yaml.YAMLError as error:
        raise InputError(f"malformed YAML: {error}") from None
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise InputError(f"must be a mapping of keys to values, got {described(data)}")
    return data


def _check_size(content: str) -> None:
    """Raise InputError if YAML is nested too deeply, or aliases expand to too many nodes.

    Deep nesting would overflow the stack of the C parser. Merged nodes (`<<`) are copied, and messages print values
    with all aliases expanded.
    """
    # For each open node: its anchor, and the numbers of nodes and levels in it.
    open_nodes: list[tuple[str | None, list[int]]] = [(None, [0, 0])]
    known: dict[str | None, list[int]] = {}
    copies = 0

    def refuse(event: yaml.Event, why: str) -> None:
        line = None if event.start_mark is None else f"line {event.start_mark.line + 1}"
        raise InputError(f"malformed YAML: {why}", line)

    def add(nodes: int, levels: int, event: yaml.Event) -> None:
        around = open_nodes[-1][1]
        around[:] = around[0] + nodes, max(around[1], levels)
        if len(open_nodes) - 1 + levels > _MOST_LEVELS:
            refuse(event, f"nested deeper than {_MOST_LEVELS} levels")

    try:
        for event in yaml.parse(content, Loader=_StrictLoader):
            if isinstance(event, yaml.CollectionStartEvent):
                open_nodes.append((event.anchor, [1, 0]))
                known.pop(event.anchor, None)
                add(0, 0, event)
            elif isinstance(event, yaml.CollectionEndEvent):
                anchor, (nodes, levels) = open_nodes.pop()
                known[anchor] = [nodes, levels + 1]
                add(nodes, levels + 1, event)
            elif isinstance(event, yaml.ScalarEvent):
                known[event.anchor] = [1, 0]
                add(1, 0, event)
            elif isinstance(event, yaml.AliasEvent):
                if event.anchor in (anchor for anchor, _ in open_nodes):
                    refuse(event, f"*{event.anchor} is part of itself")
                nodes, levels = known.get(event.anchor, [1, 0])
                copies += nodes
                if copies > _MOST_COPIES:
                    refuse(event, f"aliases stand for more than {_MOST_COPIES} nodes")
                add(nodes, levels, event)
    except yaml.YAMLError:
        # The parser reports this error afterwards.
        return


@contextmanager
def replacing(file: str | Path, *, binary: bool = False) -> Iterator[Any]:
    """Yield a stream whose content replaces the file if the block ends without an error.

    The content is written to a temporary file in the same folder, which is renamed to the file and gets its
    permissions. Pipes and devices are written directly. An OSError names the file, also for a full disk.
    """
    path = Path(file)
    text: dict[str, Any] = {} if binary else {"encoding": "utf-8", "newline": ""}
    draft = None
    try:
        if path.exists() and not path.is_file():
            with path.open("wb" if binary else "w", **text) as stream:
                yield stream
            return
        # For a symbolic link, the target is replaced, not the link.
        place = path.resolve()
        draft = place.with_name(f".{token_hex(6)}{place.suffix}")
        with draft.open("xb" if binary else "x", **text) as stream:
            if place.exists():
                shutil.copymode(place, draft)
            yield stream
        os.replace(draft, place)
    except OSError as error:
        if error.filename not in (None, str(draft), str(file)):
            raise
        raise OSError(error.errno, error.strerror or str(error), str(file)) from error
    finally:
        if draft is not None:
            draft.unlink(missing_ok=True)


def write(file: str | Path, content: str | bytes) -> None:
    """Write text or bytes to a file, see `replacing`."""
    with replacing(file, binary=isinstance(content, bytes)) as stream:
        stream.write(content)


def table(header: Sequence[str], rows: Iterable[Sequence[object]], delimiter: str = ",") -> str:
    """Return a table as delimited text with a header line. Numbers are read back exactly."""
    stream = io.StringIO()
    writer = csv.writer(stream, delimiter=delimiter, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return stream.getvalue()


def dump_document(data: Any, *, flow: bool | None = False, width: float = 110) -> str:
    """Return `data` as YAML that is read back exactly; `flow` is PyYAML's `default_flow_style`."""
    style: dict[str, Any] = {"default_flow_style": flow, "width": width}
    text: str = yaml.dump(data, Dumper=_FlowListDumper, sort_keys=False, allow_unicode=True, **style)
    return text


def dump_line(value: Any) -> str:
    """Return a value as YAML on one line, with quotes for text such as "1.0"."""
    return dump_document(value, flow=True, width=np.inf).removesuffix("...\n").strip()


class _StrictLoader(_Loader):
    """PyYAML's safe loader, in C if available, that reads ``1e-3`` as a number and refuses repeated keys."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            value = super().construct_object(node, deep)
            if isinstance(value, int) and value.bit_length() > _MOST_BITS:
                raise ValueError
        except _BROKEN:
            # Examples are the invalid date 2026-13-45, the invalid number 0x_, and `!!bool maybe`.
            kind = node.tag.rpartition(":")[2]
            raise yaml.constructor.ConstructorError(
                None, None, f"no {kind}, to be quoted if it is text: {node.value!r}", node.start_mark
            ) from None
        return value

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, (list, dict, set)):
                raise yaml.constructor.ConstructorError(None, None, "a key must be text", key_node.start_mark)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} is given twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


class _FlowListDumper(yaml.SafeDumper):
    """PyYAML's safe dumper with lists of numbers on one line."""

    def represent_sequence(self, tag: str, sequence: Any, flow_style: bool | None = None) -> yaml.SequenceNode:
        plain = not any(isinstance(item, (dict, list, tuple)) for item in sequence)
        return super().represent_sequence(tag, sequence, flow_style=plain or self.default_flow_style)

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    """Quote text with line breaks of any kind, which would be read back as spaces otherwise."""
    style = None if text.isprintable() else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style)


_FlowListDumper.add_representer(str, _represent_text)
_FlowListDumper.add_representer(tuple, lambda dumper, data: dumper.represent_list(data))

# YAML 1.1 reads 1e-3 as text. The dumper needs the same rule, or it would write the text "1e3" without quotes.
for _side in (_StrictLoader, _FlowListDumper):
    _side.add_implicit_resolver(
        "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
    )
