"""The judgement on a sender of bytes that are no MAVLink: when it is parked, and for how long. Pure.

state      leaves it when
---------  -----------------------------------------------------------------------------------------------
heard      it has sent `BURST_BYTES` that are in no frame, and `BYTES_PER_S` for longer: parked
parked     `PARK_S` is over: heard, with a quarter of the burst

A parked sender of datagrams is not ignored: each datagram is read as long as it consists of frames, from its first
byte, which costs as much for a byte of garbage as for 65,535. So an honest program with the same address is heard.
"""

from __future__ import annotations

import math

from skygcs.core.token_bucket import TokenBucket

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
