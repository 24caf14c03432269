"""A table of methods as an OpenRPC document: `rpc.discover` of the daemon and of the station socket."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import Any

from pydantic import TypeAdapter

from skygcs import __version__
from skygcs.rpc import error_codes
from skygcs.rpc.dispatch import Method

ERRORS: dict[int, str] = {
    error_codes.TARGET_ERROR: (
        "The targets name no vehicle; the text names the part that matches none, and the vehicles."
    ),
    error_codes.REFUSED: "skygcs refuses the order itself; the text says why.",
    error_codes.LINK_ERROR: "A link could not be opened, changed or sent on.",
    error_codes.NOT_AUTHENTICATED: "TCP only: the first request must be auth with the token.",
    error_codes.LIMIT_EXCEEDED: "A limit per client, or of all clients together, is reached; the text names it.",
}


_REF = "#/components/schemas/{model}"


def document(methods: Iterable[Method[Any]]) -> dict[str, Any]:
    """All of it, JSON-able; takes half a second for the methods of the daemon."""
    methods = list(methods)
    results = [(i, "serialization", TypeAdapter(method.result)) for i, method in enumerate(methods)]
    result_schemas, definitions = TypeAdapter.json_schemas(
        [(key, "serialization", adapter) for key, _, adapter in results], ref_template=_REF
    )
    components = dict(definitions.get("$defs", {}))
    described = []
    for i, method in enumerate(methods):
        params = method.params.model_json_schema(ref_template=_REF)
        components.update(params.get("$defs", {}))
        described.append(_method(method, params, result_schemas[i, "serialization"]))
    return {
        "openrpc": "1.3.2",
        "info": {
            "title": "skygcs",
            "version": __version__,
            "description": "JSON-RPC 2.0, one object a line, on a Unix socket (or TCP on loopback, after auth).",
        },
        "methods": described,
        "components": {"schemas": components},
    }


def _method(method: Method[Any], params: dict[str, Any], result: Any) -> dict[str, Any]:
    text = inspect.cleandoc(method.handler.__doc__ or "")
    required = set(params.get("required", ()))
    return {
        "name": method.name,
        "summary": text.split("\n", 1)[0],
        "description": text,
        "paramStructure": "either",
        "params": [
            {"name": name, "description": schema.get("description", ""), "required": name in required, "schema": schema}
            for name, schema in params.get("properties", {}).items()
        ],
        "result": {"name": "result", "schema": result},
        "errors": [{"code": code, "message": ERRORS[code]} for code in method.errors],
    }
