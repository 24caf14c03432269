"""How far away a place can be that a person means, and whether its latitude and longitude were swapped. Pure."""

from __future__ import annotations

from skygcs.core.geo import distance_m

REACH_M = 100_000.0
"""No vehicle of these fleets flies so far on one battery: what is farther away is a mistake, which no force insists on.
At this distance the flat frame of the fleet is 800 m above the ground."""


def swapped_hint(lat_deg: float, lon_deg: float, near: tuple[float, float] | None, within_m: float) -> str:
    """Ask whether they are swapped, if only the other way round the place is within so many metres of ``near``; without
    ``near``, if only the other way round it is on earth. Else nothing."""
    if not abs(lon_deg) <= 90.0 or not abs(lat_deg) <= 180.0:
        return ""
    as_given = abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0
    if near is None:
        fits = not as_given
    else:
        far = not as_given or distance_m(*near, lat_deg, lon_deg) > within_m
        fits = far and distance_m(*near, lon_deg, lat_deg) <= within_m
    return "; did you swap latitude and longitude?" if fits else ""
