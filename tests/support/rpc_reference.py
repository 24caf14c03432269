"""Methods as docs/reference/rpc.md describes them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

from skygcs.rpc import openrpc
from skygcs.rpc.dispatch import Method


def kind(schema: dict[str, Any]) -> str:
    """A short word for a parameter's JSON type."""
    if "anyOf" in schema:
        return " or ".join(dict.fromkeys(kind(option) for option in schema["anyOf"]))
    if "$ref" in schema:
        return "object"
    if "enum" in schema:
        return " or ".join(f'"{value}"' for value in schema["enum"])
    if schema.get("type") == "array":
        return f"array of {kind(schema['items'])}" if "items" in schema else "array"
    return str(schema.get("type", "any"))


def description(param: dict[str, Any]) -> str:
    text = param["description"]
    for option in param["schema"].get("anyOf", ()):
        text = text or option.get("description", "")
    return str(text)


def reference(methods: Iterable[Method[Any]]) -> str:
    """A part of the page, as it must be there."""
    lines: list[str] = []
    for method in openrpc.document(methods)["methods"]:
        lines += [f"### {method['name']}", "", method["description"], ""]
        if method["params"]:
            lines += ["| parameter | type | default | |", "|---|---|---|---|"]
        for param in method["params"]:
            default = "required" if param["required"] else f"`{json.dumps(param['schema'].get('default', []))}`"
            lines.append(f"| {param['name']} | {kind(param['schema'])} | {default} | {description(param)} |")
        if method["params"]:
            lines.append("")
    return "\n".join(lines)
