"""Differences of ROS 1: names of types, MD5 sums of services, messages that are called or built otherwise.

ROS 2                        ROS 1
-------------------------    -------------------------------------------------------------
mavros_msgs/msg/VfrHud       mavros_msgs/VFR_HUD
rcl_interfaces/msg/Log       rosgraph_msgs/Log, with a header and levels that are bits
std_msgs/msg/Header          has seq, a number that counts
a message without fields     no byte
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

from skygcs.core.ros.interfaces import EMPTY_MEMBER, InterfaceError, Interfaces

LOG, LOG_1 = "rcl_interfaces/msg/Log", "rosgraph_msgs/msg/Log"

RENAMED = {"mavros_msgs/msg/VfrHud": "mavros_msgs/VFR_HUD"}
"""Names that MAVROS 1 writes in another way; an MD5 sum has no names."""

LOG_BITS = {10: 1, 20: 2, 30: 4, 40: 8, 50: 16}
"""rosgraph_msgs' level of each level of rcl_interfaces."""

RULE = "=" * 80
"""Between the definitions in the text of a type."""


def ros1_type(type_: str) -> str:
    """The type that ROS 1 has in place of this one."""
    return LOG_1 if type_ == LOG else type_


def ros1_name(type_: str) -> str:
    """A type's name on the wire: "geometry_msgs/PoseStamped"."""
    package, _, name = type_.split("/")
    return RENAMED.get(type_, f"{package}/{name}")


def service_parts(service: str) -> tuple[str, str]:
    """Types of a service's request and its response."""
    return f"{service}_Request", f"{service}_Response"


def service_md5(known: Interfaces, service: str) -> str:
    """MD5 sum of a service, as genmsg computes it."""
    return hashlib.md5("".join(_md5_text(known, part) for part in service_parts(service)).encode()).hexdigest()


def _md5_text(known: Interfaces, type_: str) -> str:
    """The text of which a type's sum is made: in place of other types their sums."""
    text, _ = known.ros1_definition(type_)
    lines = []
    for line in text.partition(RULE)[0].splitlines():
        kind, _, rest = line.partition(" ")
        package, _, name = kind.partition("[")[0].partition("/")
        lines.append(f"{known.ros1_definition(f'{package}/msg/{name}')[1] if name else kind} {rest}")
    return "\n".join(lines)


def encode(known: Interfaces, type_: str, fields: Mapping[str, Any], seq: int = 0) -> bytes:
    """Bytes of a message that has the fields of ROS 2. ``seq``: of its header. Raises InterfaceError."""
    if type_ == LOG:
        type_, fields = LOG_1, _log(fields)
    names = known.fields_of(type_)
    if names == (EMPTY_MEMBER,):
        return b""
    if "header" in names:
        fields = {**fields, "header": {**(fields.get("header") or {}), "seq": seq & 0xFFFFFFFF}}
    return known.encode(type_, fields)


def decode(known: Interfaces, type_: str, data: bytes) -> dict[str, Any]:
    """Fields of bytes that came. Raises InterfaceError."""
    if known.fields_of(type_) == (EMPTY_MEMBER,):
        if data:
            raise InterfaceError(f"{type_}: {len(data)} bytes for a message without fields")
        return {}
    return known.decode(type_, data)


def _log(fields: Mapping[str, Any]) -> dict[str, Any]:
    kept = {name: fields[name] for name in ("name", "msg", "file", "function", "line") if name in fields}
    return {"header": {"stamp": fields["stamp"]}, "level": LOG_BITS.get(fields["level"], 2), **kept}
