"""Target expressions of orders: ``1``, ``1,3``, ``2-5``, ``alpha``, a group, ``all``, and lists of them.

A word is taken as a number or range of system ids first, then as ``all``, then as a vehicle's name, then as a group.
With a component id behind a slash (``7/191``, ``alpha/191``, ``all/100``) it means that component of each system.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence
from typing import Protocol, TypeVar

from skygcs.errors import TargetError
from skygcs.spelling import near_names

MAX_PARTS = 1000
"""Longer lists are refused; a fleet has at most 250 vehicles."""

MAX_CHARS = 32_768
"""Longer expressions are refused unread: the longest names of a whole fleet have 16,000 characters. To look at each
part of one of a megabyte takes the loop half a second, in which nothing is flown."""

MAX_PART_CHARS = 128
"""Longest part: a name, with a site before it and a component behind it."""

MAX_NAME_CHARS = 64
"""Longest name of a vehicle or group."""

_RANGE = re.compile(r"(\d{1,3})\s*-\s*(\d{1,3})")

_NOT_SHOWN = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode's categories of control and format characters, such as ESC and those that turn the direction of text. Those
without a character yet are not among them, since every version of Python knows others."""


class Targetable(Protocol):
    """A vehicle or component that a target can name."""

    @property
    def name(self) -> str: ...

    @property
    def sysid(self) -> int: ...

    @property
    def compid(self) -> int: ...

    @property
    def groups(self) -> tuple[str, ...]: ...


T = TypeVar("T", bound=Targetable)

FOR_COMPONENTS = "message watch, last, request and send, interval, stream and command"
"""The commands that accept a component as target, for the user."""


def name_problem(name: str) -> str | None:
    """Why this cannot be the name of a vehicle or group; None if it can. Names are targets: "1,3", "2-5" and "all" mean
    something else there; and they are shown on terminals, which obey control characters."""
    if not name.strip():
        return "is empty"
    if len(name) > MAX_NAME_CHARS:
        return f"has {len(name)} characters; a name has at most {MAX_NAME_CHARS}"
    if name.lower() == "all":
        return "means every vehicle"
    if name.isdecimal():
        return "looks like a system id"
    if bad := re.search(r"[,\-\s]", name):
        what = {",": "a comma separates targets", "-": "2-5 is a range of system ids"}
        return f"contains {bad.group()!r}: {what.get(bad.group(), 'a target has no blanks')}; use _ instead"
    if bad_char := next((char for char in name if unicodedata.category(char) in _NOT_SHOWN), None):
        return f"contains the control character {bad_char!a}"
    return None


def select(
    expression: str | int | Sequence[str | int], vehicles: Iterable[T], unheard: Iterable[Targetable] = ()
) -> list[T]:
    """The vehicles of an expression, each once, by system id. Raises TargetError with the unknown part and what exists.

    A range selects the vehicles in it that exist and fails only if none does. ``unheard``: vehicles that are expected
    and cannot be selected; who names one of them does not mean another.
    """
    known = sorted(vehicles, key=lambda v: (v.sysid, v.compid))
    parts = parts_of(expression)
    if not known:
        raise TargetError(f"{', '.join(parts)}: no vehicle has been heard yet")
    chosen: dict[int, T] = {}
    for part in parts:
        whose, compid = _split(part, known)
        found = [v for v in _named(whose, known) if compid in (None, v.compid)]
        if not found and compid is not None:
            raise TargetError(f"{part!r} is not a vehicle; components are targets of {FOR_COMPONENTS} only")
        if not found and (silent := _named(whose, list(unheard))):
            names = ", ".join(v.name for v in silent)
            since = "since skygcs began or since it was forgotten"
            raise TargetError(f"{part!r}: nothing was heard of {names} {since}, so no order reaches it")
        if not found:
            raise TargetError(f"no vehicle {part!r}; {_nearest(part, known)}there are: {_listing(known)}")
        chosen.update((v.sysid << 8 | v.compid, v) for v in found)
    return [chosen[key] for key in sorted(chosen)]


def select_any(
    expression: str | int | Sequence[str | int],
    vehicles: Iterable[T],
    components: Iterable[T],
    unheard: Iterable[Targetable] = (),
) -> list[T]:
    """`select` with components: a part with a component id may name one of ``components``, even without a vehicle.

    Raises TargetError.
    """
    known, others = sorted(vehicles, key=lambda v: (v.sysid, v.compid)), list(components)
    chosen: dict[int, T] = {}
    for part in parts_of(expression):
        whose, compid = _split(part, known)
        if compid is None:
            chosen.update((v.sysid << 8 | v.compid, v) for v in select(part, known, unheard))
            continue
        sysids = {v.sysid for v in _named(whose, known)}
        if whose.isascii() and whose.isdigit():
            sysids.add(int(whose))
        found = [v for v in (*known, *others) if v.sysid in sysids and v.compid == compid]
        if not found:
            heard = [f"{v.sysid}/{v.compid}" for v in (*known, *others) if v.sysid in sysids]
            there_is = f"; heard of it: {', '.join(heard[:20])}" if heard else ""
            raise TargetError(f"no component {part!r} was heard{there_is}")
        chosen.update((v.sysid << 8 | v.compid, v) for v in found)
    return [chosen[key] for key in sorted(chosen)]


def names_component(part: str, known: Iterable[Targetable]) -> bool:
    """True if a part of a target expression names a component ("7/191") and not whole vehicles."""
    return _split(part, list(known))[1] is not None


def _split(part: str, known: Sequence[Targetable]) -> tuple[str, int | None]:
    """(systems, component id) of a part; None if it names vehicles. A vehicle's or group's name may contain a slash."""
    whose, _, compid = part.rpartition("/")
    whose, compid = whose.rstrip(), compid.lstrip()
    if not (whose and 0 < len(compid) <= 3 and compid.isdecimal()):
        return part, None
    if any(part == v.name or part in v.groups for v in known):
        return part, None
    return whose, int(compid)


def size_problem(items: Sequence[object]) -> str | None:
    """Why so many targets, or such long ones, are not even looked at; None: they are."""
    if len(items) > MAX_PARTS:
        return f"{len(items)} targets in one order; at most {MAX_PARTS}"
    if any(isinstance(item, int) and not -MAX_CHARS < item < MAX_CHARS for item in items):
        return "a system id is a number from 1 to 255"  # one of 5,000 digits raises when it is shown
    if sum(len(item) for item in items if isinstance(item, str)) > MAX_CHARS:
        return f"the targets have more than {MAX_CHARS} characters; name groups, or give several orders"
    return None


def parts_of(expression: str | int | Sequence[str | int]) -> list[str]:
    """The parts of a target expression. Raises TargetError for none, too many, or one that is too long."""
    items: Sequence[str | int] = [expression] if isinstance(expression, str | int) else expression
    if (problem := size_problem(items)) is not None:
        raise TargetError(problem)
    parts = [part.strip() for item in items for part in str(item).split(",")]
    parts = [part for part in parts if part]
    if (long := next((part for part in parts if len(part) > MAX_PART_CHARS), None)) is not None:
        raise TargetError(f"the target {long[:40]!r}… has {len(long)} characters; a name has at most {MAX_NAME_CHARS}")
    if not parts:
        raise TargetError("no target given; give a system id, a name, a group, a range such as 2-5, a list, or all")
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


def _nearest(part: str, known: Sequence[Targetable]) -> str:
    """A question for the name or group that is spelled most like this part; empty if none is."""
    names = {name for v in known for name in (v.name, *v.groups)}
    found = near_names(part, sorted(names), n=1)
    return f"did you mean {found[0]!r}? " if found else ""


def absent_sysids(expression: str | int | Sequence[str | int], present: Iterable[int]) -> list[int]:
    """System ids that the ranges of an expression contain and no vehicle has, ascending: `select` leaves them out.
    ``present``: the ids of all vehicles. Raises TargetError."""
    ranges = [match for part in parts_of(expression) if (match := _RANGE.fullmatch(part)) is not None]
    return sorted({sysid for m in ranges for sysid in range(int(m[1]), int(m[2]) + 1)} - {*present})


def expression_of(sysids: Iterable[int]) -> str:
    """The shortest expression of these system ids: 4,6-9."""
    spans: list[list[int]] = []
    for sysid in sorted({*sysids}):
        if spans and sysid == spans[-1][1] + 1:
            spans[-1][1] = sysid
        else:
            spans.append([sysid, sysid])
    return ",".join(str(first) if first == last else f"{first}-{last}" for first, last in spans)


def _listing(known: Sequence[Targetable]) -> str:
    vehicles = ", ".join(str(v.sysid) if v.name == f"v{v.sysid}" else f"{v.sysid} ({v.name})" for v in known)
    groups = sorted({group for v in known for group in v.groups})
    return vehicles + (f"; groups: {', '.join(groups)}" if groups else "") + "; all"
