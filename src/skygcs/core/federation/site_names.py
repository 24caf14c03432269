"""Names and targets of several sites: `south/alpha`, `south/all`, `south/1-5`, `*/all`. Pure.

A part of a target expression is, in this order:

    *.../all, "all sites"   every vehicle of every site, the own one among them
    own-site/REST           REST at the own daemon
    known-site/REST         REST at that site: what `core.vehicle.targets` reads there (name, id, range, group, all)
    anything/NUMBER         a component of an own vehicle (7/191, alpha/191): goes to the daemon as it is
    unknown/REST            an error that names the known sites
    without a slash         an own vehicle, as ever

A vehicle of the own daemon that has a site's name keeps it; only its components must be named by its system id.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from skygcs.core.vehicle.targets import T, parts_of, select
from skygcs.errors import TargetError

SITE_NAME = re.compile(r"[a-z][a-z0-9-]{0,15}")

EVERY_SITE = "*/all"
ALL_SITES = "all sites"
"""The same, as a person says it."""

MAX_NAME_CHARS = 64
"""Of a vehicle's name on the bus."""

_COMPONENT_ID = re.compile(r"\d{1,3}")
_PLAIN = frozenset(b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-")


@dataclass(frozen=True, slots=True)
class SiteTargets:
    """A target expression by site. ``own``: parts for the own daemon, () if it names no own vehicle. ``others``: parts
    by site. ``every``: sites that come later are meant, too. ``changed``: the daemon would not read the expression as
    it is."""

    own: tuple[str, ...]
    others: Mapping[str, tuple[str, ...]]
    every: bool
    changed: bool


def split_by_site(
    expression: str | int | Sequence[str | int], own_site: str | None, sites: Collection[str]
) -> SiteTargets:
    """The parts of an expression by site; ``sites``: the others that are known. Raises TargetError."""
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
    """The vehicles that the parts name at a site. Raises TargetError; "all" of a site without vehicles is none."""
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


def subject_token(name: str) -> str:
    """A vehicle's name as one token of a subject; `name_of_token` reads it. Whatever has a meaning in subjects, or is
    no ASCII letter, number, "_" or "-", is "=" and two hexadecimal digits for each byte."""
    return "".join(chr(byte) if byte in _PLAIN else f"={byte:02X}" for byte in name.encode())


def name_of_token(token: str) -> str:
    """The inverse of `subject_token`. Raises ValueError for what it does not write."""
    first, *rest = token.split("=")
    try:
        name = (first.encode("ascii") + b"".join(bytes.fromhex(r[:2]) + r[2:].encode("ascii") for r in rest)).decode()
    except ValueError:  # also of what is no ASCII, and no UTF-8
        name = ""
    if not name or subject_token(name) != token:
        raise ValueError(f"{token[:40]!r} is no vehicle's name")
    return name
