"""One reader for all of the project's YAML files: scenarios, robots, imports.

Drake's `yaml_load_typed` makes the objects. What it says of a mistake names neither
the line nor the way to the key, so a file is compared with its schema first.
"""

import dataclasses
import os
import types
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
import yaml
from pydrake.common.yaml import yaml_dump, yaml_load_data, yaml_load_typed

from crar_drake.errors import CrarError, nearest

T = TypeVar("T")

# In C, where PyYAML was built with it: ten times as fast.
_FastLoader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

# The way to a value: keys, and indices in lists.
_Way = tuple[str | int, ...]

_BYTE_ORDER_MARKS = {b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}


class _Mistake(Exception):
    """What is wrong with a text, and where, in words."""


def read_text(path: str | os.PathLike[str], error: type[CrarError]) -> str:
    """Reads a whole text file in UTF-8, with or without a byte order mark.

    Raises:
        error: the file cannot be read, or is not UTF-8; the message names the file,
            line and byte.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as why:
        raise error(f"{path}: cannot be read: {why.strerror or why}") from why
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as why:
        line = data.count(b"\n", 0, why.start) + 1
        other = _BYTE_ORDER_MARKS.get(data[:2])
        raise error(
            f"{path}: line {line}: byte {why.start + 1} of the file, "
            f"0x{data[why.start]:02x}, is not UTF-8"
            + (f" (the file begins like {other})" if other else "")
            + "; save it as UTF-8"
        ) from why


def load_yaml(
    text: str,
    schema: type[T],
    source: str,
    error: type[CrarError],
    *,
    manual: str,
    defaults: T | None = None,
    kinds: Mapping[str, tuple[str, Mapping[str, type]]] = MappingProxyType({}),
) -> T:
    """Makes an object of a YAML text.

    Args:
        text: YAML, a mapping.
        schema: a dataclass, or a configuration of Drake's.
        source: what to call the text in messages, usually the file's path.
        manual: where the user finds what such a file holds, for messages.
        defaults: of keys that the text leaves out; by default those of `schema`.
        kinds: top-level keys whose class one of their own keys chooses: that key, and
            its values to classes. A class that lacks the key is not given it.

    Raises:
        error: the text is no YAML, is empty, has a key twice or one that the schema
            does not know at that level, or a value of another type. The message names
            the source, the way to the key and the line.
    """
    try:
        document, lines = _document(text)
        if document is None:
            raise _Mistake(f"the file is empty; {manual} shows what it may hold")
        if not isinstance(document, dict):
            raise _Mistake(
                f"expected keys and values, found {_shown(document)}; see {manual}"
            )
        chosen = [_choose(document, key, *kind) for key, kind in kinds.items()]
        for way, message in _mistakes(document, schema, ()):
            line = lines.get(way) or lines.get(way[:-1])
            at = f" (line {line})" if line else ""
            if "unknown key" in message and len(way) == 2 and way[0] in kinds:
                message = _of_another_kind(way[1], *kinds[way[0]])
            raise _Mistake(f"{_spelled(way)}{at}: {message}")
        if any(chosen):
            text = yaml_dump(document)
    except _Mistake as why:
        raise error(f"{source}: {why}") from why.__cause__
    try:
        return yaml_load_typed(schema=schema, data=text, defaults=defaults)
    except Exception as why:  # what Drake checks besides
        raise error(f"{source}: {why}; see {manual}") from why


# --- the text ---------------------------------------------------------------------


def _document(text: str) -> tuple[Any, dict[_Way, int]]:
    """What a text holds, None if nothing, and the line of each key and list entry."""
    try:
        try:
            root = yaml.compose(text, Loader=_FastLoader)
        except yaml.YAMLError:  # whose words PyYAML's own parser finds
            root = yaml.compose(text, Loader=yaml.SafeLoader)
        if root is None:  # which Drake would take for no argument
            return None, {}
        # Keys at the top are names: Drake's reader crashes at a number.
        for key, _ in root.value if isinstance(root, yaml.MappingNode) else ():
            kind = key.tag.rpartition(":")[2]
            if kind in ("int", "float", "bool", "null", "timestamp"):
                line = key.start_mark.line + 1
                raise _Mistake(f"line {line}: the key {key.value[:40]} is no name")
        return yaml_load_data(text), _lines(root)
    except yaml.YAMLError as why:
        raise _Mistake(_syntax(why, text)) from why
    except RecursionError as why:
        raise _Mistake(
            "not YAML that can be read: it is nested too deep, or within itself"
        ) from why
    except ValueError as why:  # of a value that looks like a date but is none
        raise _Mistake(f"not YAML that can be read: {why}") from why


def _syntax(error: yaml.YAMLError, text: str) -> str:
    """What the YAML parser found, in one line."""
    mark = getattr(error, "problem_mark", None)
    if mark is None:  # a character that no YAML may hold
        position = getattr(error, "position", None)
        if position is None:
            return f"not YAML: {' '.join(str(error).split())}"
        line = text.count("\n", 0, position) + 1
        return (
            f"line {line}: the character {text[position]!r} may not be in YAML; "
            "remove it"
        )
    problem = error.problem or "cannot be read"
    begun = getattr(error, "context_mark", None)
    if begun is not None and error.context:
        problem += f" ({error.context}, begun in line {begun.line + 1})"
    return f"line {mark.line + 1}, column {mark.column + 1}: not YAML: {problem}"


def _lines(root: yaml.Node) -> dict[_Way, int]:
    """The line of each key and list entry; no key may be there twice."""
    lines: dict[_Way, int] = {}
    waiting: list[tuple[yaml.Node, _Way]] = [(root, ())]
    seen: set[int] = set()  # what an alias repeats is looked at once
    while waiting:
        node, way = waiting.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        if isinstance(node, yaml.SequenceNode):
            entries = [(i, entry, entry) for i, entry in enumerate(node.value)]
        elif isinstance(node, yaml.MappingNode):
            entries = [(key.value, key, value) for key, value in node.value]
        else:
            continue
        for name, key, value in entries:
            if name == "<<" or isinstance(name, list):  # keys that are none
                continue
            here, line = (*way, name), key.start_mark.line + 1
            if here in lines:
                raise _Mistake(
                    f"{_spelled(here)}: the key is there twice, in lines "
                    f"{lines[here]} and {line}; keep one"
                )
            lines[here] = line
            waiting.append((value, here))
    return lines


def _spelled(way: _Way) -> str:
    """controller.balance.margin, tasks[0].frame"""
    text = ""
    for part in way:
        text += f"[{part}]" if isinstance(part, int) else f".{part}"
    return text.removeprefix(".")


# --- classes that a key chooses ---------------------------------------------------


def _choose(
    document: dict[str, Any], key: str, by: str, kinds: Mapping[str, type]
) -> bool:
    """Tags a key's value with the class that its own key `by` names; whether it did."""
    value = document.get(key)
    if not isinstance(value, dict) or by not in value or value[by] not in kinds:
        return False
    kind = kinds[value[by]]
    if by not in _fields(kind):
        del value[by]
    value["_tag"] = f"!{kind.__name__}"
    return True


def _of_another_kind(name: str, by: str, kinds: Mapping[str, type]) -> str:
    """What is said of a key that the class that was chosen does not have."""
    if name == by:
        return f"it may be {', '.join(kinds)}"
    words = [word for word, kind in kinds.items() if name in _fields(kind)]
    if words:
        return f"it belongs to {by}: {words[-1]}"
    known = [each for kind in kinds.values() for each in _fields(kind)]
    return f"unknown key {name!r}{nearest(name, [*known, by])}"


# --- the schema -------------------------------------------------------------------


def _mistakes(value: Any, schema: Any, way: _Way) -> Iterator[tuple[_Way, str]]:
    """Yields where `value` does not fit the schema, and why."""
    origin, arguments = typing.get_origin(schema), typing.get_args(schema)
    if origin in (typing.Union, types.UnionType):
        rest = [kind for kind in arguments if kind is not types.NoneType]
        if value is None and len(rest) < len(arguments):
            return
        tag = value.get("_tag") if isinstance(value, dict) else None
        named = [kind for kind in rest if tag == f"!{getattr(kind, '__name__', '')}"]
        # Of several, Drake chooses by the value's tag, else the first.
        if len(rest) == 1 or named or _fields(rest[0]) is not None:
            yield from _mistakes(value, (named or rest)[0], way)
    elif schema in (bool, int, float, str):
        if not _fits(value, schema):
            yield way, f"expected {_NAMES[schema]}, found {_shown(value)}"
    elif origin is list or schema is np.ndarray:
        if not isinstance(value, list):
            yield way, f"expected a list, as in [a, b], found {_shown(value)}"
            return
        for i, entry in enumerate(value):
            yield from _mistakes(entry, arguments[0] if arguments else float, (*way, i))
    elif origin is dict:
        if not isinstance(value, dict):
            yield way, f"expected names and their values, found {_shown(value)}"
            return
        for key, entry in value.items():
            if not isinstance(key, str):
                yield (*way, str(key)), f"expected a name, found {_shown(key)}"
                return
            yield from _mistakes(entry, arguments[1], (*way, key))
    else:
        known = _fields(schema)
        if known is None:
            return
        if not isinstance(value, dict):
            keys = ", ".join(list(known)[:3])
            yield way, f"expected keys such as {keys}, found {_shown(value)}"
            return
        for key, entry in value.items():
            if key == "_tag":
                continue
            if key not in known:
                hint = nearest(str(key), known)
                yield (*way, str(key)), f"unknown key {str(key)!r}{hint}"
                return
            yield from _mistakes(entry, known[key], (*way, key))


def _fields(schema: Any) -> dict[str, Any] | None:
    """Key to type of a dataclass or of a configuration of Drake's."""
    if dataclasses.is_dataclass(schema):
        return {entry.name: entry.type for entry in dataclasses.fields(schema)}
    fields = getattr(schema, "__fields__", None)
    return None if fields is None else {entry.name: entry.type for entry in fields}


_NAMES = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}


def _fits(value: Any, kind: type) -> bool:
    """Whether Drake's loader makes a `kind` of the value."""
    if kind is bool:
        return isinstance(value, bool) or value in ("true", "false")
    if kind is str:
        return isinstance(value, str)
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return False
    if kind is int and isinstance(value, float):
        return value.is_integer()
    try:
        kind(value)  # "1e-3" is text to YAML
    except (ValueError, OverflowError):
        return False
    return True


def _shown(value: Any) -> str:
    """A value as the user wrote it, or nearly, and what YAML takes it for."""
    if value is None:
        return "nothing (null)"
    if isinstance(value, bool):
        # YAML 1.1 takes more words for these than one expects.
        return f"{str(value).lower()} (true, yes and on are the same; as text quote it)"
    if isinstance(value, int | float):
        return f"the number {value}"
    if isinstance(value, str):
        return f"the text {_short(value)}"
    if isinstance(value, list):
        return f"the list {_short(value)}"
    if isinstance(value, dict):
        return f"the keys {_short(', '.join(map(str, value)))}"
    return f"{_short(str(value))}, which YAML takes for a {type(value).__name__}"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
