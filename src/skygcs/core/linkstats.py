"""Counters per (link, sysid, compid): frames, bytes, sequence loss.

MAVLink's seq is an 8-bit counter per sender; on a multipoint radio every change of sender would look like loss if it
were counted per link (mavlink-router does), so it is counted per source.
"""

from __future__ import annotations

from typing import Any

LATE_GAP = 250
"""A gap of 250..255 modulo 256 is a frame up to five places late or repeated, not 250 losses."""

UNCOUNTED_COMPIDS = frozenset({190})
"""Mission Planner and QGC relay under component 190 with sequence numbers of several senders."""

RADIO_SOURCE = (51, 68)
"""SiK radios insert RADIO_STATUS as 51/68; RADIO and RADIO_STATUS may come with one sequence number."""


class SourceStats:
    """What one source sent over one link."""

    __slots__ = (
        "_mark",
        "bytes",
        "bytes_per_s",
        "counts_loss",
        "frames",
        "frames_per_s",
        "last_at",
        "last_seq",
        "lost",
    )

    def __init__(self, sysid: int, compid: int) -> None:
        self.frames = 0
        self.bytes = 0
        self.lost = 0
        self.last_seq = -1
        self.last_at = 0.0
        self.frames_per_s = 0.0
        self.bytes_per_s = 0.0
        self.counts_loss = compid not in UNCOUNTED_COMPIDS and (sysid, compid) != RADIO_SOURCE
        self._mark = (0.0, 0, 0)

    def on_frame(self, seq: int, size: int, now: float) -> None:
        """Count one frame. Hot: one call per received frame."""
        self.frames += 1
        self.bytes += size
        self.last_at = now
        last = self.last_seq
        if seq != (last + 1) & 0xFF and last >= 0 and self.counts_loss:
            gap = (seq - last - 1) & 0xFF
            if gap >= LATE_GAP:
                if gap != 255 and self.lost:
                    self.lost -= 1
                return
            self.lost += gap
        self.last_seq = seq

    def restart(self) -> None:
        """The sender rebooted: its sequence starts anew, which is no loss."""
        self.last_seq = -1

    def sample(self, now: float) -> None:
        """Work out the rates since the last sample; to be called about once a second."""
        then, frames, size = self._mark
        if then and now > then:
            self.frames_per_s = (self.frames - frames) / (now - then)
            self.bytes_per_s = (self.bytes - size) / (now - then)
        self._mark = (now, self.frames, self.bytes)

    @property
    def loss_ratio(self) -> float:
        """Lost / (received + lost), 0..1."""
        total = self.frames + self.lost
        return self.lost / total if total else 0.0

    def as_dict(self, now: float) -> dict[str, Any]:
        return {
            "frames": self.frames,
            "bytes": self.bytes,
            "lost": self.lost,
            "loss_ratio": round(self.loss_ratio, 4),
            "frames_per_s": round(self.frames_per_s, 2),
            "bytes_per_s": round(self.bytes_per_s, 1),
            "age_s": round(now - self.last_at, 3),
        }
