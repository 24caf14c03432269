"""docs/reference/rpc.md says what the methods say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from skygcs.rpc import methods, sessions
from skygcs.rpc.methods import METHODS

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "rpc.md"


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


def reference() -> str:
    """The "Methods" part of the page, as it must be there: run this module to print it."""
    lines: list[str] = []
    for method in methods.document(METHODS.values())["methods"]:
        lines += [f"### {method['name']}", "", method["description"], ""]
        if method["params"]:
            lines += ["| parameter | type | default | |", "|---|---|---|---|"]
        for param in method["params"]:
            default = "required" if param["required"] else f"`{json.dumps(param['schema'].get('default', []))}`"
            lines.append(f"| {param['name']} | {kind(param['schema'])} | {default} | {description(param)} |")
        if method["params"]:
            lines.append("")
    return "\n".join(lines)


def test_every_method_and_parameter_is_described_as_it_is() -> None:
    assert reference() in PAGE.read_text(encoding="utf-8")


def test_the_limits_are_those_of_the_server() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for row in (
        f"| a line | {sessions.MAX_LINE_BYTES >> 20} MiB |",
        f"| requests in a batch | {sessions.MAX_BATCH} |",
        f"| clients | {sessions.MAX_SESSIONS} |",
        f"| connections beyond | {sessions.MAX_RESERVE} |",
        f"| TCP clients before authentication | {sessions.MAX_UNAUTHENTICATED} |",
        f"| pending requests of one client | {sessions.MAX_IN_FLIGHT} |",
        f"| subscriptions of one client | {sessions.MAX_SUBSCRIPTIONS} |",
        f"| unread output of one client | {sessions.MAX_OUTPUT_BYTES >> 20} MiB |",
    ):
        assert row in text


def test_every_error_code_is_explained() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for code in (-32700, -32600, -32601, -32602, -32603, *methods.ERRORS):
        assert f"| {code} |" in text


if __name__ == "__main__":
    print(reference())
