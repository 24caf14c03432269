"""Methods as docs/reference/rpc.md describes them."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from typing import Any

from skygcs.rpc import dispatch
from skygcs.rpc.dispatch import Method

TARGETS = ["string", "integer", "(string or integer)[]"]
"""The type that the page calls `targets`."""


def kind(schema: dict[str, Any]) -> str:
    """A parameter's JSON type, or the values that it may have."""
    *others, last = dict.fromkeys(choices(schema))
    if [*others, last][: len(TARGETS)] == TARGETS:
        *others, last = ["targets", *[*others, last][len(TARGETS) :]]
    between = ", or " if any(" or " in choice for choice in (*others, last)) else " or "
    return f"{', '.join(others)}{between}{last}" if others else last


def choices(schema: dict[str, Any]) -> list[str]:
    """Types and values of which a parameter may have any."""
    if "anyOf" in schema:
        return [choice for option in schema["anyOf"] for choice in choices(option)]
    if "$ref" in schema:
        return ["object"]
    if "enum" in schema:
        return [f'"{value}"' for value in schema["enum"]]
    if schema.get("type") == "array":
        return [list_of(kind(schema["items"])) if "items" in schema else "array"]
    return [str(schema.get("type", "any"))]


def list_of(items: str) -> str:
    """A list: `number[]`, `("a" or "b")[]`."""
    return f"({items})[]" if " " in items else f"{items}[]"


def description(param: dict[str, Any]) -> str:
    text = param["description"]
    for option in param["schema"].get("anyOf", ()):
        text = text or option.get("description", "")
    return str(text)


SHARED_BY = 5
"""A parameter that so many methods describe equally is described once, before the methods."""


def described(param: dict[str, Any]) -> tuple[str, str, str]:
    """Name, type and description of a parameter; equal ones are described once."""
    return param["name"], kind(param["schema"]), description(param)


def shared(methods: Iterable[Method[Any]]) -> dict[tuple[str, str, str], str]:
    """Each parameter that many methods have -> its line."""
    found = Counter(described(param) for method in dispatch.document(methods)["methods"] for param in method["params"])
    whole = {"targets": "string, integer or (string or integer)[]"}
    return {
        (name, type_name, text): line((name, whole.get(type_name, type_name), text))
        for (name, type_name, text), uses in found.items()
        if uses >= SHARED_BY
    }


def line(param: tuple[str, str, str], default: str | None = None) -> str:
    """A type that ends in ``?`` may be null, which is the default, too. A boolean that is false has no type."""
    name, type_name, text = param
    if type_name == "boolean" and default is None:
        return f"- `{name}`: {text}"
    if default is None and type_name.endswith(NULL):
        type_name = f"{type_name.removesuffix(NULL).removesuffix(',')}?"
    given = f"{type_name}, {default}" if default else type_name
    return f"- `{name}` ({given}): {text}".removesuffix(": ")


NULL = " or null"

INTERNAL = ("authority.", "clock.", "companion.", "ros.report", "ros.settings")
"""Methods between processes of skygcs: rpc.discover has them, the page does not."""


def unless_given(param: dict[str, Any]) -> str | None:
    """The value of a parameter that is left out; "" if it is required, which a boolean says; None if it is null or
    false: the page states these once."""
    types = choices(param["schema"])
    if param["required"]:
        return "required" if types == ["boolean"] else ""
    value = param["schema"].get("default", {} if types == ["object"] else [])
    if (value is None and "null" in types) or (value is False and types == ["boolean"]):
        return None
    return f"`{json.dumps(value)}`"


def reference(methods: Iterable[Method[Any]]) -> str:
    """A part of the page, as it must be there: a parameter as of an earlier method, with its default, has no line."""
    methods = list(methods)
    known = shared(methods)
    first: dict[tuple[tuple[str, str, str], str | None], str] = {}
    lines: list[str] = []
    for method in dispatch.document(methods)["methods"]:
        if method["name"].startswith(INTERNAL):
            continue
        lines += [f"### {method['name']}", "", method["description"], ""]
        same: dict[str, list[str]] = {}  # parameters of the line that comes first, by the method that describes them
        described_here: list[str] = []
        for param in method["params"]:
            default = unless_given(param)
            what = described(param)
            origin = first.setdefault((what, default), method["name"])
            if what in known:
                same.setdefault("", []).append(f"`{param['name']}`" + (f" ({default})" if default else ""))
            elif origin == method["name"]:
                described_here.append(line(what, default))
            else:
                same.setdefault(f" as {origin}", []).append(f"`{param['name']}`")
        if same:
            lines.append("- " + "; ".join(", ".join(names) + origin for origin, names in same.items()))
        lines += described_here
        if method["params"]:
            lines.append("")
    return "\n".join(lines)
