"""The states that a site publishes of its own vehicles: the newest of each, with its age at the time of sending. Pure.

The daemon sends a round of states each period. A vehicle that is missing in the rounds for GONE_AFTER_S is removed.
While no round comes (the daemon is stopped or away) nothing is removed, and the ages grow.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from skygcs.core.geo import Origin
from skygcs.core.vehicle.targets import select
from skygcs.errors import TargetError
from skygcs.ext.federation.protocol.state_batch import (
    MAX_VEHICLES_OF_SITE,
    RowLease,
    StateBatch,
    VehicleRow,
    aged,
    row_from_state,
)

GONE_AFTER_S = 3.0
"""Seconds after which a missing vehicle is removed, the same as on the web page; longer than the slowest period of the
rounds, two seconds."""

HEARD_WITHIN_S = 10.0
"""A state older than this is sent as not heard: the daemon no longer answers. Daemons count a vehicle as lost after 3
to 10 s."""


class LeaseOf(Protocol):
    """Returns the lease of the vehicle of this name, None if it has none."""

    def __call__(self, vehicle: str) -> RowLease | None: ...


def no_lease(vehicle: str) -> RowLease | None:
    """The `LeaseOf` of a site without delegated vehicles."""
    return None


@dataclass(slots=True)
class _Kept:
    row: VehicleRow
    at: float


class OwnStates:
    """The own vehicles. Call `put` for each state of the daemon, `end_round` after the last one of a round, and `batch`
    for the next message."""

    def __init__(self, site: str, run: str, period_s: float, share: Sequence[str] = ("all",)) -> None:
        """``share``: target expressions of the published vehicles; an expression that names no vehicle yet is no
        error."""
        self.counters: Counter[str] = Counter()
        self.seq = 0
        self.site = site
        self.run = run
        self._period_s = period_s
        self._share = tuple(share)
        self._kept: dict[str, _Kept] = {}
        self._round_began: float | None = None
        self._anew_at: float | None = None
        self._shared: frozenset[str] | None = None

    @property
    def names(self) -> list[str]:
        """Names of all vehicles of the daemon, shared or not."""
        return list(self._kept)

    def __contains__(self, name: object) -> bool:
        """True if the daemon has a vehicle of this name."""
        return name in self._kept

    def put(self, state: Mapping[str, Any], now: float) -> None:
        """Take in a state that the daemon has just sent."""
        if self._round_began is None:
            self._round_began = now
        row = row_from_state(state)
        if row is None:
            self.counters["states_unusable"] += 1
            return
        kept = self._kept.get(row.name)
        if kept is None and len(self._kept) >= MAX_VEHICLES_OF_SITE:
            self.counters["vehicles_beyond_limit"] += 1
            return
        if kept is None or (kept.row.sysid, kept.row.groups) != (row.sysid, row.groups):
            self._shared = None
        self._kept[row.name] = _Kept(row, now)

    def end_round(self, now: float) -> None:
        """The round is complete: remove vehicles that were missing for GONE_AFTER_S, or since `begin_anew`."""
        began, self._round_began = self._round_began, None
        if self._anew_at is not None and began is not None:
            self._remove_older(began)
            self._anew_at = None
        self._remove_older(min(now if began is None else began, now - GONE_AFTER_S))

    def begin_anew(self, now: float) -> None:
        """Another run of the daemon answers from now on. Vehicles that are not in its first round are removed; all
        vehicles are, if no round comes within GONE_AFTER_S: that daemon has no vehicle."""
        self._anew_at = now
        self._round_began = None

    def shares(self, name: str) -> bool:
        """True if the vehicle of this name is published."""
        if self._shared is None:
            self._shared = self._find_shared()
        return name in self._shared

    def batch(
        self, now: float, sent_s: float, origin: Origin | None, *, daemon: bool, lease_of: LeaseOf = no_lease
    ) -> StateBatch:
        """The next batch to send. ``sent_s``: the site's clock now. ``daemon``: True if the daemon is connected."""
        self.seq += 1
        if self._anew_at is not None and now - self._anew_at > GONE_AFTER_S:
            self._remove_older(self._anew_at)
            self._anew_at = None
        rows = []
        for row in self.rows(now):
            if self.shares(row.name):
                lease = lease_of(row.name)
                rows.append(row if lease is None else row._replace(lease=lease))
        return StateBatch(self.site, self.run, self.seq, sent_s, self._period_s, daemon, origin, tuple(rows))

    def rows(self, now: float) -> Iterator[VehicleRow]:
        """The rows of all vehicles, shared or not, with their ages at ``now``."""
        for kept in self._kept.values():
            row = aged(kept.row, now - kept.at)
            stale = row.heard and now - kept.at > HEARD_WITHIN_S
            yield row._replace(heard=False) if stale else row

    def _remove_older(self, than: float) -> None:
        for name in [name for name, kept in self._kept.items() if kept.at < than]:
            del self._kept[name]
            self._shared = None

    def _find_shared(self) -> frozenset[str]:
        rows = [kept.row for kept in self._kept.values()]
        found: set[str] = set()
        for part in self._share:
            try:
                found.update(row.name for row in select(part, rows))
            except TargetError:
                continue  # not heard yet
        return frozenset(found)
