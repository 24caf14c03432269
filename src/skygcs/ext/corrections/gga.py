"""The position that a virtual reference station is computed for: NMEA's GGA sentence, and the vehicle it is of."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

FIXES = frozenset({"3d", "dgps", "rtk_float", "rtk_fixed"})
"""Fixes whose position is good enough; a caster needs kilometres."""

GGA_UNITS = 60 * 10**6
"""Parts of a degree in a sentence: minutes with six digits, 2 mm."""


class GgaPosition(NamedTuple):
    """A place for a caster, and where it is from: a vehicle's name, or "origin"."""

    source: str
    lat_deg: float
    lon_deg: float
    alt_amsl_m: float
    satellites: int = 12


def gga_sentence(place: GgaPosition, utc_s: float) -> bytes:
    """The sentence for a place at a time (Unix seconds), with its checksum and end of line.

    Quality is 1 (a plain fix) and the height of the geoid 0: a caster computes corrections for about this place."""
    second = int(utc_s) % 86400
    clock = f"{second // 3600:02d}{second // 60 % 60:02d}{second % 60:02d}.00"
    lat = f"{_degrees_and_minutes(place.lat_deg, 2)},{'S' if place.lat_deg < 0 else 'N'}"
    lon = f"{_degrees_and_minutes(place.lon_deg, 3)},{'W' if place.lon_deg < 0 else 'E'}"
    satellites = min(max(place.satellites, 4), 99)
    body = f"GPGGA,{clock},{lat},{lon},1,{satellites:02d},1.0,{place.alt_amsl_m:.2f},M,0.0,M,,"
    checksum = 0
    for byte in body.encode("ascii"):
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode("ascii")


def _degrees_and_minutes(degrees: float, digits: int) -> str:
    whole, rest = divmod(round(abs(degrees) * GGA_UNITS), GGA_UNITS)
    return f"{whole:0{digits}d}{rest // 10**6:02d}.{rest % 10**6:06d}"


def chosen_place(
    fixes: Iterable[tuple[str, Mapping[str, Any]]], *, only: str | None = None, last: str | None = None
) -> GgaPosition | None:
    """The place of the vehicle ``only``; without one, of ``last`` while it has a fix, else of the first that has.

    ``fixes``: vehicles and the group gps of their states. A virtual station moves with its vehicle, so that one vehicle
    stays the one."""
    good = [place for name, gps in fixes if only in (None, name) and (place := _place_of(name, gps)) is not None]
    return next((place for place in good if place.source == last), good[0] if good else None)


def _place_of(name: str, gps: Mapping[str, Any]) -> GgaPosition | None:
    lat, lon = gps.get("lat_deg"), gps.get("lon_deg")
    if gps.get("fix") not in FIXES or lat is None or lon is None or not (abs(lat) <= 90 and abs(lon) <= 180):
        return None
    return GgaPosition(name, lat, lon, gps.get("alt_amsl_m") or 0.0, gps.get("satellites") or 12)
