"""Documents: checks of their values, and YAML files; errors name file, line, key and value.

Every check raises an `InputError` whose message starts with the key that it is about. Each level of a
document wraps its children in `within`, so that the message grows into the full path on its way up:
``scene.obstacles[2] 'table'.box.size: must be a positive number, got -0.2``.

Lines are looked up only when there is an error, from the key that its message starts with:
``scenarios/x.yaml:7: scene.obstacles[2] 'table'.box.size: must be a positive number, got -0.2``. ruamel.yaml, which
keeps them with the data, takes ten times as long for any document.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, Field, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

from safe_ompl.common import inputs
from safe_ompl.common.errors import InputError, cut, did_you_mean

if TYPE_CHECKING:
    _Loader = yaml.SafeLoader
else:
    _Loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # six times as fast
_DEEPEST = 100  # levels of lists and mappings in one another
_Section = TypeVar("_Section")
_Kind = TypeVar("_Kind", bound="Section")


@contextmanager
def within(place: str, separator: str = ".") -> Iterator[None]:
    """Put `place` before the key of every InputError raised inside the block."""
    try:
        yield
    except InputError as error:
        error.args = (f"{place}{separator}{error}",)
        raise


def mapping(key: str, value: Any, valid: Iterable[str] | None = None) -> dict[str, Any]:
    """Return `value` as a mapping with text keys, all of them among `valid` if given."""
    if not isinstance(value, Mapping):
        raise InputError(f"must be a mapping of keys to values, got {kind_of(value)}", key)
    for name in value:
        if not isinstance(name, str):
            raise InputError(f"the key {name!r} must be text", key)
    if valid is not None:
        with within(key):
            check_keys(value, valid)
    return dict(value)


def check_keys(data: Mapping[str, Any], valid: Iterable[str]) -> None:
    """Raise InputError for the first key of `data` that is not among `valid`."""
    known = list(valid)
    for name in data:
        if name not in known:
            hint = did_you_mean(name, known)
            raise InputError(f"unknown key; {hint}valid keys: {', '.join(known)}", cut(str(name)))


def require(data: Mapping[str, Any], key: str) -> Any:
    """Return ``data[key]``, or raise InputError if there is none."""
    if key not in data:
        raise InputError("missing, but needed", key)
    return data[key]


def check_fields(cls: Any, data: Mapping[str, Any]) -> None:
    """Raise InputError unless the keys of `data` are fields of a dataclass, those without a default among them."""
    check_keys(data, [field.name for field in fields(cls)])
    for field in fields(cls):
        if _default(field) is MISSING:
            require(data, field.name)


def changed_fields(value: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that differ from their defaults."""
    given = ((field, getattr(value, field.name)) for field in fields(value))
    return {field.name: found for field, found in given if found != _default(field)}


def _default(field: Field[Any]) -> Any:
    return field.default if field.default_factory is MISSING else field.default_factory()


@dataclass(frozen=True)
class Section:
    """A section of a document, whose keys are the fields of a dataclass; raises InputError that starts with the key."""

    @classmethod
    def from_mapping(cls: type[_Kind], data: Mapping[str, Any]) -> _Kind:
        """Read the section from a document."""
        check_fields(cls, data)
        return cls(**data)

    def to_mapping(self) -> dict[str, Any]:
        """Return what `from_mapping` reads: what is not the default."""
        return {key: _plain(value) for key, value in changed_fields(self).items()}


def _plain(value: Any) -> Any:
    if hasattr(value, "to_mapping"):
        return value.to_mapping()
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def text(key: str, value: Any) -> str:
    """Return `value` as text that is not empty."""
    return inputs.text(f"{key}:", value)


def flag(key: str, value: Any) -> bool:
    """Return `value` as a bool."""
    return inputs.flag(f"{key}:", value)


def file(key: str, value: Any, endings: tuple[str, ...]) -> Path:
    """Return `value` as the absolute path of a file that exists and ends in one of `endings`."""
    if not isinstance(value, (str, os.PathLike)):
        raise InputError(f"must be a file name, got {inputs.shown(value)}", key)
    path = Path(value).resolve()
    if path.suffix.lower() not in endings:
        raise InputError(f"{str(value)!r} must end in {' or '.join(endings)}", key)
    if not path.is_file():
        raise InputError(f"{str(value)!r} does not exist", key)
    return path


def file_name(path: Path, folder: Path | None) -> str:
    """Return how a document in `folder` names `path`: relative to it, or in full if there is none."""
    return str(path) if folder is None else Path(os.path.relpath(path, folder.resolve())).as_posix()


def number(
    key: str,
    value: Any,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> float:
    """Return `value` as a finite float within bounds."""
    return inputs.number(f"{key}:", value, above=above, at_least=at_least, at_most=at_most)


def numbers(
    key: str,
    value: Any,
    count: int | None = None,
    *,
    above: float | None = None,
    at_most: float | None = None,
) -> tuple[float, ...]:
    """Return `value` as `count` finite floats, each larger than `above` and no larger than `at_most` if given."""
    items = sequence(key, value)
    if count is not None and len(items) != count:
        raise InputError(f"must be {count} numbers, got {len(items)}: {inputs.shown(items)}", key)
    return tuple(number(key, item, above=above, at_most=at_most) for item in items)


def interval(key: str, value: Any) -> tuple[float, float]:
    """Return `value` as two finite floats, the second one larger than the first."""
    low, high = numbers(key, value, 2)
    if not low < high:
        raise InputError(f"must be the least and the largest value, got [{low:g}, {high:g}]", key)
    return low, high


def numbers_by_name(
    key: str,
    value: Any,
    valid: Iterable[str] | None = None,
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
) -> dict[str, float]:
    """Return `value` as a mapping of names, among `valid` if given, to finite floats within bounds."""
    bounds = {"above": above, "at_least": at_least, "at_most": at_most}
    given = mapping(key, value, valid)
    with within(key):
        return {name: number(name, item, **bounds) for name, item in given.items()}


def section(key: str, value: Any, read: Callable[[dict[str, Any]], _Section]) -> _Section:
    """Return what `read` makes of a mapping; nothing is an empty one."""
    given = mapping(key, {} if value is None else value)
    with within(key):
        return read(given)


def sequence(key: str, value: Any) -> list[Any]:
    """Return `value` as a list; arrays are welcome, text is not."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if not isinstance(value, (list, tuple)):
        raise InputError(f"must be a list, got {kind_of(value)}", key)
    return list(value)


def kind_of(value: Any) -> str:
    """Return what `value` is, for messages: its type and how it is written."""
    return "nothing" if value is None else f"{type(value).__name__} {inputs.shown(value)}"


@contextmanager
def reading(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the mapping that a YAML file holds; put file and line before the key of every InputError meanwhile."""
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
    """Return the text of a file, or raise InputError where it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"is not text in UTF-8 ({error})") from None
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})") from None


def _line_of(content: str, message: str) -> int | None:
    """Return the line of the key, or of the deepest mapping around it, that a message starts with; None if unknown."""
    try:
        _check_depth(content)
        node, line, rest = yaml.compose(content, Loader=_StrictLoader), None, message
    except (yaml.YAMLError, InputError):
        return None
    while True:
        found = _child(node, rest)
        if found is None:
            return line
        node, line, rest = found


def _child(node: yaml.Node | None, rest: str) -> tuple[yaml.Node, int, str] | None:
    """Return the value that the beginning of `rest` leads to, its line, and what is left of `rest`."""
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
    """Return `rest` without the name of a list's item, which messages put behind its number, and the dot."""
    entries = item.value if isinstance(item, yaml.MappingNode) else []
    for name in (str(value.value) for key, value in entries if key.value == "name"):
        for shown in (f" {name!r}", f" {name}"):
            if rest.startswith(shown):
                return rest[len(shown) :].removeprefix(".")
    return rest.removeprefix(".")


def parse_document(content: str) -> dict[str, Any]:
    """Return the mapping that YAML text holds, empty where there is none; raise InputError for anything else."""
    _check_depth(content)
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
        raise InputError(f"must be a mapping of keys to values, got {kind_of(data)}")
    return data


def _check_depth(content: str) -> None:
    """Raise InputError where YAML is nested deeper than any document: its C parser would overrun its stack."""
    depth = 0
    try:
        for event in yaml.parse(content, Loader=_StrictLoader):
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                if depth > _DEEPEST:
                    line = None if event.start_mark is None else f"line {event.start_mark.line + 1}"
                    raise InputError(f"malformed YAML: nested deeper than {_DEEPEST} levels", line)
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
    except yaml.YAMLError:
        return  # who reads it says what is wrong


def dump_document(data: Mapping[str, Any]) -> str:
    """Return `data` as YAML; numbers are written so that they are read back exactly."""
    return yaml.dump(data, Dumper=_FlowListDumper, sort_keys=False, allow_unicode=True, width=110)


class _StrictLoader(_Loader):
    """YAML's safe loader, in C where there is one, that reads ``1e-3`` as a number and refuses a key given twice."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, (list, dict)):
                raise yaml.constructor.ConstructorError(None, None, "a key must be text", key_node.start_mark)
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} is given twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


class _FlowListDumper(yaml.SafeDumper):
    """YAML's safe dumper with lists of numbers on one line."""

    def represent_sequence(
        self, tag: str, sequence: Any, flow_style: bool | None = None
    ) -> yaml.SequenceNode:
        plain = not any(isinstance(item, (dict, list, tuple)) for item in sequence)
        return super().represent_sequence(tag, sequence, flow_style=plain)

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    """Quote text with line breaks of all kinds, which come back as spaces otherwise."""
    style = None if text.isprintable() else '"'
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style)


_FlowListDumper.add_representer(str, _represent_text)
_FlowListDumper.add_representer(tuple, lambda dumper, data: dumper.represent_list(data))

# YAML 1.1 takes 1e-3 for text. The dumper must know the rule too, or it writes the text "1e3" without quotes.
for _side in (_StrictLoader, _FlowListDumper):
    _side.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"),
        list("-+.0123456789"),
    )
