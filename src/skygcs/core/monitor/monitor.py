"""The monitor: the conflicts of a fleet, their changes of level as events, and the holds that it asks for.

Work is bounded. The pairs are found by a sweep along one axis over the boxes in which the vehicles may be within the
horizon; of each vehicle the `MAX_CONFLICTS` most urgent conflicts are kept. `Monitor.evaluate` is a generator that
yields every fraction of a millisecond, so that a control tick never waits for the whole of it.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from skygcs.core.monitor.conflict_levels import (
    HORIZON_S,
    HYSTERESIS,
    Conflict,
    Level,
    Pair,
    find_conflict,
    is_ranked_above,
    rank,
    who_holds,
    why_not_yield,
)
from skygcs.core.monitor.tracks import Member, Track, TrackTable
from skygcs.core.separation import pair_margin, separation_m
from skygcs.events import Event

MAX_CONFLICTS = 8
"""Conflicts kept of one vehicle, the most urgent ones: more neighbours cannot all be the nearest."""

PAIRS_A_TURN = 25
"""Looked at before other tasks of the loop may get their turn: 0.1 to 0.4 ms (measured)."""

CONFLICTS_A_TURN = 5
"""Worked out in full, or advanced and reported, before other tasks may get their turn: up to 0.3 ms (measured)."""

REHOLD_S = 60.0
"""A vehicle that was held for another is not held for it again before they were clear of each other for so long: what
an operator orders after the hold is carried out."""

SETTLE_S = 4.0
"""After a hold the vehicle is given so long to stop, before the other one is held as well."""

RETRY_S = 1.0
"""After a hold that failed."""

BLIND_S = 3.0
"""A flying vehicle that cannot be watched is reported after so long: it may just have been found."""

NEAR_LOST_M = 5.0
"""Beyond the margin: a vehicle that holds drifts by a few metres, and others that come so near are warned."""

KIND = "separation"

PairKey = tuple[int, int]


class HoldRequest(NamedTuple):
    """A vehicle that should be ordered to hold now, and for which one."""

    key: int
    name: str
    other: str
    text: str
    data: dict[str, Any]
    pair: PairKey = (0, 0)


@dataclass(slots=True)
class Counters:
    """Counts since the daemon began."""

    evaluations: int = 0
    pairs_checked: int = 0
    pairs_dropped: int = 0
    """Conflicts beyond `MAX_CONFLICTS` of both their vehicles."""
    notices: int = 0
    warnings: int = 0
    actions: int = 0
    holds: int = 0
    holds_failed: int = 0
    orders_checked: int = 0
    orders_refused: int = 0


@dataclass(slots=True)
class _Held:
    """Holds of a pair: which vehicles were held for it, when that was, and when it last was in conflict."""

    keys: set[int] = field(default_factory=set)
    at: float = 0.0
    conflict_at: float = 0.0


class _Box(NamedTuple):
    """Where a vehicle may be within the horizon, with its share of the margin; metres of the common frame."""

    low_x: float
    high_x: float
    low_y: float
    high_y: float
    low_z: float
    high_z: float
    track: Track


class _Ranked(NamedTuple):
    """A conflict by its urgency: the sooner, and then the nearer, the larger."""

    later_s: float
    farther_m: float
    key: PairKey


class Monitor:
    """`evaluate` once to four times a second; then take ``events`` and ``holds``."""

    def __init__(self, *, acting: bool) -> None:
        self.acting = acting
        self.tracks = TrackTable()
        self.pairs: dict[PairKey, Pair] = {}
        self.events: list[Event] = []
        self.holds: list[HoldRequest] = []
        self.counters = Counters()
        self._held: dict[PairKey, _Held] = {}
        self._blind: dict[int, tuple[str, str, float, bool]] = {}
        """Flying vehicles that are not watched, by key: name, why, since when, and whether that was reported."""
        self._worst: dict[int, Pair] = {}
        """Most urgent conflict of each vehicle at the last evaluation: to look for it among the pairs of a fleet of 250
        took each of its states 0.35 ms."""
        self._near_lost: set[PairKey] = set()
        """Pairs of which one flies near the place where the other was lost, that were reported."""

    # -- one evaluation

    def evaluate(self, members: Iterable[Member], now: float) -> Iterator[None]:
        """Read all vehicles, find their conflicts, and advance the level of each pair."""
        yield from self.tracks.refresh(members, now)
        found: dict[PairKey, Conflict] = {}
        dropped: set[PairKey] = set()
        yield from self._sweep(found, dropped)
        yield from self._advance(found, dropped, now)
        self._watch_blind(now)
        self._watch_lost()
        self._worst = {key: pair for pair in reversed(self.conflicts()) for key in (pair.a.key, pair.b.key)}
        self.counters.evaluations += 1

    def _sweep(self, found: dict[PairKey, Conflict], dropped: set[PairKey]) -> Iterator[None]:
        """Find the pairs whose boxes overlap, rank their conflicts by urgency, and work out the most urgent ones.
        ``dropped``: pairs that were among those before, are in conflict still, and are not any more."""
        # a box around the way of each vehicle until the horizon
        boxes: list[_Box] = []
        ratio = max((track.footprint.downwash_ratio for track in self.tracks.tracks.values()), default=1.0)
        for track in self.tracks.tracks.values():
            boxes.append(_box(track, ratio))
            yield
        # pairs of boxes that overlap, in order of their low edge: sweep and prune
        boxes.sort(key=lambda box: box.low_x)
        urgent: dict[int, list[_Ranked]] = {box.track.key: [] for box in boxes}
        """Most urgent conflicts of each vehicle, a heap with the least urgent of them first."""
        looked = ranked = 0
        for i, box in enumerate(boxes):
            for j in range(i + 1, len(boxes)):
                other = boxes[j]
                looked += 1
                if looked % PAIRS_A_TURN == 0:
                    yield
                if other.low_x > box.high_x:
                    break
                if not _overlap(box, other):
                    continue
                a, b = box.track, other.track
                self.counters.pairs_checked += 1
                urgency = rank(a, b, self._widened(_pair_key(a, b)))
                if urgency is not None:
                    ranked += 1
                    if _pair_key(a, b) in self.pairs:
                        dropped.add(_pair_key(a, b))
                    entry = _Ranked(-urgency[0], -urgency[1], _pair_key(a, b))
                    _keep(urgent[a.key], entry)
                    _keep(urgent[b.key], entry)
        # the conflicts that are among the most urgent of either vehicle
        wanted = {entry.key for heap in urgent.values() for entry in heap}
        self.counters.pairs_dropped += ranked - len(wanted)
        dropped -= wanted
        for n, key in enumerate(wanted):
            if n % CONFLICTS_A_TURN == 0:
                yield
            conflict = find_conflict(self.tracks.tracks[key[0]], self.tracks.tracks[key[1]], self._widened(key))
            if conflict is not None:
                found[key] = conflict

    def _widened(self, key: PairKey) -> float:
        known = self.pairs.get(key)
        return HYSTERESIS if known is not None and known.level is not Level.NONE else 1.0

    def _advance(self, found: dict[PairKey, Conflict], dropped: set[PairKey], now: float) -> Iterator[None]:
        """Advance the level of every pair. Yields between pairs, so vehicles may change meanwhile; tracks do not."""
        tracks = self.tracks.tracks
        # pairs in conflict now
        for n, (key, conflict) in enumerate(found.items()):
            if n % CONFLICTS_A_TURN == 0:
                yield
            a, b = tracks[key[0]], tracks[key[1]]
            upper, lower = (a, b) if is_ranked_above(a.vehicle, b.vehicle, a.priority, b.priority) else (b, a)
            pair = self.pairs.get(key)
            if pair is not None and {id(pair.a.vehicle), id(pair.b.vehicle)} != {id(a.vehicle), id(b.vehicle)}:
                self._end(key, pair)
                pair = None  # another vehicle has come under the id of an earlier one
            if pair is None:
                self.pairs[key] = pair = Pair(upper, lower, now)
            pair.a, pair.b = upper, lower
            self._step(key, pair, conflict, now)
        # pairs that were in conflict before
        for n, (key, pair) in enumerate([(k, p) for k, p in self.pairs.items() if k not in found]):
            if n % CONFLICTS_A_TURN == 0:
                yield
            if key[0] not in tracks or key[1] not in tracks:
                self._end(key, pair)
            elif key in dropped:
                self._drop(key, pair)
            else:
                self._step(key, pair, None, now)
                if pair.over:
                    del self.pairs[key]
        # vehicles that were held for a conflict long ago
        for key, held in list(self._held.items()):
            if now - held.conflict_at > REHOLD_S:
                del self._held[key]

    def _step(self, key: PairKey, pair: Pair, conflict: Conflict | None, now: float) -> None:
        if pair.advance(conflict, now):
            self._report(pair)
        held = self._held.get(key)
        if held is not None and conflict is not None and conflict.level >= Level.WARNING:
            held.conflict_at = now
        if self.acting and conflict is not None and pair.level is Level.ACTION and conflict.level is Level.ACTION:
            self._act(key, pair, conflict, now)

    def _act(self, key: PairKey, pair: Pair, conflict: Conflict, now: float) -> None:
        """Ask for the hold that helps. One that was held for this pair is not held for it again."""
        held = self._held.get(key)
        if held is not None and now - held.at < SETTLE_S:
            return
        done = set() if held is None else held.keys
        upper, lower = pair.a, pair.b
        may_hold = (
            upper.key not in done and why_not_yield(upper, now) is None,
            lower.key not in done and why_not_yield(lower, now) is None,
        )
        if not any(may_hold):
            return
        radius_m = conflict.margin.total_m + conflict.balls_m
        for track in who_holds(upper, lower, may_hold, radius_m, conflict.margin.downwash_ratio, HORIZON_S):
            held = self._held.setdefault(key, _Held())
            held.keys.add(track.key)
            held.at = held.conflict_at = now
            other = upper if track is lower else lower
            self.counters.holds += 1
            text = f"{track.name} is ordered to hold: it would come {conflict.closest_m:.1f} m near {other.name} in "
            text += f"{conflict.closest_in_s:.0f} s"
            self.holds.append(HoldRequest(track.key, track.name, other.name, text, pair.describe(), key))

    def hold_failed(self, request: HoldRequest, now: float) -> None:
        """The vehicle did not take the order: after `RETRY_S` it may be given again, to it or to the other one."""
        held = self._held.get(request.pair)
        if held is not None:
            held.keys.discard(request.key)
            held.at = now - SETTLE_S + RETRY_S

    # -- reports

    def _report(self, pair: Pair) -> None:
        counters = self.counters
        if pair.level is Level.NOTICE:
            counters.notices += 1
        elif pair.level is Level.WARNING:
            counters.warnings += 1
        elif pair.level is Level.ACTION:
            counters.actions += 1
        data = {**pair.describe(), "may_hold": list(self._may_hold(pair))}
        self.events.append(Event(KIND, pair.b.name, pair.b.vehicle.sysid, conflict_text(pair), data))

    def _may_hold(self, pair: Pair) -> Iterator[str]:
        for track in (pair.b, pair.a):
            if why_not_yield(track, track.at + track.age_s) is None:
                yield track.name

    def _end(self, key: PairKey, pair: Pair) -> None:
        """One of the two is not watched any more."""
        del self.pairs[key]
        if pair.level is Level.NONE:
            return
        gone = [track.name for track in (pair.a, pair.b) if self.tracks.tracks.get(track.key) is not track]
        pair.level, pair.conflict = Level.NONE, None
        text = f"{pair.a.name} and {pair.b.name} are not watched any more: {' and '.join(gone)} cannot be"
        self.events.append(Event(KIND, pair.b.name, pair.b.vehicle.sysid, text, pair.describe()))

    def _drop(self, key: PairKey, pair: Pair) -> None:
        """Both have `MAX_CONFLICTS` more urgent ones: it is not worked out any more, which does not make it clear."""
        del self.pairs[key]
        if pair.level is Level.NONE:
            return
        names = f"{pair.a.name} and {pair.b.name}"
        text = f"{names} are in conflict still, each of them more urgently with {MAX_CONFLICTS} others"
        pair.level, pair.conflict = Level.NONE, None
        self.events.append(Event(KIND, pair.b.name, pair.b.vehicle.sysid, text, pair.describe()))

    def _watch_blind(self, now: float) -> None:
        """Report flying vehicles that cannot be watched, and when they can again."""
        flying = {key: entry for key, entry in self.tracks.unwatched.items() if entry[2]}
        for key in [key for key in self._blind if key not in flying]:
            name, _, _, reported = self._blind.pop(key)
            if reported and key in self.tracks.tracks:
                self.events.append(Event(KIND, name, key >> 8, f"{name} is watched again", {"watched": True}))
        for key, (name, why, _) in flying.items():
            known = self._blind.get(key)
            since, reported = (now, False) if known is None else known[2:]
            if not reported and now - since >= BLIND_S and not self._is_recording(why):
                text = f"{name} is not watched for its distance to others: {why}"
                self.events.append(Event(KIND, name, key >> 8, text, {"watched": False, "reason": why}))
                reported = True
            self._blind[key] = (name, why, since, reported)

    def _watch_lost(self) -> None:
        """Warn, once, of a vehicle that flies where another was last heard in the air: that may be there still. Nobody
        is held for it: by then it may be anywhere."""
        frame, near = self.tracks.frame, set[PairKey]()
        if frame is None:
            return
        for lost, track in itertools.product(self.tracks.lost.values(), self.tracks.tracks.values()):
            margin, key = pair_margin(lost.footprint, track.footprint), _pair_key(lost, track)
            (x, y, z), (u, v, w) = frame.from_ecef(lost.ecef_m), track.place_m
            away_m = separation_m(u - x, v - y, w - z, margin.downwash_ratio)
            reported = key in self._near_lost
            if track.parked or away_m > margin.total_m + NEAR_LOST_M * (HYSTERESIS if reported else 1.0):
                continue
            near.add(key)
            if not reported:
                text = f"{track.name} is {away_m:.1f} m from where {lost.name} was lost in the air"
                data = {"level": "warning", "lost": lost.name, "vehicles": [track.name, lost.name]}
                self.counters.warnings += 1
                self.events.append(Event(KIND, track.name, track.vehicle.sysid, text, data))
        self._near_lost = near

    @staticmethod
    def _is_recording(why: str) -> bool:
        return why.endswith("recording only")

    # -- state

    def conflicts(self) -> list[Pair]:
        """Pairs that have a level, the most urgent first."""
        pairs = [pair for pair in self.pairs.values() if pair.level is not Level.NONE]
        return sorted(pairs, key=lambda pair: (-pair.level, 1e9 if pair.conflict is None else pair.conflict.enters_s))

    def of(self, key: int) -> dict[str, Any] | None:
        """The most urgent conflict of one vehicle, for its state: level, the other vehicle, distances; None: none."""
        worst = self._worst.get(key)
        if worst is None or worst.level is Level.NONE:
            return None
        described = worst.describe()
        described["with"] = worst.b.name if worst.a.key == key else worst.a.name
        del described["vehicles"]
        return described


def conflict_text(pair: Pair) -> str:
    """A sentence for a person about the level of a pair."""
    names, conflict = f"{pair.a.name} and {pair.b.name}", pair.conflict
    if conflict is None or pair.level is Level.NONE:
        return f"{names} are clear of each other"
    margin_m = conflict.margin.total_m
    if conflict.enters_s == 0.0 and conflict.distance_m < margin_m:
        return f"{names} are {conflict.distance_m:.1f} m apart, less than their margin of {margin_m:.1f} m"
    if conflict.level is Level.NOTICE and conflict.closest_m >= margin_m:
        older = max((pair.a, pair.b), key=lambda track: track.age_s)
        return f"{names} may come near each other: the position of {older.name} is {older.age_s:.1f} s old"
    return (
        f"{names} will come {conflict.closest_m:.1f} m near each other in {conflict.closest_in_s:.0f} s "
        f"(margin {margin_m:.1f} m)"
    )


def _pair_key(a: Track, b: Track) -> PairKey:
    return (a.key, b.key) if a.key < b.key else (b.key, a.key)


def _keep(heap: list[_Ranked], entry: _Ranked) -> None:
    """Put a conflict among the most urgent ones of a vehicle, if it is one of them."""
    if len(heap) < MAX_CONFLICTS:
        heapq.heappush(heap, entry)
    else:
        heapq.heappushpop(heap, entry)


def _box(track: Track, ratio: float) -> _Box:
    """``ratio``: the largest downwash ratio of all."""
    footprint = track.footprint
    reach_m = (footprint.wingspan_m / 2 + footprint.position_error_m) * HYSTERESIS + track.ball_m
    x, y, z = track.place_m
    u, v, w = track.velocity_mps
    ends = [(x + u * HORIZON_S, y + v * HORIZON_S, z + w * HORIZON_S)]
    if track.planned:
        ends = list(_points(track))
    elif track.has_goal:
        ends += _points(track)
    return _Box(
        min(x, *(end[0] for end in ends)) - reach_m,
        max(x, *(end[0] for end in ends)) + reach_m,
        min(y, *(end[1] for end in ends)) - reach_m,
        max(y, *(end[1] for end in ends)) + reach_m,
        min(z, *(end[2] for end in ends)) - reach_m * ratio,
        max(z, *(end[2] for end in ends)) + reach_m * ratio,
        track,
    )


def _points(track: Track) -> Iterator[tuple[float, float, float]]:
    """The ends of the pieces of its path, within the horizon."""
    x, y, z = track.place_m
    left_s = HORIZON_S
    for piece in track.path:
        duration_s = min(piece.duration_s, left_s)
        u, v, w = piece.velocity_mps
        x, y, z = x + u * duration_s, y + v * duration_s, z + w * duration_s
        left_s -= duration_s
        yield x, y, z


def _overlap(a: _Box, b: _Box) -> bool:
    """True if two boxes that overlap in x overlap in y and z too; two parked vehicles are no pair."""
    return (
        a.low_y <= b.high_y
        and b.low_y <= a.high_y
        and a.low_z <= b.high_z
        and b.low_z <= a.high_z
        and not (a.track.parked and b.track.parked)
    )
