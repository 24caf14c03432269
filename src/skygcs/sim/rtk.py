"""Effect of corrections on a simulated vehicle's GPS: its fix shows whether they come as they should.

No satellite is simulated: with the base's position and observations it has a float solution, and after a while a fixed
one, wherever it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skygcs.core.radio_link.corrections import (
    FRAGMENT_BYTES,
    FRAGMENTED,
    MAX_FRAGMENTS,
    MSM_TYPES,
    RtcmDeframer,
    content_of,
)
from skygcs.sim import protocol as m

BASE_TYPES = frozenset({1005, 1006})
OBSERVATION_TYPES = frozenset({*range(1001, 1005), *range(1009, 1013), *MSM_TYPES})

BASE_S = 60.0
OBSERVATIONS_S = 10.0
"""So old the base's position and its observations may be."""

CONVERGENCE_S = 10.0
"""From float to fixed with observations without a gap: what the makers of receivers of two frequencies promise."""


class RtkReceiver:
    """``whole_messages``: ArduPilot hands a message on when it has all fragments of it; PX4 each fragment at once."""

    def __init__(self, *, whole_messages: bool) -> None:
        self.fragments = 0
        self.types: dict[int, int] = {}
        """Sound RTCM messages that reached the receiver, by type."""
        self._whole_messages = whole_messages
        self._deframer = RtcmDeframer()
        self._sequence = -1
        self._parts: dict[int, bytes] = {}
        self._base_at: float | None = None
        self._observed_at: float | None = None
        self._solved_at: float | None = None
        """Since when there has been a float solution."""

    def on_message(self, fields: Mapping[str, Any], now: float) -> None:
        """A GPS_RTCM_DATA."""
        self.fragments += 1
        data = bytes(fields["data"])[: fields["len"]]
        if self._whole_messages:
            data = self._put_together(int(fields["flags"]), data)
        for frame in self._deframer.feed(data):
            type_ = content_of(frame).type
            self.types[type_] = self.types.get(type_, 0) + 1
            self._solve(type_, now)

    def fix_type(self, now: float) -> int:
        """GPS_FIX_TYPE of a receiver that has at least a 3D fix."""
        if not self._fresh(now) or self._solved_at is None:
            return m.GPS_FIX_TYPE_3D_FIX
        fixed = now >= self._solved_at + CONVERGENCE_S
        return m.GPS_FIX_TYPE_RTK_FIXED if fixed else m.GPS_FIX_TYPE_RTK_FLOAT

    def _solve(self, type_: int, now: float) -> None:
        if not self._fresh(now):
            self._solved_at = None
        if type_ in BASE_TYPES:
            self._base_at = now
        if type_ in OBSERVATION_TYPES:
            self._observed_at = now
        if self._solved_at is None and self._fresh(now):
            self._solved_at = now

    def _fresh(self, now: float) -> bool:
        base, observed = self._base_at, self._observed_at
        return base is not None and observed is not None and now <= min(base + BASE_S, observed + OBSERVATIONS_S)

    def _put_together(self, flags: int, data: bytes) -> bytes:
        """AP_GPS::handle_gps_rtcm_fragment."""
        if not flags & FRAGMENTED:
            return data
        number, sequence = flags >> 1 & 0x03, flags >> 3
        if sequence != self._sequence or number in self._parts:
            self._parts.clear()
        self._sequence = sequence
        self._parts[number] = data
        last = MAX_FRAGMENTS - 1 if len(self._parts) == MAX_FRAGMENTS else None
        last = next((n for n, part in self._parts.items() if len(part) < FRAGMENT_BYTES), last)
        if last is None or any(n not in self._parts for n in range(last + 1)):
            return b""
        whole = b"".join(self._parts[n] for n in range(last + 1))
        self._parts.clear()
        return whole
