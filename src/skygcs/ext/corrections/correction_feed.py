"""Sends RTCM from RPC clients to all vehicles, in whole frames, as GPS_RTCM_DATA of our own.

GPS_RTCM_DATA that a ground station sends is routed like any other message. `core.radio_link.corrections` decides how
much of both a slow radio carries.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from skygcs.core.radio_link.corrections import (
    MAX_MESSAGE_BYTES,
    MAX_TYPES,
    SOURCE_SILENT_S,
    RtcmDeframer,
    content_of,
    fragments_of,
)
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.token_bucket import TokenBucket
from skygcs.core.vehicle.gate import standing
from skygcs.errors import RefusedError
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub

CORRECTIONS = standing("corrections")

GPS = frozenset({"gps"})
"""All of a vehicle's state takes 0.1 ms to make, for which control would wait by 25 ms with 250 vehicles."""

RATE_S = 10.0
"""Time over which the rate is measured: about the period of a base's slowest messages."""

MESSAGES_PER_S, MESSAGE_BURST = 200.0, 1000.0
"""A base with four constellations sends ten messages a second, at 10 Hz a hundred; each goes to every link and takes 20
to 50 µs of the loop for each. What is beyond is refused: the newest of a flood is worth no more than the oldest."""

MAX_RECENT = round(MESSAGES_PER_S * RATE_S + MESSAGE_BURST)
"""Messages kept for the rate: all that are admitted within its time."""


class CorrectionFeed:
    """One RTCM stream at a time, in pieces of any length."""

    def __init__(self, hub: Hub, fleet: Fleet, clock: Callable[[], float]) -> None:
        self._hub = hub
        self._fleet = fleet
        self._clock = clock
        self._info = hub.dialect.by_name.get("GPS_RTCM_DATA")
        self._source: str | None = None
        self._offered_at = 0.0
        self._deframer = RtcmDeframer()
        self._sequence = 0
        self._last_at: float | None = None
        self._sent = dict.fromkeys(("messages", "bytes", "refused", "too_long", "bad_crc", "skipped_bytes"), 0)
        self._types: dict[int, list[float]] = {}
        """Messages, bytes and time of the last one, by RTCM type."""
        self.own_source: Callable[[], dict[str, Any]] | None = None
        """The status of the source that this daemon asks itself ([corrections]); None: it has none."""
        self._recent: deque[tuple[float, int]] = deque(maxlen=MAX_RECENT)
        self._rate = TokenBucket(MESSAGES_PER_S, MESSAGE_BURST, clock())

    def send(self, source: str, data: bytes, *, end: bool = False) -> dict[str, Any]:
        """Take the next piece of the stream of ``source`` (``end``: the last one); returns the result for the messages
        it completed. Raises RefusedError while another source streams, and without GPS_RTCM_DATA in the dialect.
        """
        now = self._clock()
        self._follow(source, now)
        before = dict(self._sent)
        channels = len(self._hub.channels_to(0, 0))
        types: dict[int, int] = {}
        bad_crc, skipped = self._deframer.bad_crc, self._deframer.skipped_bytes
        for message in self._deframer.feed(data):
            if len(message) > MAX_MESSAGE_BYTES:
                self._sent["too_long"] += 1
            elif not (self._rate.take(now) and self._spread(message)):
                self._sent["refused"] += 1
            else:
                type_ = content_of(message).type
                types[type_] = types.get(type_, 0) + 1
                self._note(type_, len(message), now)
        self._sent["bad_crc"] += self._deframer.bad_crc - bad_crc
        self._sent["skipped_bytes"] += self._deframer.skipped_bytes - skipped
        if end:
            self._source = None
        return {
            **{name: count - before[name] for name, count in self._sent.items()},
            "types": {str(type_): count for type_, count in sorted(types.items())},
            "links": channels,
        }

    def woke(self) -> None:
        """After a sleep or a standstill: a message of which only a part came is not continued by what comes now."""
        self._deframer.drop_held()

    @property
    def totals(self) -> dict[str, int]:
        """Messages and bytes sent since the daemon's start, and what was refused or damaged."""
        return dict(self._sent)

    def age_s(self) -> float | None:
        """Time since the last message; None before the first."""
        return None if self._last_at is None else self._clock() - self._last_at

    def status(self) -> dict[str, Any]:
        """Messages sent since the daemon's start, those that each radio carried, and the fix of each vehicle."""
        now = self._clock()
        fixes = self._fixes(now)
        while self._recent and self._recent[0][0] < now - RATE_S:
            self._recent.popleft()
        return {
            "source": self._source if now < self._offered_at + SOURCE_SILENT_S else None,
            "age_s": None if self._last_at is None else round(now - self._last_at, 2),
            "bytes_per_s": round(sum(size for _, size in self._recent) / RATE_S, 1),
            **self._sent,
            "types": {
                str(type_): {"messages": int(count), "bytes": int(size), "age_s": round(now - at, 2)}
                for type_, (count, size, at) in sorted(self._types.items())
            },
            "radios": [
                {
                    "link": channel.link.name,
                    "peer": channel.peer,
                    **(status := channel.air.corrections.status()),
                    "source": None
                    if status["source"] is None
                    else f"{status['source'] >> 8}/{status['source'] & 0xFF}",
                }
                for channel in self._hub.channels.values()
                if channel.air is not None
            ],
            "vehicles": fixes,
            "rtk_float": sum(vehicle["fix"] == "rtk_float" for vehicle in fixes),
            "rtk_fixed": sum(vehicle["fix"] == "rtk_fixed" for vehicle in fixes),
            "own_source": None if self.own_source is None else self.own_source(),
        }

    def _follow(self, source: str, now: float) -> None:
        """Refuse a second stream: pieces of two streams cannot be joined, and receivers follow one base."""
        if self._info is None:
            raise RefusedError(
                f"the dialect {self._hub.dialect.name} has no GPS_RTCM_DATA: choose one that includes common.xml"
            )
        if source != self._source:
            if self._source is not None and now < self._offered_at + SOURCE_SILENT_S:
                raise RefusedError(
                    f"{self._source} sends corrections already (last {now - self._offered_at:.1f} s ago), and "
                    f"receivers follow one base: end that one, or wait until it was silent for {SOURCE_SILENT_S:g} s"
                )
            self._source = source
            self._deframer = RtcmDeframer()
        self._offered_at = now

    def _spread(self, message: bytes) -> bool:
        """True if every fragment was taken by some link."""
        assert self._info is not None
        self._sequence += 1
        taken = True
        for values in fragments_of(message, self._sequence):
            taken &= self._hub.send(self._info, values, 0, 0, Priority.CORRECTION, clearance=CORRECTIONS)
        return taken

    def _note(self, type_: int, size: int, now: float) -> None:
        self._sent["messages"] += 1
        self._sent["bytes"] += size
        self._last_at = now
        self._recent.append((now, size))
        if type_ in self._types or len(self._types) < MAX_TYPES:
            count, total, _ = self._types.get(type_, (0, 0, 0.0))
            self._types[type_] = [count + 1, total + size, now]

    def _fixes(self, now: float) -> list[dict[str, Any]]:
        """Fix by vehicle; None without GPS_RAW_INT."""
        fixes = []
        for _, actor in sorted(self._fleet.vehicles.items()):
            gps = actor.state(now, GPS)["gps"] or {}
            fixes.append({"name": actor.name, "fix": gps.get("fix"), "satellites": gps.get("satellites")})
        return fixes
