"""Types of the daemon's methods as the web page has them: src/skygcs/web/page/src/rpc_types.ts."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from skygcs.rpc import dispatch
from skygcs.rpc.dispatch import Method
from skygcs.web.daemon_connection import STATE_KEYS

SOURCES = Path(__file__).parents[2] / "src" / "skygcs" / "web" / "page" / "src"

TYPES = SOURCES / "rpc_types.ts"

ALSO = frozenset({"control.status", "plan.status"})
"""The page calls neither: their results come with a state and in web.plan."""

HEAD = """// Made of the daemon's methods by tests/unit/web/test_page_types.py: not to be edited by hand.

export type NoParams = Readonly<Record<string, never>>;

export type Targets = string | number | readonly (string | number)[];
"""


def used(methods: Iterable[Method[Any]]) -> list[Method[Any]]:
    """Methods that the page names."""
    text = "".join(path.read_text(encoding="utf-8") for path in SOURCES.rglob("*.ts*") if path != TYPES)
    named = ALSO | set(re.findall(r'"([a-z_]+\.[a-z_]+)"', text))
    return sorted((method for method in methods if method.name in named), key=lambda method: method.name)


def page_types(methods: Iterable[Method[Any]]) -> str:
    """The file: each schema as an interface, then the parameters and the result of each method that the page names."""
    document = dispatch.document(used(methods))
    schemas = document["components"]["schemas"]
    results, params = [], []
    for method in document["methods"]:
        name = json.dumps(method["name"])
        results.append(f"  {name}: {type_of(method['result']['schema'])};")
        fields = [field(p["name"], p["schema"], p["required"]) for p in method["params"]]
        params.append(f"  {name}: {{ {'; '.join(fields)} }};" if fields else f"  {name}: NoParams;")
    reached = _reached(_names(document["methods"]), schemas)
    state_keys = " | ".join(json.dumps(key) for key in ("name", "sysid", *STATE_KEYS))
    parts = [
        *(_interface(name, schemas[name]) for name in sorted(reached)),
        f"/** Keys of a state that web.state carries. */\nexport type StateKey = {state_keys};\n",
        "export interface Results {\n" + "\n".join(results) + "\n}\n",
        "export interface Params {\n" + "\n".join(params) + "\n}\n",
    ]
    targets = next(line.partition(" = ")[2] for line in HEAD.splitlines() if "type Targets" in line)
    return "\n".join([HEAD, *(part.replace(targets.removesuffix(";"), "Targets") for part in parts)])


def _names(part: Any) -> Iterator[str]:
    """Schemas that a part of the document refers to."""
    if isinstance(part, dict):
        if "$ref" in part:
            yield part["$ref"].rsplit("/", 1)[1]
        for inner in part.values():
            yield from _names(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from _names(inner)


def _reached(names: Iterable[str], schemas: dict[str, Any]) -> set[str]:
    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name in schemas and name not in found:
            found.add(name)
            waiting.extend(_names(schemas[name]))
    return found


def _interface(name: str, schema: dict[str, Any]) -> str:
    required = schema.get("required", ())
    lines = [f"  {field(key, inner, key in required)};" for key, inner in schema["properties"].items()]
    return f"export interface {name} {{\n" + "\n".join(lines) + "\n}\n"


def field(name: str, schema: Any, required: bool) -> str:
    """One member of an interface."""
    return f"{name}{'' if required else '?'}: {type_of(schema)}"


PLAIN = {"integer": "number", "number": "number", "string": "string", "boolean": "boolean", "null": "null"}


def type_of(schema: Any) -> str:
    """A JSON schema as a type."""
    if "$ref" in schema:
        return str(schema["$ref"].rsplit("/", 1)[1])
    if "anyOf" in schema:
        return " | ".join(dict.fromkeys(type_of(option) for option in schema["anyOf"]))
    if "enum" in schema or "const" in schema:
        return " | ".join(json.dumps(value) for value in schema.get("enum", [schema.get("const")]))
    match schema.get("type"):
        case "array":
            return _array(schema)
        case "object":
            inner = schema.get("additionalProperties")
            return f"Readonly<Record<string, {type_of(inner) if isinstance(inner, dict) else 'unknown'}>>"
        case kind:
            return PLAIN.get(kind, "unknown")


def _array(schema: dict[str, Any]) -> str:
    """A list; one of two to four members as a tuple."""
    least, most = schema.get("minItems"), schema.get("maxItems")
    if least == most and least in (2, 3, 4):
        members = schema.get("prefixItems") or [schema["items"]] * least
        return f"readonly [{', '.join(type_of(member) for member in members)}]"
    inner = type_of(schema.get("items", {}))
    return f"readonly ({inner})[]" if " " in inner else f"readonly {inner}[]"
