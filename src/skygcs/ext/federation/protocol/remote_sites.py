"""The other sites as this station knows them: the newest batch of each, with its total age. Pure.

    a batch                                         is
    ---------------------------------------------   -------------------------------------------------------------------
    of a new site, while there is room              kept
    of the same run, with a larger seq              kept; missing numbers are counted as lost
    of the same run, with a seq that is not larger  ignored (late or a copy)
    of a run that was never received                kept: the site's bridge has restarted
    of a run that was replaced                      ignored; if it comes later than CONTESTED_S after the replacement,
                                                    the site is contested: two bridges send under one name
    of the own site, from another run               ignored; the own name is contested

Age. A batch has its time of sending by the site's clock. `ClockComparison` estimates how far that clock is ahead of
ours, with a bound of the error, from pings that the site answers. The total age of a state is its age at the site plus
the time since the batch was *sent*: a batch that was in a queue for a minute is a minute older, even if it has just
arrived. Without a comparison the age is not known.

Silence. A site is silent if its newest batch was sent longer than SILENT_PERIODS periods ago (SILENT_AFTER_S at least),
or if that age is not known: its vehicles keep their last values, with growing ages, and count as not connected.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from skygcs.core.clock_offset import ClockComparison, ClockOffset
from skygcs.core.geo import Origin, enu_from_geodetic, heading_from_yaw_enu_deg, wrap_deg_180
from skygcs.core.vehicle.decoding import FIX_NAMES
from skygcs.core.vehicle.state import AIRBORNE
from skygcs.ext.federation.protocol.origin_shift import velocity_in, yaw_in
from skygcs.ext.federation.protocol.site_names import qualified
from skygcs.ext.federation.protocol.state_batch import StateBatch, VehicleRow

MAX_SITES = 64
"""Other sites that are kept; with 300 vehicles each they take 20 MB."""

FORGET_AFTER_S = 3600.0
"""A site that was silent for this time is dropped when a new one needs its place. Until then it is shown, grey."""

SILENT_AFTER_S, SILENT_PERIODS = 1.0, 4.0
"""Age of the newest batch, in seconds and in periods of the site, from which the site is silent; the larger counts."""

CONTESTED_S = 5.0
"""Longer than batches of a bridge that has ended can stay in the network; also how long a name stays contested."""

RUNS_REMEMBERED = 8
"""Replaced runs of a site that are recognised."""

CLOCK_JUMP_S = 0.25
"""A batch that arrives this much before its time of sending, beyond the comparison's error, shows that a clock was
set: the comparison begins anew."""


@dataclass(slots=True)
class _Site:
    batch: StateBatch
    received_at: float
    first_at: float
    rows: dict[str, VehicleRow]
    clock: ClockComparison = field(default_factory=ClockComparison)
    replaced: deque[str] = field(default_factory=lambda: deque(maxlen=RUNS_REMEMBERED))
    replaced_at: float = -math.inf
    contested_at: float = -math.inf
    taken: int = 0
    lost: int = 0
    late: int = 0
    restarts: int = 0


class RemoteSites:
    """The other sites. Call `take` for each batch and `compare_clock` after each answered ping; read `sites`, `states`
    and `state`. ``now`` is always the same clock of this station, which also runs while the machine sleeps."""

    def __init__(self, own_site: str | None, own_run: str) -> None:
        self.counters: Counter[str] = Counter()
        self.own_contested_at = -math.inf
        """When another bridge last sent under the own site's name."""
        self._own_site = own_site
        self._own_run = own_run
        self._sites: dict[str, _Site] = {}

    def __contains__(self, site: object) -> bool:
        return site in self._sites

    @property
    def names(self) -> list[str]:
        """Sorted names of the other sites that are kept."""
        return sorted(self._sites)

    # -- input

    def take(self, batch: StateBatch, now: float) -> bool:
        """Take in a batch that has arrived now; True if it is the newest of its site."""
        # batches in this site's own name: its own, or those of another bridge
        if batch.site == self._own_site:
            if batch.run != self._own_run:
                self.own_contested_at = now
                self.counters["batches_in_own_name"] += 1
            return False
        # a new site, the next batch of a known run, or another run
        site = self._sites.get(batch.site)
        if site is None:
            if not self._make_room(now):
                self.counters["sites_beyond_limit"] += 1
                return False
            site = self._sites[batch.site] = _Site(batch, now, now, {})
        elif batch.run == site.batch.run:
            if batch.seq <= site.batch.seq:
                site.late += 1
                return False
            site.lost += batch.seq - site.batch.seq - 1
        elif batch.run in site.replaced:
            site.late += 1
            if now - site.replaced_at > CONTESTED_S:
                site.contested_at = now
            return False
        else:
            site.replaced.append(site.batch.run)
            site.replaced_at = now
            site.clock = ClockComparison()
            site.restarts += 1
        # take the batch
        site.batch, site.received_at = batch, now
        site.rows = {row.name: row for row in batch.vehicles}
        site.taken += 1
        self._check_clock(site, now)
        return True

    def compare_clock(
        self, name: str, run: str, sent: float, received: float, site_s: float, *, unix_received: float
    ) -> bool:
        """Take in an answered ping: our clock when it was ``sent`` and when the answer was ``received``, and the site's
        clock in between. ``unix_received``: our wall clock at the answer. False if it cannot be used: it is of another
        run, or its times are impossible."""
        site = self._sites.get(name)
        if site is None or run != site.batch.run:
            return False
        return site.clock.add(sent, received, site_s, wall_received=unix_received, remote_wall=site_s)

    # -- output

    def clock(self, name: str, now: float) -> ClockOffset | None:
        """How far the site's clock is ahead of ours; None: not known."""
        site = self._sites.get(name)
        return None if site is None else site.clock.best(now)

    def batch_age_s(self, name: str, now: float) -> float | None:
        """Time since the site's newest batch was sent; None: not known."""
        site = self._sites.get(name)
        return None if site is None else _batch_age_s(site, now)

    def is_silent(self, name: str, now: float) -> bool:
        """True if the site's states are too old to act on, or of unknown age."""
        site = self._sites.get(name)
        return site is None or _is_silent(site, now)

    def rows(self, name: str) -> Sequence[VehicleRow]:
        """The vehicles of the site's newest batch, as they were sent."""
        site = self._sites.get(name)
        return () if site is None else site.batch.vehicles

    def origin(self, name: str) -> Origin | None:
        """The origin of the site's world frame."""
        site = self._sites.get(name)
        return None if site is None else site.batch.origin

    def states(self, name: str, now: float, ours: Origin | None) -> list[dict[str, Any]]:
        """The states of a site's vehicles (`state_of`). ``ours``: origin of the own world frame."""
        site = self._sites.get(name)
        if site is None:
            return []
        age_s, silent = _batch_age_s(site, now), _is_silent(site, now)
        return [state_of(row, name, age_s, ours, silent=silent) for row in site.batch.vehicles]

    def state(self, name: str, vehicle: str, now: float, ours: Origin | None) -> dict[str, Any] | None:
        """The state of one vehicle (`state_of`); None: the site's newest batch does not have it."""
        site = self._sites.get(name)
        row = None if site is None else site.rows.get(vehicle)
        if site is None or row is None:
            return None
        return state_of(row, name, _batch_age_s(site, now), ours, silent=_is_silent(site, now))

    def sites(self, now: float) -> list[dict[str, Any]]:
        """The status of every other site, for federation.sites."""
        return [_described(name, self._sites[name], now) for name in self.names]

    # -- private

    def _make_room(self, now: float) -> bool:
        if len(self._sites) < MAX_SITES:
            return True
        name, site = min(self._sites.items(), key=lambda item: item[1].received_at)
        if now - site.received_at < FORGET_AFTER_S:
            return False
        del self._sites[name]
        self.counters["sites_forgotten"] += 1
        return True

    def _check_clock(self, site: _Site, now: float) -> None:
        offset = site.clock.best(now)
        if offset is None:
            return
        transit_s = now - (site.batch.sent_s - offset.offset_s)
        if transit_s < -(offset.error_s + CLOCK_JUMP_S):
            site.clock = ClockComparison()
            self.counters["clock_jumps"] += 1


def _batch_age_s(site: _Site, now: float) -> float | None:
    """Time since the newest batch was sent, at least the time since it was received; None: not known."""
    offset = site.clock.best(now)
    if offset is None:
        return None
    return max(now - (site.batch.sent_s - offset.offset_s), now - site.received_at)


def _is_silent(site: _Site, now: float) -> bool:
    age_s = _batch_age_s(site, now)
    return age_s is None or age_s > max(SILENT_AFTER_S, SILENT_PERIODS * site.batch.period_s)


def state_of(
    row: VehicleRow, site: str, batch_age_s: float | None, ours: Origin | None, *, silent: bool
) -> dict[str, Any]:
    """A vehicle of another site with the keys of a daemon's state, ``site``, and total ages. Its position is also in
    the own world frame if ``ours``, its origin, is known."""
    # groups of telemetry that the row has
    age_s = _sum(row.age_s, batch_age_s)
    gps = None
    if row.gps_fix is not None:
        fix_type = FIX_NAMES.index(row.gps_fix) if row.gps_fix in FIX_NAMES else None
        gps = {"fix": row.gps_fix, "fix_type": fix_type, "satellites": row.satellites, "age_s": age_s}
    battery = None
    if row.battery_percent is not None or row.battery_volts is not None:
        battery = {"percent": row.battery_percent, "volts": row.battery_volts, "age_s": age_s}
    # the state in the form of the daemon's own vehicles
    return {
        "name": qualified(site, row.name),
        "sysid": row.sysid,
        "compid": row.compid,
        "site": site,
        "age_s": age_s,
        "autopilot": row.autopilot,
        "type": row.type,
        "firmware": None,
        "groups": list(row.groups),
        "connected": row.heard and not silent and age_s is not None,
        "duplicate_sysid": False,
        "replayed": False,
        "last_heartbeat_age_s": age_s,
        "armed": row.armed,
        "mode": row.mode,
        "landed": row.landed,
        "failsafe": row.failsafe,
        "control": None if row.control is None else {"state": row.control},
        "gps": gps,
        "position": _position(row, batch_age_s, ours),
        "battery": battery,
        "lease": None if row.lease is None else row.lease._asdict(),
    }


def _position(row: VehicleRow, batch_age_s: float | None, ours: Origin | None) -> dict[str, Any] | None:
    if row.lat_deg is None or row.lon_deg is None:
        return None
    place, velocity = (row.lat_deg, row.lon_deg), row.vel_enu_mps
    enu_m = vel_world_mps = yaw_world_deg = None
    if ours is not None and row.alt_amsl_m is not None:
        enu_m = [round(axis, 3) for axis in enu_from_geodetic(*place, row.alt_amsl_m, ours)]
    if ours is not None and velocity is not None:
        vel_world_mps = [round(axis, 3) for axis in velocity_in(ours, velocity, *place)]
    if ours is not None and row.yaw_rad is not None:
        yaw_world_deg = round(wrap_deg_180(math.degrees(yaw_in(ours, row.yaw_rad, *place))), 2)
    heading_deg = None if row.yaw_rad is None else round(heading_from_yaw_enu_deg(math.degrees(row.yaw_rad)), 1)
    return {
        "lat_deg": row.lat_deg,
        "lon_deg": row.lon_deg,
        "alt_amsl_m": row.alt_amsl_m,
        "alt_rel_m": row.alt_rel_m,
        "heading_deg": heading_deg,
        "vel_enu_mps": None if velocity is None else list(velocity),
        "enu_m": enu_m,
        "vel_world_mps": vel_world_mps,
        "yaw_world_deg": yaw_world_deg,
        "age_s": _sum(row.position_age_s, batch_age_s),
    }


def _described(name: str, site: _Site, now: float) -> dict[str, Any]:
    offset, age_s, silent = site.clock.best(now), _batch_age_s(site, now), _is_silent(site, now)
    rows = site.batch.vehicles
    ages = [total for row in rows if (total := _sum(row.age_s, age_s)) is not None]
    return {
        "site": name,
        "silent": silent,
        "age_s": None if age_s is None else round(age_s, 3),
        "daemon": site.batch.daemon,
        "contested": now - site.contested_at < CONTESTED_S,
        "run": site.batch.run,
        "restarts": site.restarts,
        "rate_hz": round(1.0 / site.batch.period_s, 2),
        "batches": {"taken": site.taken, "lost": site.lost, "late": site.late},
        "clock": None if offset is None else _clock_as_dict(offset),
        "origin": None if site.batch.origin is None else site.batch.origin.as_dict(),
        "vehicles": {
            "count": len(rows),
            "heard": 0 if silent else sum(row.heard for row in rows),
            "armed": sum(row.armed for row in rows),
            "in_the_air": sum(row.landed in AIRBORNE for row in rows),
            "problems": len(rows) if silent else sum(row.failsafe or not row.heard for row in rows),
            "oldest_age_s": max(ages, default=None),
        },
    }


def _clock_as_dict(offset: ClockOffset) -> Mapping[str, float]:
    return {
        "ahead_s": round(offset.wall_offset_s, 4),
        "error_s": round(offset.error_s, 4),
        "round_trip_s": round(offset.round_trip_s, 4),
    }


def _sum(first_s: float | None, second_s: float | None) -> float | None:
    return None if first_s is None or second_s is None else round(first_s + second_s, 3)
