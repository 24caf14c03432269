"""Digests of vehicles that a page does not show in full: a digest of each, and counts of each site.
Pure.

Up to `LARGE_FLEET` vehicles a page gets every state as the daemon encoded it, and nothing here is used. Beyond, each
state is read as it comes (13 us, measured), and a page gets three levels of detail:

    sites      counts: vehicles, heard, armed, in the air, with a problem, and the oldest age
    brief      of every vehicle, once a second: who it is, where, and whether all is well (`Digest.row`)
    full       the state, of those that its `View` asks for; `MAX_FULL` at most
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic_core import from_json

from skygcs.errors import RpcError
from skygcs.rpc.error_codes import INVALID_PARAMS
from skygcs.rpc.replies import encode
from skygcs.spelling import is_number

LARGE_FLEET = 200
"""More vehicles are shown by site, and in full only where a person looks."""

SMALL_AGAIN = 180
"""So that a vehicle that comes and goes does not change the whole page."""

MAX_FULL = 250
"""States in full for one page: a screen shows 40 rows, and a view 150 vehicles before it draws dots."""

MAX_NAMES, MAX_SITES, MAX_SEARCH_CHARS = 300, 64, 200
"""Bounds of a `View`: one message may make the process keep no more."""

MAX_NAME_CHARS = 64

VEHICLE_SILENT_S = 5.0
"""A vehicle of which nothing came for so long is not heard: the page's own limit (store.ts)."""

EMPTY_BATTERY_PERCENT = 10.0
"""A problem; the page's own limit (trouble.ts)."""

IN_AIR = frozenset({"in_air", "takeoff", "landing"})


@dataclass(frozen=True, slots=True)
class Digest:
    """Digest of one state. Ages are those at ``at``."""

    name: str
    site: str
    """"" of a vehicle of ours."""
    order: tuple[str, int, int, str]
    """Vehicles are listed by it: site, system id, component, name."""
    words: str
    """Text that a search looks into, in small letters: name, id, mode, autopilot, groups."""
    states: tuple[str, ...]
    """Words of its state, in small letters; a search finds them by their beginnings."""
    armed: bool
    in_air: bool
    problem: bool
    """Apart from not being heard, which depends on the time."""
    connected: bool
    silence_s: float | None
    """None: never heard."""
    at: float
    row: bytes
    """JSON that a page reads: name, sysid, autopilot, armed, landed, failsafe, connected, silence_s, x, y, z in the
    fleet's frame, yaw there in degrees, ``at``, and lat_deg, lon_deg if there is no x; null is not known."""

    def silence_now_s(self, now: float) -> float:
        return math.inf if self.silence_s is None else self.silence_s + max(now - self.at, 0.0)

    def heard(self, now: float) -> bool:
        return self.connected and self.silence_now_s(now) < VEHICLE_SILENT_S

    def matches(self, words: Iterable[str], now: float) -> bool:
        """True if each word is part of its words, or begins a word of its state: "armed" is no part of "disarmed". The
        page's own filter has the same words (columns.ts)."""
        heard = self.heard(now)
        states = (*self.states, "heard" if heard else "silent", "problem" if self.problem or not heard else "")
        return all(word in self.words or any(state.startswith(word) for state in states) for word in words)


def site_of(name: str) -> str:
    """The site of a vehicle's name; "" of ours."""
    site, slash, _ = name.partition("/")
    return site if slash else ""


def digest_of(name: str, body: bytes, at: float) -> Digest:
    """Digest of a state as the daemon, or a station's bridge, encoded it. Never raises for what is in it: what cannot
    be read is not known."""
    try:
        state = from_json(body)  # not `parse`: of a state with an infinite number the rest is known (`_number`)
    except ValueError:
        state = {}
    return _digest(name, state if isinstance(state, dict) else {}, at)


def _digest(name: str, state: Mapping[str, Any], at: float) -> Digest:
    # values that may be absent or of another type: a state comes from another process
    sysid, compid = _number(state.get("sysid")), _number(state.get("compid"))
    position, battery, uplink = (_table(state.get(key)) for key in ("position", "battery", "uplink"))
    landed, armed, failsafe = state.get("landed"), state.get("armed"), state.get("failsafe") is True
    percent = _number(battery.get("percent"))
    near = _table(state.get("separation")).get("level") in ("warning", "action")
    empty = percent is not None and percent <= EMPTY_BATTERY_PERCENT
    silence_s = _silence_s(state)
    connected = state.get("connected") is True
    groups = state.get("groups")
    # what a search and a filter compare
    words = (
        name,
        *(str(value) for value in (state.get("sysid"), state.get("mode"), state.get("autopilot")) if value is not None),
        *(group for group in (groups if isinstance(groups, list) else ()) if isinstance(group, str)),
    )
    states = (
        "armed" if armed is True else "disarmed",
        "failsafe" if failsafe else "",
        *_text(landed).lower().split("_"),
    )
    # the row, in the order of the page's columns (store.ts)
    place = position.get("enu_m")
    x, y, z = (_rounded(value) for value in (place if isinstance(place, list) and len(place) == 3 else (None,) * 3))
    row: tuple[object, ...] = (
        name,
        None if sysid is None else int(sysid),
        _text(state.get("autopilot")),
        armed if isinstance(armed, bool) else None,
        _text(landed),
        failsafe,
        connected,
        None if silence_s is None else round(silence_s, 2),
        x,
        y,
        z,
        _rounded(position.get("yaw_world_deg")),
        round(at, 3),
    )
    if x is None:  # without an origin the page makes a frame of its own
        row += (_number(position.get("lat_deg")), _number(position.get("lon_deg")))
    site = site_of(name)
    return Digest(
        name=name,
        site=site,
        order=(site, int(sysid or 0), int(compid or 0), name),
        words=" ".join(words).lower(),
        states=states,
        armed=armed is True,
        in_air=_text(landed) in IN_AIR,
        problem=failsafe or near or empty or uplink.get("heard") is False,
        connected=connected,
        silence_s=silence_s,
        at=at,
        row=encode(row),
    )


def _silence_s(state: Mapping[str, Any]) -> float | None:
    """Since anything came of it, as the page works it out (store.ts)."""
    ages = [_number(_table(link).get("age_s")) for link in _table(state.get("links")).values()]
    ages.append(_number(state.get("last_heartbeat_age_s")))
    return min((age for age in ages if age is not None), default=None)


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _table(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, dict) else {}


def _number(value: object) -> float | None:
    return float(value) if is_number(value) else None


def _rounded(value: object) -> float | None:
    number = _number(value)
    return None if number is None else round(number, 2)


@dataclass(frozen=True, slots=True)
class View:
    """The vehicles that a page shows in full: those of these sites, or those that a search finds, and some by name."""

    sites: frozenset[str] | None = None
    """None: all of them."""
    words: tuple[str, ...] = ()
    """Words of a search, which looks into all sites."""
    names: frozenset[str] = frozenset()
    """Those selected, or near in the fleet view: they come first."""

    def wanted(self, digests: Iterable[Digest], now: float) -> tuple[set[str], int]:
        """(names of at most MAX_FULL vehicles, how many more match). ``digests`` in the order of their lists."""
        found: list[str] = []
        wanted: set[str] = set()
        for digest in digests:
            if digest.name in self.names:
                wanted.add(digest.name)
            elif digest.matches(self.words, now) if self.words else self.sites is None or digest.site in self.sites:
                found.append(digest.name)
        room = max(MAX_FULL - len(wanted), 0)
        wanted.update(found[:room])
        return wanted, max(len(found) - room, 0)


EVERYTHING = View()


def view_of(params: Mapping[str, Any]) -> View:
    """The parameters of web.view. Raises RpcError."""
    sites = params.get("sites")
    search = params.get("search", "")
    if not isinstance(search, str) or len(search) > MAX_SEARCH_CHARS:
        raise RpcError(INVALID_PARAMS, f"search must be a text of at most {MAX_SEARCH_CHARS} characters")
    return View(
        sites=None if sites is None else _names(sites, "sites", MAX_SITES),
        words=tuple(search.lower().split()),
        names=_names(params.get("names", []), "names", MAX_NAMES),
    )


def _names(value: object, key: str, most: int) -> frozenset[str]:
    names = value if isinstance(value, list) else None
    if names is None or len(names) > most or not all(isinstance(n, str) and len(n) <= MAX_NAME_CHARS for n in names):
        raise RpcError(INVALID_PARAMS, f"{key} must be a list of at most {most} names")
    return frozenset(names)


def count_sites(digests: Iterable[Digest], now: float) -> list[dict[str, Any]]:
    """Count each site's vehicles, in the order of the digests. ``oldest_age_s``: since when the vehicle that is silent
    for the longest time was not heard; null if one was never heard. One that was lost in the air still counts as armed
    and in the air (trouble.ts)."""
    counts: dict[str, dict[str, Any]] = {}
    for digest in digests:
        of = counts.get(digest.site)
        if of is None:
            of = counts[digest.site] = dict.fromkeys(("vehicles", "heard", "armed", "in_air", "problems"), 0)
            of |= {"site": digest.site, "oldest_age_s": 0.0}
        heard = digest.heard(now)
        of["vehicles"] += 1
        of["heard"] += heard
        counted = heard or (digest.in_air and digest.silence_s is not None)
        of["armed"] += digest.armed and counted
        of["in_air"] += digest.in_air and counted
        of["problems"] += digest.problem or not heard
        of["oldest_age_s"] = max(of["oldest_age_s"], digest.silence_now_s(now))
    for of in counts.values():
        of["oldest_age_s"] = None if math.isinf(of["oldest_age_s"]) else round(of["oldest_age_s"], 1)
    return list(counts.values())
