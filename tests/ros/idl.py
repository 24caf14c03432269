"""ROS 2's types for Fast DDS, made from the same table as the topics: IDL, which fastddsgen compiles, and lines, of
which a program makes types when it runs (`every_topic_node.cpp`)."""

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


HEADER = (("client_guid", "uint64"), ("sequence_number", "int64"))
"""rmw_cyclonedds puts it before requests and responses."""


def lines(known: Interfaces, types: Iterable[str], services: Iterable[str]) -> list[str]:
    """Structs and their members for types, those that they need, and requests and responses of services."""
    done: dict[str, list[str]] = {}
    for type_ in types:
        _add_lines(known, type_, done)
    for service in services:
        for part in ("Request", "Response"):
            _add_lines(known, f"{service}_{part}", done)
            head = [f"member {name} {base} plain 0" for name, base in HEADER]
            struct, *members = done[f"{service}_{part}"]
            done[f"{service}_{part}"] = [struct, *head, *members]
    return [line for made in done.values() for line in made]


def _add_lines(known: Interfaces, type_: str, done: dict[str, list[str]]) -> None:
    if type_ in done:
        return
    made = [f"struct {cpp_type(type_)}"]
    for name, description in known.store.fielddefs[type_][1]:
        kind, what = description
        shape, count = "plain", 0
        if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            shape, count = ("array", what[1]) if kind == Nodetype.ARRAY else ("sequence", 0)
            kind, what = what[0]
        if kind == Nodetype.NAME:
            _add_lines(known, what, done)
        made.append(f"member {name} {cpp_type(what) if kind == Nodetype.NAME else what[0]} {shape} {count}")
    done[type_] = made


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
