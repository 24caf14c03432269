"""Reading of links: how much one wake-up may take, so that no turn of the loop is long whatever is sent to us.

All links of a hub share one `ReadingTurns`. A reader is what the loop calls when a descriptor can be read: one per
socket, connection or port. It is called again in the next turn of the loop while there is more, so that timers, control
ticks and orders have their turns in between.
"""

from __future__ import annotations

import weakref
from collections.abc import Hashable
from typing import NamedTuple

LARGEST_DATAGRAM_BYTES = 12_288
"""A longer datagram is dropped and counted. Programs send a frame (280 bytes), or fill a packet of the network: 1,472
bytes, 8,972 with jumbo frames; on one computer 300 frames of the usual 40 bytes fit."""

TURN_BYTES = 16_384
"""Taken in one turn of the loop by all readers together: 0.2 µs per byte as small frames, up to 0.4 as garbage that is
made to cost, hence 2 to 6 ms."""

TURN_S = 0.005
"""The same as a time, for a slow or busy computer: a turn ends with the datagram that exceeds it."""

LEAST_BYTES = 256
"""Least share of one reader, about one frame: with 64 readers that are all flooded a turn takes 16 kB."""


class Share(NamedTuple):
    """Share that one wake-up may take. At least one datagram, or one read of ``bytes``."""

    bytes: int
    seconds: float


class ReadingTurns:
    """Shares the bytes and the time of a turn among the readers that have something to read."""

    def __init__(self) -> None:
        self._seen: weakref.WeakSet[Hashable] = weakref.WeakSet()
        self._readers = 1
        self._share = Share(TURN_BYTES, TURN_S)

    def share(self, reader: Hashable) -> Share:
        """The share of a reader that the loop has called. A turn is over when one is called for the second time; each
        gets its part by the number of readers in the turn before."""
        seen = self._seen
        if reader in seen:
            self._end_turn(len(seen))
            seen.clear()
        seen.add(reader)
        return self._share

    def _end_turn(self, readers: int) -> None:
        if readers != self._readers:
            self._readers = readers
            self._share = Share(max(LEAST_BYTES, TURN_BYTES // readers), TURN_S / readers)
