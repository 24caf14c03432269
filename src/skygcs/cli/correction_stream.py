"""Streams RTCM to the daemon as it comes, and tells what went."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import os
import socket
from collections import Counter
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from typing import Any

from skygcs.errors import RpcError
from skygcs.rpc.client import Client

PIECE_BYTES = 32768
"""Of one call; its base64 is within what corrections.send takes."""

STEPS_PER_S = 10
"""A recorded file goes in so many pieces a second."""

DOUBTFUL_BYTES = 2000
"""So much without a message: a base sends one within 1,029 bytes."""

MAX_SOURCE_CHARS = 64

NO_LINK = "no link that may carry vehicles is open: what comes now goes nowhere"
LINK_AGAIN = "it goes to the vehicles again"
NOT_TAKEN = "no link took a message: the vehicles' link is full or down (skygcs-cli links)"
TOO_LONG = (
    "a message of more than 720 bytes does not go into GPS_RTCM_DATA and is left out: have the base send MSM4 instead "
    "of MSM7, or fewer constellations"
)
NO_RTCM = (
    "no RTCM 3 message in what has come so far: is it RTCM 3 (and not RTCM 2, NMEA, UBX or what a caster says of an "
    "error)?"
)


@dataclass
class Tally:
    """What was read and what became of it."""

    read_bytes: int = 0
    counts: Counter[str] = field(default_factory=Counter)
    """As corrections.send tells: messages, bytes, refused, too_long, bad_crc, skipped_bytes."""
    types: Counter[str] = field(default_factory=Counter)

    def as_dict(self) -> dict[str, Any]:
        names = ("messages", "bytes", "refused", "too_long", "bad_crc", "skipped_bytes")
        types = {type_: self.types[type_] for type_ in sorted(self.types, key=int)}
        return {"read_bytes": self.read_bytes, **{name: self.counts[name] for name in names}, "types": types}


class Stream:
    """Hands pieces to the daemon one after the other; ``tell(text)`` gets what a person should do something about."""

    def __init__(self, gcs: Client, tell: Callable[[str], None]) -> None:
        self.tally = Tally()
        self._gcs = gcs
        self._tell = tell
        self._source = f"skygcs-cli {os.getpid()} on {socket.gethostname()}"[:MAX_SOURCE_CHARS]
        self._told: set[str] = set()
        self._linked = True

    async def send(self, data: bytes) -> None:
        """Raises RpcError while another source sends."""
        for at in range(0, len(data), PIECE_BYTES):
            piece = data[at : at + PIECE_BYTES]
            text = base64.b64encode(piece).decode("ascii")
            self.tally.read_bytes += len(
                piece
            )  # before the answer: who interrupts the waiting has read it all the same
            taken = await self._gcs.call("corrections.send", data=text, source=self._source)
            self.tally.types.update(taken.pop("types"))
            links = taken.pop("links")
            self.tally.counts.update(taken)
            self._tell_news(taken, links)

    async def end(self) -> None:
        """Another source may follow at once. Whoever cannot be told finds out by our silence."""
        with contextlib.suppress(RpcError):
            await self._gcs.call("corrections.send", data="", source=self._source, end=True)

    def _tell_news(self, taken: dict[str, int], links: int) -> None:
        if (links > 0) != self._linked:
            self._linked = links > 0
            self._tell(LINK_AGAIN if links else NO_LINK)
        elif taken["refused"] and links:
            self._once(NOT_TAKEN)
        if taken["too_long"]:
            self._once(TOO_LONG)
        counts = self.tally.counts
        if self.tally.read_bytes >= DOUBTFUL_BYTES and not any(counts[n] for n in ("messages", "refused", "too_long")):
            self._once(NO_RTCM)

    def _once(self, text: str) -> None:
        if text not in self._told:
            self._told.add(text)
            self._tell(text)


async def forward(
    stream: Stream, source: AsyncIterator[bytes], show: Callable[[Tally, float], None], every_s: float
) -> None:
    """All that ``source`` brings; every ``every_s`` ``show`` gets the tally and the RTCM bytes per second since."""

    async def watch() -> None:
        before = 0
        while True:
            await asyncio.sleep(every_s)
            now = stream.tally.counts["bytes"]
            show(stream.tally, (now - before) / every_s)
            before = now

    watching = asyncio.create_task(watch(), name="what went")
    try:
        async for data in source:
            await stream.send(data)
    finally:
        watching.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await watching


async def at_rate(source: AsyncIterator[bytes], bytes_per_s: float) -> AsyncIterator[bytes]:
    """The same bytes, no faster."""
    clock = asyncio.get_running_loop().time
    size = max(1, round(bytes_per_s / STEPS_PER_S))
    due = clock()
    async for data in source:
        for at in range(0, len(data), size):
            piece = data[at : at + size]
            yield piece
            due += len(piece) / bytes_per_s
            await asyncio.sleep(max(0.0, due - clock()))


def line_of(tally: Tally, bytes_per_s: float | None) -> str:
    """What went, in one line."""
    counts = tally.counts
    rate = "" if bytes_per_s is None else f", {bytes_per_s:,.0f} B/s"
    types = " ".join(f"{type_}:{tally.types[type_]:,}" for type_ in sorted(tally.types, key=int))
    flaws = (
        ("not taken", counts["refused"]),
        ("too long", counts["too_long"]),
        ("damaged", counts["bad_crc"]),
        ("bytes skipped", counts["skipped_bytes"]),
    )
    told = "".join(f", {count:,} {what}" for what, count in flaws if count)
    messages = f"{counts['messages']:,} message{'s' if counts['messages'] != 1 else ''}"
    return f"{messages}, {counts['bytes']:,} B{rate}{told}{'  ' if types else ''}{types}"
