"""IDL of ROS 2's types, made from the same table as the topics: what fastddsgen compiles for Fast DDS."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from rosbags.interfaces import Nodetype

from skygcs.core.ros.interfaces import Interfaces

BASES = {
    **{f"uint{bits}": f"uint{bits}" for bits in (8, 16, 32, 64)},
    **{f"int{bits}": f"int{bits}" for bits in (8, 16, 32, 64)},
    **{
        "bool": "boolean",
        "float32": "float",
        "float64": "double",
        "string": "string",
        "char": "uint8",
        "byte": "octet",
    },
}


def idl(known: Interfaces, types: Iterable[str], services: Iterable[str]) -> str:
    """One text for the types, those that they need, and requests and responses of services with rmw_cyclonedds' header
    in front."""
    done: dict[str, str] = {}
    for type_ in types:
        _add(known, type_, done, "")
    header = "    uint64 client_guid;\n    int64 sequence_number;\n"
    for service in services:
        for part in ("Request", "Response"):
            _add(known, f"{service}_{part}", done, header)
    return "\n".join(done.values())


def cpp_type(type_: str) -> str:
    """The name of a type in the generated C++."""
    package, kind, name = type_.split("/")
    return f"{package}::{kind}::dds_::{name}_"


def _add(known: Interfaces, type_: str, done: dict[str, str], header: str) -> None:
    if type_ in done:
        return
    members = []
    for name, description in known.store.fielddefs[type_][1]:
        kind, count = _type_of(known, description, done)
        members.append(f"    {kind} {name}{count};\n")
    package, folder, base = type_.split("/")
    body = "".join(members)
    done[type_] = (
        f"module {package} {{ module {folder} {{ module dds_ {{\n  struct {base}_ {{\n{header}{body}  }};\n}}; }}; }};"
    )


def _type_of(known: Interfaces, description: Any, done: dict[str, str]) -> tuple[str, str]:
    kind, what = description
    if kind == Nodetype.BASE:
        return BASES[what[0]], ""
    if kind == Nodetype.NAME:
        _add(known, what, done, "")
        return cpp_type(what), ""
    inner, count = what
    name, _ = _type_of(known, inner, done)
    return (name, f"[{count}]") if kind == Nodetype.ARRAY else (f"sequence<{name}>", "")
