"""Hostile values at every key of every table: refused with file and key, or read. The keys come from the models."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

import pytest
from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from skygcs.config.extension_tables import find_owners, installed
from skygcs.config.loader import load_fleet
from skygcs.config.models import NO_TABLES, FleetConfig
from skygcs.errors import ConfigError

HOSTILE: tuple[str, ...] = (
    *("true", "nan", "inf", "-inf", "-1", "0", "-0.0", "5e-324", "1e308", "-1e308", "9223372036854775807", "1.5"),
    *(f"{10**400}", "1979-05-27T07:32:00Z", "[]", "{}", "[[]]", "[{}]", "[nan]", "{x = {y = {}}}", '[""]'),
    *('""', '" "', '"."', '"/"', '"~nobody-of-this-name/x"', '"../../etc/passwd"', '"/dev/zero"', '"\\u0000"'),
    *('"\\u001b[2J\\n"', '"\\u202e\\u2066"', '"\U0001f681"', '"e\\u0301"', '"%s{0}${HOME}"', '"a b/c:d,e"', '"1"'),
    *('"\\U0010ffff"', f'"{"x" * 70_000}"', f'["{"y" * 300}", "y", "y"]', '{"" = 1, "\\n" = "x"}', '{"*" = 1e300}'),
    *('"[::1"', '"255.255.255.256"', '"http://user:pw@h:99999/\\r\\nX: y"', "[1, 1, 1]", "[999]", '["all", "all"]'),
)
"""TOML values of the wrong type, range, length and content."""


class Place(NamedTuple):
    """One key, and the other tables of a file that may have it."""

    path: tuple[str, ...]
    others: dict[str, Any]


def places() -> Iterator[Place]:
    """Every key of every table that a fleet file may have, those of the extensions with them."""
    owners, unusable = find_owners(set(installed()))
    assert not unusable
    fields = {n: f for n, f in FleetConfig.model_fields.items() if n not in NO_TABLES}
    for name, field in fields.items():
        yield from _of_value(field.annotation, (name,), {})
    for name, owner in owners.items():
        yield from _of_value(owner.Config, (name,), {})


def _of_value(annotation: Any, path: tuple[str, ...], others: dict[str, Any]) -> Iterator[Place]:
    """The key of a value of this type, and the keys within it."""
    yield Place(path, others)
    for model, name in _tables(annotation):
        inside = (*path, name) if name else path
        if name:
            yield Place(inside, others)
        needed = {
            n: _some(f.annotation)
            for n, f in model.model_fields.items()
            if f.default is PydanticUndefined and f.default_factory is None
        }
        if "type" in model.model_fields and isinstance(model.model_fields["type"].default, str):
            needed["type"] = model.model_fields["type"].default
        for name_, field in model.model_fields.items():
            rest = _with(others, inside, {n: v for n, v in needed.items() if n != name_})
            yield from _of_value(field.annotation, (*inside, name_), rest)


def _tables(annotation: Any) -> Iterator[tuple[type[BaseModel], str]]:
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from _tables(get_args(annotation)[0])
    elif origin is Union or origin is UnionType:
        for one in get_args(annotation):
            yield from _tables(one)
    elif origin is dict:
        for model, _ in _tables(get_args(annotation)[1]):
            yield model, "one"
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation, ""


def _some(annotation: Any) -> Any:
    """A value that a required key may have."""
    origin = get_origin(annotation)
    if origin is Annotated:
        return _some(get_args(annotation)[0])
    if origin is Literal:
        return get_args(annotation)[0]
    if origin is Union or origin is UnionType:
        return _some(get_args(annotation)[0])
    if origin in (tuple, list):
        return [_some(get_args(annotation)[0])]
    if origin is dict:
        return {}
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {n: _some(f.annotation) for n, f in annotation.model_fields.items() if f.is_required()}
    return {str: "some", int: 1, float: 1.0, bool: True, Path: "some"}.get(annotation, "some")


def _with(table: dict[str, Any], path: tuple[str, ...], values: dict[str, Any]) -> dict[str, Any]:
    """A copy of the table with these values in the table at the path."""
    if not path:
        return {**table, **values}
    return {**table, path[0]: _with(table.get(path[0], {}), path[1:], values)}


def written(place: Place, value: str) -> str:
    """The fleet file, as inline tables."""
    return "".join(
        f"{key} = {_inline(inner, place.path[1:] if key == place.path[0] else None, value)}\n"
        for key, inner in _with(place.others, place.path[:-1], {place.path[-1]: None}).items()
    )


def _inline(inner: Any, path: tuple[str, ...] | None, value: str) -> str:
    if path == ():
        return value
    if isinstance(inner, dict):
        items = (
            f"{json.dumps(k)} = {_inline(v, path[1:] if path and k == path[0] else None, value)}"
            for k, v in inner.items()
        )
        return "{" + ", ".join(items) + "}"
    if isinstance(inner, list):
        return "[" + ", ".join(_inline(item, None, value) for item in inner) + "]"
    return json.dumps(inner)


def problem_of(place: Place, value: str, folder: Path) -> str | None:
    """The fault of the answer to this value at this key; None: it was read, or refused as it should be."""
    file = folder / "fleet.toml"
    file.write_text(written(place, value), encoding="utf-8")
    try:
        load_fleet(file)
    except ConfigError as error:
        text = str(error)
        if str(file) not in text or not any(".".join(place.path[:n]) in text for n in range(1, len(place.path) + 1)):
            return f"the file or the key is not named: {text[:300]}"
        return f"{len(text)} characters" if len(text) > 5000 else None
    except Exception as error:  # what a person would see as a traceback
        return repr(error)[:300]
    return None


def cases(step: int) -> Iterator[tuple[Place, str]]:
    """Every ``step``-th key with one value each, so that neighbours get different ones."""
    found = sorted(places(), key=lambda place: place.path)
    yield from itertools.islice(zip(found, itertools.cycle(HOSTILE), strict=False), 0, None, step)


@pytest.mark.parametrize("step", [19, pytest.param(1, marks=pytest.mark.deep)])
def test_a_hostile_value_is_refused_with_file_and_key_or_read(step: int, tmp_path: Path) -> None:
    bad = [
        (".".join(place.path), value[:40], problem)
        for place, value in cases(step)
        if (problem := problem_of(place, value, tmp_path)) is not None
    ]
    assert bad == []


@pytest.mark.parametrize("value", ["x" * 300, "x" * 300 + ".xml", "d/" * 3000 + "x.xml"])
def test_a_name_that_no_file_may_have_is_no_traceback(value: str, tmp_path: Path) -> None:
    for place in (Place(("dialect",), {}), Place(("daemon", "log_dir"), {}), Place(("metrics", "token_file"), {})):
        assert problem_of(place, json.dumps(value), tmp_path) is None
