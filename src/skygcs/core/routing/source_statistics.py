"""Counters per (link, sysid, compid): frames, bytes, sequence loss.

MAVLink's seq is an 8-bit counter per sender; on a multipoint radio every change of sender would look like loss if it
were counted per link (mavlink-router does), so it is counted per source. docs/explanation/loss.md describes the rule;
the live daemon, its compiled fast path, `tlog info` and `tlog plot` all count with this class.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

WINDOW = 64
"""Sequence numbers on either side of the newest within which a frame is new or late. PX4 1.16 sends frames up to 12
places late (measured: two of its threads take numbers and send). RFC 3550 A.1 allows RTP 100 of 65,536; here each
place more makes it harder to distinguish a late frame from one after an outage, as there are only 256 numbers."""

CONTINUES_WITHIN = 16
"""A frame far off counts once the next frame continues it, with fewer than so many lost in between."""

PAUSE_S = 0.5
"""A sender that rebooted was silent for at least so long: PX4 needs some 2 s, ArduPilot more."""

OUTAGE_S = 2.0
"""After a silence of so long no late frame is expected: radios of one network take turns within 1 s."""

FIRST_NUMBERS = 4
"""A sender that restarts begins with number 0; this many of its first frames may be lost unseen."""

RESTART_S = 10.0
"""A reboot shows in time_boot_ms or a boot text at most so long after the first frame."""

BURST_MAX = 512
"""Frames of one call of `SourceStats.on_burst`."""

UNCOUNTED_COMPIDS = frozenset({190})
"""Mission Planner and QGC relay under component 190 with sequence numbers of several senders."""

RADIO_SOURCE = (51, 68)
"""SiK and RFD900x radios insert RADIO_STATUS as 51/68; RADIO and RADIO_STATUS may come with one sequence number."""

LOSS_WINDOW_S = 30.0
"""Recent losses are those of this time."""

SAMPLE_S = 1.0

LEAST_FRAMES = 20
"""With fewer frames a single lost one is 5 % or more."""

_MASK = (1 << WINDOW) - 1
_RAMP = bytes(range(256)) * 3
"""Every unbroken sequence of up to BURST_MAX numbers stands in it."""


class SourceStats:
    """Statistics of what one source sent over one link.

    Loss is counted with a window of sequence numbers, as RTP receivers keep one (RFC 3550 A.1):

    - a number less than WINDOW past the expected one: those left out are lost;
    - less than WINDOW back and counted as lost: the frame came late, one fewer is lost;
    - less than WINDOW back and not so counted: a repeated frame, which changes nothing;
    - farther off, or back after OUTAGE_S of silence: held. If the next frame continues it (an outage), those left out
      are lost; else it is another sender's and changes nothing;
    - one of the FIRST_NUMBERS after OUTAGE_S of silence: the sender restarted, nothing is lost.

    The numbers have 8 bits: of an outage of n frames n modulo 256 are counted, and none of 254 or 255.
    """

    __slots__ = (
        "_held",
        "_irregular",
        "_lost_before",
        "_mark",
        "_missing",
        "_next",
        "_paused_at",
        "bytes",
        "bytes_per_s",
        "counts_loss",
        "frames",
        "frames_per_s",
        "last_at",
        "lost",
    )

    def __init__(self, sysid: int, compid: int) -> None:
        self.frames = 0
        self.bytes = 0
        self.lost = 0
        self.last_at = 0.0
        self.frames_per_s = 0.0
        self.bytes_per_s = 0.0
        self.counts_loss = compid not in UNCOUNTED_COMPIDS and (sysid, compid) != RADIO_SOURCE
        self._mark = (0.0, 0, 0)
        self._next = -1
        """The expected number; -1: any."""
        self._missing = 0
        """Bit n: the number n + 1 before the expected one is counted as lost and may still come."""
        self._held = -1
        """The number of the newest frame if it is held; -1: it is not."""
        self._irregular = True
        """True if any of these needs to be looked at. False on a link that loses nothing."""
        self._paused_at = float("-inf")
        self._lost_before = 0
        """When the newest jump after a pause was seen, and ``lost`` before it: for `restart`."""

    def on_frame(self, seq: int, size: int, now: float) -> None:
        """Count one frame. Hot: one call per received frame."""
        self.frames += 1
        self.bytes += size
        if self.counts_loss:
            if seq == self._next and not self._irregular:
                self._next = (seq + 1) & 0xFF
            else:
                self._on_irregular(seq, now)
        self.last_at = now

    def on_burst(self, seqs: bytes, size: int, first_at: float, last_at: float) -> None:
        """Count 1 to BURST_MAX frames of ``size`` bytes in all at once; there was no pause of PAUSE_S among them."""
        self.frames += len(seqs)
        self.bytes += size
        if self.counts_loss:
            expected = self._next
            if not self._irregular and _RAMP[expected : expected + len(seqs)] == seqs:
                self._next = (seqs[-1] + 1) & 0xFF
            else:
                self._on_irregular(seqs[0], first_at)
                for seq in seqs[1:]:
                    self._on_irregular(seq, self.last_at)
        self.last_at = last_at

    def restart(self) -> None:
        """The sender rebooted: its sequence restarts, and a jump of its numbers since then is no loss."""
        if self.last_at - self._paused_at < RESTART_S:
            self.lost = min(self.lost, self._lost_before)
        self.resume()

    def resume(self) -> None:
        """Nobody listened for a while: the next number is the expected one, whatever it is."""
        self._expect(-1, 0)

    def _on_irregular(self, seq: int, now: float) -> None:
        """Any frame while something is missing or held, and one that is not the expected one at all times."""
        if self._next < 0:
            self._expect(seq + 1, 0)
            return
        ahead = (seq - self._next) & 0xFF
        if not ahead:
            self._expect(seq + 1, self._missing << 1)
            return
        silence_s = now - self.last_at
        if silence_s >= PAUSE_S:
            self._paused_at, self._lost_before = now, self.lost
        back = 255 - ahead  # 0: the same number again, as some programs send them all
        if silence_s >= OUTAGE_S and back:
            if seq < FIRST_NUMBERS:
                self._expect(seq + 1, 0)
            elif ahead < WINDOW:
                self._jump(ahead, seq)
            else:
                self._hold(seq)
        elif self._held >= 0 and ahead >= WINDOW and back and (seq - self._held - 1) & 0xFF < CONTINUES_WITHIN:
            self._jump((self._held - self._next) & 0xFF, self._held)
            self._jump((seq - self._next) & 0xFF, seq)
        elif ahead < WINDOW:
            self._jump(ahead, seq)
        elif back < WINDOW:
            self._on_back(back)
        else:
            self._hold(seq)

    def _jump(self, left_out: int, seq: int) -> None:
        self.lost += left_out
        self._expect(seq + 1, self._missing << left_out + 1 | ((1 << left_out) - 1) << 1)

    def _on_back(self, back: int) -> None:
        """A late frame, or a repeated one."""
        bit = 1 << back
        self.lost -= bool(self._missing & bit)
        self._expect(self._next, self._missing & ~bit)

    def _hold(self, seq: int) -> None:
        self._held = seq
        self._irregular = True

    def _expect(self, expected: int, missing: int) -> None:
        self._next = expected if expected < 0 else expected & 0xFF
        self._missing = missing & _MASK
        self._held = -1
        self._irregular = expected < 0 or self._missing != 0

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


class LossWindow:
    """Recent loss of a source. Call `sample` once a second with its counters, which may restart at any time. Bounded
    memory."""

    __slots__ = ("_marks",)

    def __init__(self) -> None:
        self._marks: deque[tuple[float, int, int]] = deque(maxlen=int(LOSS_WINDOW_S / SAMPLE_S) + 1)

    def sample(self, frames: int, lost: int, now: float) -> None:
        if self._marks and frames < self._marks[-1][1]:
            self._marks.clear()
        self._marks.append((now, frames, lost))

    def frames(self) -> int:
        """Frames received within the window."""
        return self._marks[-1][1] - self._marks[0][1] if self._marks else 0

    def loss(self) -> float | None:
        """Lost / (received + lost) within the window, 0..1; None with fewer than `LEAST_FRAMES`."""
        frames = self.frames()
        if frames < LEAST_FRAMES:
            return None
        lost = max(0, self._marks[-1][2] - self._marks[0][2])
        return lost / (frames + lost)


@dataclass(frozen=True, slots=True)
class LinkFacts:
    """One link on which a vehicle is heard.

    ``loss``: 0..1 of its frames of the last while, None with too few of them. ``margin_db``: the lower of signal above
    noise at either end of a radio, None without a radio or recent report. Of several vehicles behind one radio the
    margin is the radio's own word for whom it heard last.
    """

    loss: float | None = None
    frames: int = 0
    margin_db: float | None = None
