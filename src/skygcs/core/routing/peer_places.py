"""Which senders a server hears: which get a place, and which are parked for bytes that are no MAVLink. Pure.

The places: which newcomers are admitted when all are taken, and which peer is replaced.

    a place is free               any newcomer is admitted
    without an autopilot          takes the place of the peer without an autopilot that was silent for longest, if that
                                  was for PEER_SILENT_S; else one of an address that holds at least two more than it
    with an autopilot             takes the place of a peer without one: of one silent for PEER_SILENT_S, else one
                                  of the address that holds most, but MIN_OTHERS_SHARE of the places stay with such
                                  peers; else the place of an autopilot that was silent for AUTOPILOT_SILENT_S
    an address without a place    takes one of a few additional places that are kept for such
    otherwise                     it is refused: those that were there first keep their places

An autopilot that is heard is never replaced, nor is the last way to a vehicle in the air, heard or not. A flood of
peers that claim to be autopilots keeps what it took first.

A sender of bytes that are no MAVLink: when it is parked, and for how long.

state      leaves it when
---------  -----------------------------------------------------------------------------------------------
heard      it has sent `BURST_BYTES` that are in no frame, and `BYTES_PER_S` for longer: parked
parked     `PARK_S` is over: heard, with a quarter of the burst

A parked sender of datagrams is not ignored: each datagram is read as long as it consists of frames, from its first
byte, which costs as much for a byte of garbage as for 65,535. So an honest program with the same address is heard.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

from skygcs.core.token_bucket import TokenBucket

PEER_SILENT_S = 3.0
"""Two lost heartbeats: a peer with a running program has sent something in this time."""

AUTOPILOT_SILENT_S = 10.0
"""Twice the time after which a vehicle counts as lost."""

MIN_OTHERS_SHARE = 1 / 8
"""Places kept for ground stations that are heard, whatever claims to be an autopilot."""

KEPT_SHARE = 1 / 16
"""Additional places for addresses that hold none: 16 for 256."""

VIEW_S = 0.1
"""How long a review of the peers is used: a flood of newcomers costs one review in this time."""


class Peer(NamedTuple):
    """A peer that has a place. ``host`` is its address without the port."""

    key: Hashable
    host: str
    autopilot: bool
    heard_at: float
    kept: bool = False
    """It is never put out: the last way to a vehicle in the air."""


class Judgement(NamedTuple):
    """``put_out``: the key of the peer that it replaces, if any."""

    admitted: bool
    put_out: Hashable = None


REFUSED = Judgement(admitted=False)
LET_IN = Judgement(admitted=True)


@dataclass(slots=True)
class _View:
    """A review of the peers that have places."""

    at: float
    number: int
    by_host: Counter[str]
    others: int
    silent: Peer | None
    """The peer without an autopilot that was silent for longest."""
    crowded: Peer | None
    """The same among the peers of the address that has most."""
    silent_autopilot: Peer | None


class PeerPlaces:
    """Decides about newcomers to a server. ``peers`` lists its peers; call `changed` when they change."""

    __slots__ = ("_peers", "_view", "kept", "places")

    def __init__(self, places: int, peers: Callable[[], Iterable[Peer]]) -> None:
        self.places = places
        self.kept = int(places * KEPT_SHARE)
        self._peers = peers
        self._view: _View | None = None

    def changed(self) -> None:
        """A peer came or went."""
        self._view = None

    def judge(self, host: str, *, autopilot: bool, now: float) -> Judgement:
        """Judge whether a newcomer is admitted while all places are taken."""
        view = self._view
        fresh = view is None or now - view.at >= VIEW_S
        if view is None or fresh:
            view = self._view = self._look(now)
        if view.number < self.places:
            return LET_IN
        out = self._for_autopilot(view, now) if autopilot else self._for_other(view, host, now)
        if out is not None and not fresh:  # it may have been heard since: nobody is put out by an old review
            view = self._view = self._look(now)
            out = self._for_autopilot(view, now) if autopilot else self._for_other(view, host, now)
        if out is not None:
            return Judgement(True, out.key)
        if not view.by_host[host] and view.number < self.places + self.kept:
            return LET_IN
        return REFUSED

    def _for_autopilot(self, view: _View, now: float) -> Peer | None:
        silent = view.silent
        if silent is not None and now - silent.heard_at >= PEER_SILENT_S:
            return silent
        if view.others > self.places * MIN_OTHERS_SHARE:
            return view.crowded
        autopilot = view.silent_autopilot
        return autopilot if autopilot is not None and now - autopilot.heard_at >= AUTOPILOT_SILENT_S else None

    def _for_other(self, view: _View, host: str, now: float) -> Peer | None:
        if view.silent is not None and now - view.silent.heard_at >= PEER_SILENT_S:
            return view.silent
        crowded = view.crowded
        if crowded is not None and view.by_host[crowded.host] >= view.by_host[host] + 2:
            return crowded
        return None

    def _look(self, now: float) -> _View:
        peers = list(self._peers())
        others = [peer for peer in peers if not peer.autopilot]
        hosts = Counter(peer.host for peer in others)
        most = max(hosts, key=hosts.__getitem__, default="")
        return _View(
            at=now,
            number=len(peers),
            by_host=Counter(peer.host for peer in peers),
            others=len(others),
            silent=min(others, key=_heard_at, default=None),
            crowded=min((peer for peer in others if peer.host == most), key=_heard_at, default=None),
            silent_autopilot=min((p for p in peers if p.autopilot and not p.kept), key=_heard_at, default=None),
        )


def _heard_at(peer: Peer) -> float:
    return peer.heard_at


BYTES_PER_S = 16_384.0
"""Garbage of one sender that is searched for frames without end. A radio of 115200 baud that carries only noise stays
below it (11,520 B/s)."""

BURST_BYTES = 16_384.0
"""And so much at once: at the 0.1 to 0.4 µs that a byte of garbage takes, 2 to 7 ms."""

PARK_S = 1.0
"""With a quarter of the burst after it, a sender of garbage costs at most 20 kB of searching a second."""


class GarbageGauge:
    """One sender's. ``parkings``: how often it was parked."""

    __slots__ = ("_bucket", "_until", "parkings")

    def __init__(self, now: float) -> None:
        self._bucket = TokenBucket(BYTES_PER_S, BURST_BYTES, now)
        self._until = -math.inf
        self.parkings = 0

    def is_parked(self, now: float) -> bool:
        return now < self._until

    def skipped(self, size: int, now: float) -> bool:
        """Note bytes that were in no frame. True if this parks the sender."""
        self._bucket.spend(size, now)
        if self._bucket.saved(now) >= 0.0 or now < self._until:
            return False
        self._until = now + PARK_S
        self._bucket = TokenBucket(BYTES_PER_S, BURST_BYTES, self._until)
        self._bucket.spend(0.75 * BURST_BYTES, self._until)
        self.parkings += 1
        return True
