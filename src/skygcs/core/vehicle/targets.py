"""Which vehicles an order is for: ``1``, ``1,3``, ``2-5``, ``alpha``, a group, ``all``, and mixtures of them.

A word is taken as a number or range of system ids first, then as ``all``, then as a vehicle's name, then as a group.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Protocol, TypeVar

from skygcs.errors import TargetError

MAX_PARTS = 1000
"""Longer lists are refused; a fleet has at most 250 vehicles."""

_RANGE = re.compile(r"(\d{1,3})\s*-\s*(\d{1,3})")


class Targetable(Protocol):
    """What a target can name."""

    @property
    def name(self) -> str: ...

    @property
    def sysid(self) -> int: ...

    @property
    def compid(self) -> int: ...

    @property
    def groups(self) -> tuple[str, ...]: ...


T = TypeVar("T", bound=Targetable)


def select(expression: str | int | Sequence[str | int], vehicles: Iterable[T]) -> list[T]:
    """The vehicles meant, each once, by system id. Raises TargetError naming the part that names none and what exists.

    A range takes those of it that exist and fails only if there is none.
    """
    known = sorted(vehicles, key=lambda v: (v.sysid, v.compid))
    parts = _parts(expression)
    if not known:
        raise TargetError(f"{', '.join(parts)}: no vehicle has been heard yet")
    chosen: dict[int, T] = {}
    for part in parts:
        found = _named(part, known)
        if not found:
            raise TargetError(f"no vehicle {part!r}; there are: {_listing(known)}")
        chosen.update((v.sysid << 8 | v.compid, v) for v in found)
    return [chosen[key] for key in sorted(chosen)]


def _parts(expression: str | int | Sequence[str | int]) -> list[str]:
    items: Sequence[str | int] = [expression] if isinstance(expression, str | int) else expression
    parts = [part.strip() for item in items for part in str(item).split(",")]
    parts = [part for part in parts if part]
    if not parts:
        raise TargetError("no target given; say a system id, a name, a group, a range such as 2-5, a list, or all")
    if len(parts) > MAX_PARTS:
        raise TargetError(f"{len(parts)} targets in one order; at most {MAX_PARTS}")
    return parts


def _named(part: str, known: list[T]) -> list[T]:
    if part.isascii() and part.isdigit():
        return [v for v in known if v.sysid == int(part)]
    if (match := _RANGE.fullmatch(part)) is not None:
        first, last = int(match[1]), int(match[2])
        if first > last:
            raise TargetError(f"range {part!r} runs backwards; did you mean {last}-{first}?")
        return [v for v in known if first <= v.sysid <= last]
    if part == "all":
        return known
    by_name = [v for v in known if v.name == part]
    return by_name or [v for v in known if part in v.groups]


def _listing(known: Sequence[Targetable]) -> str:
    vehicles = ", ".join(str(v.sysid) if v.name == f"v{v.sysid}" else f"{v.sysid} ({v.name})" for v in known)
    groups = sorted({group for v in known for group in v.groups})
    return vehicles + (f"; groups: {', '.join(groups)}" if groups else "") + "; all"
