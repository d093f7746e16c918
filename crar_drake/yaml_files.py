"""One reader for all of the project's YAML files: scenarios, robots, imports.

Drake's `yaml_load_typed` makes the objects. What it says of a mistake names neither
the line nor the way to the key, so a file is compared with its schema first.
"""

import dataclasses
import os
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
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
    of_others: Mapping[_Way, Any] = MappingProxyType({}),
    kinds: Mapping[str, tuple[str, Mapping[str, type]]] = MappingProxyType({}),
) -> T:
    """Makes an object of a YAML text.

    Args:
        text: YAML, a mapping.
        schema: a dataclass, or a configuration of Drake's.
        source: what to call the text in messages, usually the file's path.
        manual: where the user finds what such a file holds, for messages.
        defaults: of keys that the text leaves out; by default those of `schema`.
        of_others: the way to settings that the Drake which is installed does not
            have, to what it does anyway. They are left out where they say that.
        kinds: top-level keys whose class one of their own keys chooses: that key, and
            its values to classes. A class that lacks the key is not given it.

    Raises:
        error: the text is no YAML, is empty, has a key twice or one that the schema
            does not know at that level, or a value of another type; or a setting
            of `of_others` says something else. The message names the source, the
            way to the key and the line.
    """
    try:
        root = _composed(text)
        _check_names(root, source, error)
        # No text would be taken for no argument.
        document = yaml_load_data(text) if root is not None else None
        lines = _lines(root, source, error) if document is not None else {}
    except yaml.YAMLError as why:
        raise error(f"{source}: {_syntax(why, text)}") from why
    except RecursionError as why:
        raise error(
            f"{source}: not YAML that can be read: it is nested too deep, "
            "or within itself"
        ) from why
    except ValueError as why:
        if isinstance(why, CrarError):
            raise
        # Of a value that looks like a date but is none.
        raise error(f"{source}: not YAML that can be read: {why}") from why
    if document is None:
        raise error(f"{source}: the file is empty; {manual} shows what it may hold")
    if not isinstance(document, dict):
        raise error(
            f"{source}: expected keys and values, found {_shown(document)}; see "
            f"{manual}"
        )
    chosen = [_choose(document, key, *kind) for key, kind in kinds.items()]
    others = {
        (key, name): f"it belongs to {by}: {word}"
        for key, (by, of) in kinds.items()
        for word, kind in of.items()
        for name in (*_fields(kind), by)
    }
    foreign = _take_out(document, of_others)
    mistakes = [
        (way, _of_another_drake(value, of_others[way]))
        for way, value in foreign.items()
        if value != of_others[way]
    ]
    for way, message in mistakes or _mistakes(document, schema, ()):
        line = lines.get(way) or lines.get(way[:-1])
        at = f" (line {line})" if line else ""
        if "unknown key" in message and len(way) == 2 and way[0] in kinds:
            names = [name for key, name in others if key == way[0]]
            message = f"unknown key {way[1]!r}{nearest(str(way[1]), names)}"
        if "unknown key" in message and way in others:
            message = others[way]
            if way[-1] == kinds[way[0]][0]:
                message = f"it may be {', '.join(kinds[way[0]][1])}"
        raise error(f"{source}: {_spelled(way)}{at}: {message}")
    if foreign or any(chosen):
        text = yaml_dump(document)
    try:
        return yaml_load_typed(schema=schema, data=text, defaults=defaults)
    except Exception as why:  # what Drake checks besides
        raise error(f"{source}: {why}; see {manual}") from why


def _composed(text: str) -> yaml.Node | None:
    """The nodes of a text; what is wrong with it, in the words of PyYAML's own
    parser."""
    try:
        return yaml.compose(text, Loader=_FastLoader)
    except yaml.YAMLError:
        return yaml.compose(text, Loader=yaml.SafeLoader)


# --- the text ---------------------------------------------------------------------


def _check_names(root: yaml.Node | None, source: str, error: type[CrarError]) -> None:
    """Keys at the top are names: Drake's reader crashes at a number."""
    for key, _ in root.value if isinstance(root, yaml.MappingNode) else ():
        kind = key.tag.rpartition(":")[2]
        if kind in ("int", "float", "bool", "null", "timestamp"):
            raise error(
                f"{source}: line {key.start_mark.line + 1}: the key {key.value[:40]} "
                "is no name"
            )


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


def _lines(root: yaml.Node, source: str, error: type[CrarError]) -> dict[_Way, int]:
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
            for i, entry in enumerate(node.value):
                lines[*way, i] = entry.start_mark.line + 1
                waiting.append((entry, (*way, i)))
        elif isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                if not isinstance(key, yaml.ScalarNode) or key.value == "<<":
                    continue
                here, line = (*way, key.value), key.start_mark.line + 1
                if here in lines:
                    raise error(
                        f"{source}: {_spelled(here)}: the key is there twice, in "
                        f"lines {lines[here]} and {line}; keep one"
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


# --- what another Drake has -------------------------------------------------------


def _take_out(document: Any, ways: Iterable[_Way]) -> dict[_Way, Any]:
    """Removes what a document has at these ways, and returns it."""
    taken = {}
    for way in ways:
        holder = document
        for key in way[:-1]:
            holder = holder.get(key) if isinstance(holder, dict) else None
        if isinstance(holder, dict) and way[-1] in holder:
            taken[way] = holder.pop(way[-1])
    return taken


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


def _of_another_drake(value: Any, usual: Any) -> str:
    return (
        f"{value}: the Drake that is installed does not have this setting, and does as "
        f"if it were {usual}; leave it out"
    )


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
