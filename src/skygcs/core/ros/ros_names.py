"""Names of vehicles in ROS: letters, digits and underscores, a letter first in each part (REP 144, topic names)."""

from __future__ import annotations

import re

ROOT_FIELDS = "{name} or {sysid}"

_ROOT = re.compile(r"(/[A-Za-z][A-Za-z0-9_]*)+")


def ros_name(name: str) -> str:
    """A vehicle's name as a part of a ROS name."""
    plain = re.sub(r"_{2,}", "_", re.sub(r"[^A-Za-z0-9_]", "_", name)).strip("_") or "v"
    return plain if plain[0].isalpha() else f"v{plain}"


def vehicle_root(pattern: str, name: str, sysid: int) -> str:
    """The namespace of a vehicle: "/{name}" is /alpha, "/uav_{sysid}" is /uav_7. Raises ValueError for one that ROS
    does not take."""
    try:
        root = pattern.format(name=ros_name(name), sysid=sysid)
    except (KeyError, IndexError, ValueError, AttributeError):
        raise ValueError(f"{pattern!r}: only {ROOT_FIELDS} stand for something") from None
    if _ROOT.fullmatch(root) is None:
        raise ValueError(f"{pattern!r}: a name in ROS begins with / and has letters, digits, underscores and /")
    return root
