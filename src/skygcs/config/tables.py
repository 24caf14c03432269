"""Parts that every table of the fleet file shares: its model, its paths, and problems with the line of their key."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, ConfigDict

KeyPath = tuple[str | int, ...]
"""("links", "radio", "baud"): where a key stands in the file."""


class Model(BaseModel):
    """One table: frozen, unknown keys refused."""

    # deferred: validators of tables that a fleet file does not have are not made, and the others once, inside the whole
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing wrong with a fleet file. ``missing``: the key at ``path`` should be there and is not."""

    path: KeyPath
    text: str
    missing: bool = False


M = TypeVar("M", bound=BaseModel)


def model_at(model: type[BaseModel], path: KeyPath, table: Any) -> type[BaseModel] | None:
    """The model of the table at this path below a table of ``model``; None: there is none. ``table``: the values as
    read, whose "type" chooses among several models."""
    found = list(dict.fromkeys(_models_at(model, path)))
    for part in path:
        table = table.get(part) if isinstance(table, dict) else None
    kind = table.get("type") if isinstance(table, dict) else None
    if len(found) > 1:
        found = [one for one in found if "type" in one.model_fields and one.model_fields["type"].default == kind]
    return found[0] if found else None


def _models_at(annotation: Any, path: KeyPath) -> Iterator[type[BaseModel]]:
    """The models of tables at this path below a value of this type."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _models_at(get_args(annotation)[0], path)
    elif origin is Union or origin is UnionType:
        for one in get_args(annotation):
            yield from _models_at(one, path)
    elif origin is dict and path:
        yield from _models_at(get_args(annotation)[1], path[1:])
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if not path:
            yield annotation
        elif (field := annotation.model_fields.get(str(path[0]))) is not None:
            yield from _models_at(field.annotation, path[1:])
        elif annotation.model_config.get("extra") == "allow":  # its further tables, by name
            yield from _models_at(get_type_hints(annotation)["__pydantic_extra__"], path)


def with_absolute_paths(table: M, key: KeyPath, absolute: Callable[[Path, KeyPath], Path]) -> M:
    """The same table with every path in it made absolute by ``absolute``, which gets the path and its key."""
    update = {}
    for name in type(table).model_fields:
        value = getattr(table, name)
        changed = _absolute(value, (*key, name), absolute)
        if changed is not value:
            update[name] = changed
    return table.model_copy(update=update) if update else table


def _absolute(value: Any, key: KeyPath, absolute: Callable[[Path, KeyPath], Path]) -> Any:
    """The same value with absolute paths; the value itself if it has none."""
    if isinstance(value, Path):
        return absolute(value, key)
    if isinstance(value, BaseModel):
        return with_absolute_paths(value, key, absolute)
    if isinstance(value, dict):
        changed = {name: _absolute(item, (*key, name), absolute) for name, item in value.items()}
        return changed if any(changed[name] is not item for name, item in value.items()) else value
    return value


_TOKEN = re.compile(
    r'"""|\'\'\''  # begin of a text over several lines
    r'|"(?:[^"\\]|\\.)*"'
    r"|'[^']*'"
    r"|[\[\]{}]"
    r"|\#.*"
)


def key_lines(text: str) -> dict[KeyPath, int]:
    """Key path -> line (1-based) of every table header and key of a TOML text that tomllib has accepted.

    Keys inside inline tables are not listed: `line_of` finds the line of the key that holds them.
    """
    lines: dict[KeyPath, int] = {}
    table: KeyPath = ()
    depth = 0
    quote = ""
    for number, line in enumerate(text.split("\n"), start=1):
        if not quote and not depth:
            statement = line.strip()
            if statement.startswith("["):
                table = _header(statement)
                for length in range(1, len(table) + 1):
                    lines.setdefault(table[:length], number)
                continue
            key = _key(statement) if "=" in statement and not statement.startswith("#") else ()
            for length in range(1, len(key) + 1):
                lines.setdefault(table + key[:length], number)
        depth, quote = _continues(line, depth, quote)
    return lines


def line_of(path: KeyPath, lines: dict[KeyPath, int]) -> int | None:
    """Line of that key, else of the nearest table or key around it; None for the whole file."""
    for length in range(len(path), 0, -1):
        if (line := lines.get(path[:length])) is not None:
            return line
    return None


def _header(statement: str) -> KeyPath:
    try:
        return _path(statement)
    except tomllib.TOMLDecodeError:  # not a header after all: no line is better than no fleet file
        return ()


def _key(statement: str) -> KeyPath:
    """The dotted key in front of '='."""
    for end in [m.start() for m in re.finditer("=", statement)]:
        try:
            return _path(f"{statement[:end]} = 0")
        except tomllib.TOMLDecodeError:
            continue  # this '=' stands inside a quoted key
    return ()


def _path(statement: str) -> KeyPath:
    """The key path of a table header or of ``key = 0``, by tomllib itself: quotes and escapes are its business."""
    node: object = tomllib.loads(statement)
    path: list[str | int] = []
    while True:
        if isinstance(node, list):  # [[header]]
            node = node[0]
        if not isinstance(node, dict) or not node:
            return tuple(path)
        key = next(iter(node))
        path.append(key)
        node = node[key]


def _continues(line: str, depth: int, quote: str) -> tuple[int, str]:
    """(open brackets, open quote of several lines) after this line."""
    at = 0
    while True:
        if quote:
            end = line.find(quote, at)
            if end < 0:
                return depth, quote
            at, quote = end + len(quote), ""
        found = _TOKEN.search(line, at)
        if found is None:
            return depth, ""
        token = found.group()
        at = found.end()
        if token in ('"""', "'''"):
            quote = token
        elif token in "[{":
            depth += 1
        elif token in "]}":
            depth = max(depth - 1, 0)
