"""Names and targets of several sites: `south/alpha`, `south/all`, `south/1-5`, `*/all`. Pure.

A part of a target expression is, in this order:

    */all, "all sites"      every vehicle of every site, own vehicles included
    own-site/REST           REST at the own daemon
    known-site/REST         REST at that site: what `core.vehicle.targets` reads there (name, id, range, group, all)
    anything/NUMBER         a component of an own vehicle (7/191, alpha/191): passed to the daemon unchanged
    unknown/REST            an error that names the known sites
    without a slash         an own vehicle

An own vehicle may have the name of a site; its components are then named by its system id only (7/191).
"""

from __future__ import annotations

import functools
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from skygcs.core.vehicle.targets import T, name_problem, parts_of, select
from skygcs.errors import TargetError

SITE_NAME = re.compile(r"[a-z][a-z0-9-]{0,15}")

EVERY_SITE = "*/all"
ALL_SITES = "all sites"
"""The same in words."""

MAX_NAME_CHARS = 64
"""Longest name of a vehicle, group, or station in messages of the hub."""

_APPENDED_COMPID = re.compile(r"-[0-9]{1,3}\Z")
_COMPONENT_ID = re.compile(r"\d{1,3}")
_PLAIN = frozenset(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-")


@dataclass(frozen=True, slots=True)
class SiteTargets:
    """A target expression split by site. ``own``: parts for the own daemon, () if it names no own vehicle. ``others``:
    parts by site. ``every``: True if it includes sites that are heard later. ``changed``: True if the daemon cannot
    read the expression unchanged."""

    own: tuple[str, ...]
    others: Mapping[str, tuple[str, ...]]
    every: bool
    changed: bool


def split_by_site(
    expression: str | int | Sequence[str | int], own_site: str | None, sites: Collection[str]
) -> SiteTargets:
    """Split an expression by site. ``own_site``: None for a station that is no site. ``sites``: the other known sites.
    Raises TargetError."""
    own: dict[str, None] = {}
    others: dict[str, dict[str, None]] = {}
    every = changed = False
    for part in parts_of(expression):
        site, slash, rest = part.partition("/")
        if part in (EVERY_SITE, ALL_SITES):
            every = changed = True
            own["all"] = None
            for name in sites:
                others.setdefault(name, {})["all"] = None
        elif site == "*":
            raise TargetError(f"{part!r}: only {EVERY_SITE} names every site")
        elif slash and site == own_site:
            changed = True
            own[_required(part, rest)] = None
        elif slash and site in sites:
            changed = True
            others.setdefault(site, {})[_required(part, rest)] = None
        elif slash and SITE_NAME.fullmatch(site) and not _COMPONENT_ID.fullmatch(rest):
            known = ", ".join(sorted({*sites, *([own_site] if own_site else [])})) or "none yet"
            raise TargetError(f"{part!r}: no site {site!r} has been heard; there are: {known}")
        else:
            own[part] = None
    return SiteTargets(tuple(own), {site: tuple(parts) for site, parts in others.items()}, every, changed)


def _required(part: str, rest: str) -> str:
    if not rest.strip():
        raise TargetError(f"{part!r} names no vehicle; all vehicles of a site: {part.rstrip('/')}/all")
    return rest.strip()


def select_at(site: str, parts: Sequence[str], vehicles: Iterable[T]) -> list[T]:
    """The vehicles that the parts name at a site; [] for "all" of a site without vehicles. Raises TargetError."""
    known = list(vehicles)
    if tuple(parts) == ("all",):
        return sorted(known, key=lambda v: (v.sysid, v.compid))
    try:
        return select(list(parts), known)
    except TargetError as error:
        raise TargetError(f"{site}: {error}") from None


def qualified(site: str, vehicle: str) -> str:
    """The name of another site's vehicle: ``south/alpha``."""
    return f"{site}/{vehicle}"


@functools.lru_cache(maxsize=4096)
def is_vehicle_name(name: str) -> bool:
    """True for a name that a vehicle may have in messages of the hub: one that a fleet file may give it, of at most
    MAX_NAME_CHARS, without the slash behind a site's name. A daemon appends the component id to the name of a system's
    second autopilot (alpha-2)."""
    given = _APPENDED_COMPID.sub("", name)
    return len(name) <= MAX_NAME_CHARS and "/" not in name and name_problem(given) is None


def subject_token(name: str) -> str:
    """A vehicle's name as one token of a subject; `name_of_token` is the inverse. Each byte that is no ASCII letter,
    digit, "_" or "-" is written as "=" and two hexadecimal digits."""
    return "".join(chr(byte) if byte in _PLAIN else f"={byte:02X}" for byte in name.encode())


def name_of_token(token: str) -> str:
    """The inverse of `subject_token`. Raises ValueError for a token that it does not make."""
    first, *rest = token.split("=")
    try:
        name = (first.encode("ascii") + b"".join(bytes.fromhex(r[:2]) + r[2:].encode("ascii") for r in rest)).decode()
    except ValueError:  # also for text that is no ASCII or no UTF-8
        name = ""
    if not name or subject_token(name) != token:
        raise ValueError(f"{token[:40]!r} is not a vehicle's name")
    return name
