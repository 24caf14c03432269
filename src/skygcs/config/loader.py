"""Reads a fleet file: TOML -> FleetConfig, or one ConfigError with every problem, its key and its line."""

from __future__ import annotations

import copy
import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from skygcs.config.checks import (
    conflicts,
    control_place_problems,
    dialect_problems,
    message_problems,
    stream_problems,
    timing_problems,
)
from skygcs.config.dialects import load_dialect, located
from skygcs.config.extension_tables import TableOwner, find_owners, installed, places_of_control
from skygcs.config.files import read_named
from skygcs.config.models import LINK_TYPES, NO_TABLES, AnyLink, FleetConfig, LinkCommon, LinkConfig
from skygcs.config.tables import KeyPath, Problem, key_lines, line_of, model_at, with_absolute_paths
from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import ConfigError, DialectError
from skygcs.spelling import near_names, parse_toml

_CORE_TABLES = set(FleetConfig.model_fields) - NO_TABLES

_EXPECTED = {
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "string_type": "text in quotes",
    "path_type": "a path in quotes",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a table",
    "too_short": "a list of at least one",
    "string_too_short": "text that is not empty",
    "model_type": "a table",
    "model_attributes_type": "a table",
}
"""pydantic's error type -> what is expected, after "must be"."""

RENAMED_KEYS = {"foreign": "third_party", "control_way": "control_mode", "present_as": "translated_sysid"}
"""Keys of fleet files written for an earlier version: old -> new, wherever the new one is known."""

MAX_PROBLEM_CHARS = 2000
"""A problem repeats what the file has, which may be of any length."""

MAX_PROBLEMS = 100
"""Most wrong keys that are looked at: a file with more was not written as a fleet file. Each takes up to 7 ms, and
some MB of TOML have 300,000."""

MAX_LINK_CHARS, MAX_LINK_PROBLEMS = 32768, 20
"""Most characters and problems of a link added at run time: 1 MB of unknown keys held the loop for 15 s."""

MAX_NAME_BYTES, MAX_PATH_BYTES = 255, 4095
"""Linux' NAME_MAX, which all its file systems have, and PATH_MAX without the zero at its end: a longer one raises
ENAMETOOLONG wherever it is looked at."""

_BOUNDS = {
    "greater_than_equal": ("at least", "ge"),
    "greater_than": ("more than", "gt"),
    "less_than_equal": ("at most", "le"),
    "less_than": ("less than", "lt"),
}


def load_fleet(path: Path | str) -> FleetConfig:
    """The fleet file, checked as a whole, its relative paths resolved against its folder.

    Raises ConfigError with every problem there is (a TOML syntax error hides the others).
    """
    return load_fleet_and_dialect(path)[0]


def load_fleet_and_dialect(path: Path | str) -> tuple[FleetConfig, Dialect]:
    """The fleet file as `load_fleet`, and its dialect, which the check needs as well."""
    # read and parse
    path = Path(path)
    text = _read(path)
    table = _parse(path, text)
    lines = key_lines(text)
    # find the extensions of the tables, and validate
    owners, unusable = find_owners(set(table) - _CORE_TABLES)
    config, found, wrong = _validate({name: part for name, part in table.items() if name not in unusable}, owners)
    problems = [*(Problem((name,), text) for name, text in unusable.items()), *found]
    dialect: Dialect | None = None
    # rules between tables
    if config is not None:
        as_written = config
        for name, extension_table in as_written.extensions.items():
            problems += owners[name].problems(extension_table, as_written)
            config = owners[name].applied(extension_table, config)
        problems += conflicts(config, wrong)
        problems += _place_problems(config, owners)
        config, unplaced = _with_paths(config, path.parent.absolute())
        # the dialect, and rules that need it
        problems += unplaced
        problems += timing_problems(config.links)
        try:
            dialect = load_dialect(_listed(config.dialect))
        except DialectError as error:
            problems.append(Problem(("dialect",), str(error)))
        else:
            problems += dialect_problems(dialect)
            problems += islice(message_problems(config.links, dialect), MAX_PROBLEMS)
            problems += stream_problems(config, dialect)
    # report all problems together
    if problems or config is None or dialect is None:
        raise ConfigError(str(path), _shown(problems, lines))
    return config, dialect


@cache
def _link_adapter() -> TypeAdapter[LinkConfig]:
    """Validates links by `config.models.validated_link`; for the first of a type the loop waits 2 ms."""
    return TypeAdapter(AnyLink)


def parse_link(name: str, table: dict[str, Any], dialect: Dialect | None = None) -> LinkConfig:
    """One link as it would stand in [links.NAME], for links added at run time. Raises ConfigError as `load_fleet`."""
    text = _as_json({**table, "name": name})
    if len(text) > MAX_LINK_CHARS:
        raise ConfigError(f"link {name}", [f"a description of a link has at most {MAX_LINK_CHARS} characters"])
    whole = {"links": {name: table}}
    if problems := _nul_characters(whole):
        raise ConfigError(f"link {name}", _shown(problems, {}))
    try:
        link: LinkConfig = _link_adapter().validate_json(text, strict=True)
    except ValidationError as error:
        errors = error.errors(include_url=False)[:MAX_LINK_PROBLEMS]
        found = [{**e, "loc": ("links", name, *e["loc"])} for e in errors]
        raise ConfigError(f"link {name}", _shown(_translated(found, whole), {})) from None  # type: ignore[arg-type]
    problems = timing_problems({name: link})
    if dialect is not None:
        problems += islice(message_problems({name: link}, dialect), MAX_LINK_PROBLEMS)
    if problems:
        raise ConfigError(f"link {name}", _shown(problems, {}))
    return link


def _listed(dialect: str | tuple[str, ...]) -> list[str]:
    return [dialect] if isinstance(dialect, str) else list(dialect)


def _read(path: Path) -> str:
    try:
        return read_named(path).decode("utf-8-sig")
    except FileNotFoundError:
        raise ConfigError(str(path), ["no such file"]) from None
    except IsADirectoryError:
        raise ConfigError(str(path), ["is a folder, not a fleet file"]) from None
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [f"is not UTF-8 text (byte {error.start})"]) from None


def _parse(path: Path, text: str) -> dict[str, Any]:
    try:
        return parse_toml(text)
    except tomllib.TOMLDecodeError as error:
        what, _, where = str(error).partition(" (at ")
        where = where.rstrip(")")
        if where == "end of document":
            where = f"line {max(len(text.splitlines()), 1)}, the end of the file"
        raise ConfigError(str(path), [f"{where}: not TOML: {what}"]) from None
    except ValueError as error:
        raise ConfigError(str(path), [f"not a fleet file: {str(error).partition(';')[0].lower()}"]) from None


def _as_json(table: dict[str, Any]) -> str:
    """Encode as JSON: only there pydantic's strict mode distinguishes "57600" from 57600 and still makes paths of
    text."""
    return json.dumps(table, default=str)


def _validate(
    table: dict[str, Any], owners: Mapping[str, type[TableOwner]]
) -> tuple[FleetConfig | None, list[Problem], set[KeyPath]]:
    """(config, problems, key paths that were wrong). After problems the config is what remains without the wrong keys,
    so that they do not hide the conflicts among the right ones; None if nothing usable remains."""
    # remove keys that no model can take
    rest = copy.deepcopy(table)
    problems: list[Problem] = _named_links(rest) + _nul_characters(rest)
    for name in NO_TABLES & rest.keys():
        del rest[name]
        hint = "; an extension's table has the extension's name" if name == "extensions" else ""
        problems.append(Problem((name,), f"unknown key{hint}"))
    rest = _without_nul(rest)
    wrong: set[KeyPath] = {p.path for p in problems}
    # validate; where keys are wrong, remove them and look for further problems
    for attempt in range(8):
        # tables of the extensions
        errors: list[ErrorDetails] = []
        config: FleetConfig | None = None
        extensions: dict[str, Any] = {}
        for name in owners.keys() & rest.keys():
            try:
                extensions[name] = owners[name].Config.model_validate_json(_as_json(rest[name]), strict=True)
            except ValidationError as error:
                errors += [{**e, "loc": (name, *e["loc"])} for e in error.errors(include_url=False)]
        # the core's table
        try:
            core = {name: part for name, part in rest.items() if name not in owners}
            config = FleetConfig.model_validate_json(_as_json(core), strict=True)
        except ValidationError as error:
            errors += error.errors(include_url=False)
        if config is not None and not errors:
            return config.model_copy(update={"extensions": extensions}), problems, wrong
        # report each key once, and remove it for the next attempt
        found = _translated(errors[:MAX_PROBLEMS], rest, owners)
        problems += [p for p in found if attempt == 0 or not (p.missing or _mentions(p, wrong))]
        if len(errors) > MAX_PROBLEMS:
            problems.append(Problem((), f"has more problems than these: {len(errors)} were found"))
            break
        for problem in found:
            wrong.add(problem.path)
            _remove(rest, problem.path[:-1] if problem.missing else problem.path)
    return None, problems, wrong


def _place_problems(config: FleetConfig, owners: Mapping[str, type[TableOwner]]) -> list[Problem]:
    """Values of `ControlSettings.at` that no extension of this file knows: the others are asked only then."""
    own = {owner.control_at: name for name, owner in owners.items() if owner.control_at is not None}
    return control_place_problems(config, own) and control_place_problems(config, places_of_control())


def _mentions(problem: Problem, wrong: set[KeyPath]) -> bool:
    """True if a problem is only there because a wrong key was taken away."""
    return any(_key_text(path) in problem.text for path in wrong if path)


def _nul_characters(table: Any, path: KeyPath = ()) -> list[Problem]:
    """Texts with a NUL in them: no path, host or name has one, and the system takes none."""
    if isinstance(table, str):
        return [Problem(path, "holds a NUL character")] if "\0" in table else []
    items = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    return [problem for key, value in items for problem in _nul_characters(value, (*path, key))]


def _without_nul(value: Any) -> Any:
    """The same with a question mark for each NUL, so that all else can be checked."""
    if isinstance(value, str):
        return value.replace("\0", "?")
    if isinstance(value, dict):
        return {key: _without_nul(item) for key, item in value.items()}
    return [_without_nul(item) for item in value] if isinstance(value, list) else value


def _named_links(table: dict[str, Any]) -> list[Problem]:
    """A link's name is its table's name; a key "name" would be overwritten without a word."""
    links = table.get("links")
    named = [k for k, v in links.items() if isinstance(v, dict) and "name" in v] if isinstance(links, dict) else []
    for link in named:
        del table["links"][link]["name"]
    return [Problem(("links", link, "name"), "a link's name is the name of its table") for link in named]


def _remove(table: dict[str, Any], path: KeyPath) -> None:
    node: Any = table
    for part in path[:-1]:
        if isinstance(part, int):
            break
        node = node.get(part) if isinstance(node, dict) else None
    key = next((p for p in path if isinstance(p, int)), None)
    if key is not None:  # a wrong item of a list: without the whole list nothing is claimed about its rest
        _remove(table, path[: path.index(key)])
    elif isinstance(node, dict):
        node.pop(path[-1] if path else "", None)


def _translated(
    errors: Iterable[ErrorDetails], table: dict[str, Any], owners: Mapping[str, type[TableOwner]] | None = None
) -> list[Problem]:
    """pydantic's errors in a person's words, one problem per key."""
    expected: dict[KeyPath, list[str]] = {}
    given: dict[KeyPath, Any] = {}
    problems: list[Problem] = []
    for error in errors:
        path = _key_path(error, table)
        kind = error["type"]
        if (wanted := _wanted(error)) is not None:
            expected.setdefault(path, []).append(wanted)
            given[path] = error["input"]
        elif kind == "extra_forbidden":
            problems.append(Problem(path, _unknown_key(path, table, owners or {})))
        elif kind == "missing":
            problems.append(Problem(path, "is missing", missing=True))
        elif kind == "value_error":
            text = error["msg"].removeprefix("Value error, ")
            named = re.match(r"([a-z_]+(?:\.[a-z_]+)*) ", text) if not path else None
            if named:  # a check of several keys names the one it is about
                problems.append(Problem(tuple(named.group(1).split(".")), text[named.end() :]))
            else:
                problems.append(Problem(path, text))
        else:
            problems.append(Problem(path, _link_type_problem(error) or error["msg"]))
    deepest = set(expected) | {p.path for p in problems}
    for path, wanted_list in expected.items():
        if any(len(other) > len(path) and other[: len(path)] == path for other in deepest):
            continue  # the other branch of a union has the more exact error
        if any(p.path == path for p in problems):
            continue
        wanted = " or ".join(dict.fromkeys(wanted_list))
        hint = _did_you_mean(str(given[path]), wanted.removeprefix("one of ").split(", ")) if "one of" in wanted else ""
        problems.append(Problem(path, f"must be {wanted}, not {_quoted(given[path])}{hint}"))
    return problems


def _wanted(error: ErrorDetails) -> str | None:
    kind = error["type"]
    if kind in _EXPECTED:
        return _EXPECTED[kind]
    if kind in _BOUNDS:
        words, key = _BOUNDS[kind]
        return f"{words} {error['ctx'][key]:.10g}"
    if kind == "literal_error":
        expected = error["ctx"]["expected"]
        allowed = re.findall(r"'([^']*)'", expected) or re.findall(r"-?\d+", expected)
        return "one of " + ", ".join(allowed)
    return None


def _link_type_problem(error: ErrorDetails) -> str | None:
    known = ", ".join(LINK_TYPES)
    if error["type"] == "union_tag_not_found":
        return f"has no type; it must be one of {known}"
    if error["type"] == "union_tag_invalid":
        tag = str(error["ctx"]["tag"])
        return f"type must be one of {known}, not {_quoted(tag)}" + _did_you_mean(tag, LINK_TYPES)
    return None


def _key_path(error: ErrorDetails, table: dict[str, Any]) -> KeyPath:
    """The key in the file. pydantic's own marks in the location (union branches, type tags) are no keys."""
    node: Any = table
    path: list[str | int] = []
    for position, part in enumerate(error["loc"]):
        last = position == len(error["loc"]) - 1
        inside = isinstance(node, dict) and part in node
        if inside or (isinstance(node, list) and isinstance(part, int) and part < len(node)):
            path.append(part)
            node = node[part]
        elif last and error["type"] == "missing":
            path.append(part)
    return tuple(path)


def _unknown_key(path: KeyPath, table: dict[str, Any], owners: Mapping[str, type[TableOwner]]) -> str:
    owner = owners.get(str(path[0]))
    root, inner = (FleetConfig, path[:-1]) if owner is None else (owner.Config, path[1:-1])
    model = model_at(root, inner, table if owner is None else table[str(path[0])])
    known = [k for k in model.model_fields if not (issubclass(model, LinkCommon) and k == "name")] if model else []
    if model is FleetConfig:
        known = [k for k in known if k not in NO_TABLES] + list(installed())
    if (new := RENAMED_KEYS.get(str(path[-1]))) in known:
        return f"is called {new} now: rename the key"
    hint = _did_you_mean(str(path[-1]), known)
    return "unknown key" + (hint or (f"; known here: {', '.join(known)}" if known else ""))


def _did_you_mean(word: str, known: Iterable[str]) -> str:
    """'; did you mean X?' if one is near; mavlink-router's AllowMsgIdIn is near allow_msg_id_in."""
    plain = {re.sub("[^a-z0-9]", "", k.lower()): k for k in known}
    near = near_names(re.sub("[^a-z0-9]", "", word.lower()), plain, n=1, cutoff=0.6)
    return f"; did you mean {plain[near[0]]}?" if near else ""


def _quoted(value: Any) -> str:
    text = json.dumps(value, default=str, ensure_ascii=False)
    return text if len(text) <= 40 else text[:37] + "..."


def _with_paths(config: FleetConfig, folder: Path) -> tuple[FleetConfig, list[Problem]]:
    """Every path absolute: relative ones begin at the fleet file's folder, ~ is the user's home; and those of which
    nobody can say where they lead."""
    problems: list[Problem] = []

    def absolute(value: Path, key: KeyPath) -> Path:
        try:
            found = Path(os.path.normpath(folder / value.expanduser()))
        except RuntimeError:
            problems.append(Problem(key, f"{_quoted(str(value))}: there is no user of this name, or no home of theirs"))
            return value
        if max(map(_bytes_of, found.parts)) > MAX_NAME_BYTES or _bytes_of(str(found)) > MAX_PATH_BYTES:
            problems.append(Problem(key, f"{_quoted(str(value))}: no file may have so long a name"))
        return found

    dialect = tuple(located(name, folder) for name in _listed(config.dialect))
    extensions = {name: with_absolute_paths(part, (name,), absolute) for name, part in config.extensions.items()}
    core = with_absolute_paths(config.model_copy(update={"extensions": {}}), (), absolute)
    return core.model_copy(update={"dialect": dialect, "extensions": extensions}), problems


def _bytes_of(text: str) -> int:
    return len(text.encode("utf-8", "surrogatepass"))


def _shown(problems: list[Problem], lines: dict[KeyPath, int]) -> list[str]:
    """One line of text per problem, in the order of the file."""
    placed = [(line_of(p.path, lines), p) for p in problems]
    placed.sort(key=lambda pair: pair[0] or 0)
    where = [_key_text(p.path) + (f" (line {line})" if line else "") for line, p in placed]
    return [f"{_cut(key)}: {_cut(p.text)}" for key, (_, p) in zip(where, placed, strict=True)]


def _cut(text: str) -> str:
    return text if len(text) <= MAX_PROBLEM_CHARS else text[:MAX_PROBLEM_CHARS] + "…"


def _key_text(path: KeyPath) -> str:
    """links.radio.allow_msg_id_in[2]"""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            bare = re.fullmatch(r"[A-Za-z0-9_-]+", part) is not None
            text += ("." if text else "") + (part if bare else json.dumps(part, ensure_ascii=False))
    return text or "file"
