"""Play a recording over UDP at its recorded pace, for a ground station or another skygcs to watch."""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import SkygcsError
from skygcs.tlog.files import LogFile, note, opened_log
from skygcs.tlog.format import LogEntry
from skygcs.tlog.selection import ReportFilter, Selection
from skygcs.tlog.timeline import Pace

AT_ONCE = 32
"""At full speed, frames between two pauses: 2 kB, which fits a receiver's socket buffer (Linux: 212 kB by default)."""

PAUSE_S = 0.001

SHOWN_EVERY_S = 0.2


@dataclass(slots=True)
class Played:
    sent: int = 0
    held_back: int = 0
    rounds: int = 0
    at_s: float = 0.0

    def __str__(self) -> str:
        text = f"{self.sent:,} frames sent, up to {self.at_s:.1f} s"
        return text if self.rounds < 2 else f"{text}, round {self.rounds}"


class Player:
    """Plays logs to one address. ``clock`` and ``sleep`` are those of `time`."""

    def __init__(
        self,
        address: tuple[str, int],
        speed: float,
        everything: bool,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.played = Played()
        self._speed = speed
        self._everything = everything
        self._clock = clock
        self._sleep = sleep
        self._shown_at = 0.0
        try:
            family, kind, _, _, self._address = _resolved(*address)
            self._socket = socket.socket(family, kind)
        except OSError as error:
            raise SkygcsError(f"{address[0]}:{address[1]}: {error.strerror or error}") from None

    def close(self) -> None:
        self._socket.close()
        _show("")

    def play(self, log: LogFile, selection: Selection) -> int:
        """Play it once, from beginning to end; returns the frames sent. Raises SkygcsError without network."""
        self.played.rounds += 1
        pace = Pace(self._speed)
        began = self._clock()
        sent = 0
        for entry in self._chosen(log, selection):
            at_s = entry.at_s
            wait_s = began + pace.due_s(at_s) - self._clock()
            if self._speed == 0:
                wait_s = PAUSE_S if sent % AT_ONCE == 0 else 0.0
            if wait_s >= PAUSE_S:
                self._sleep(wait_s)
            self._send(entry.raw)
            sent += 1
            self.played.sent += 1
            self.played.at_s = at_s
            self._progress(log, entry)
        return sent

    def _chosen(self, log: LogFile, selection: Selection) -> Iterator[LogEntry]:
        reports = ReportFilter()
        for entry in log.entries():
            passes = self._everything and entry.frame is not None
            passes = reports.passes(entry) or passes  # it also learns from entries before the selected time
            if not selection.takes(entry):
                continue
            if passes:
                yield entry
            else:
                self.played.held_back += 1

    def _send(self, raw: bytes) -> None:
        try:
            self._socket.sendto(raw, self._address)
        except ConnectionRefusedError:
            pass  # no program listens there yet
        except OSError as error:
            raise SkygcsError(f"{self._address[0]}:{self._address[1]}: {error.strerror or error}") from None

    def _progress(self, log: LogFile, entry: LogEntry) -> None:
        now = self._clock()
        if now - self._shown_at >= SHOWN_EVERY_S:
            self._shown_at = now
            _show(f"{log.path.name}: {self.played} ({100 * entry.offset // max(log.size, 1)} % of the file)")


def play_log(
    path: Path,
    address: tuple[str, int],
    selection: Selection,
    speed: float,
    loop: bool,
    everything: bool,
    dialect: Dialect,
) -> str:
    """Play it once, or in a loop until Ctrl-C; returns a line for the user. Raises SkygcsError, KeyboardInterrupt."""
    with opened_log(path, dialect) as log:
        # choose the frames
        log.check_times(selection)
        if log.kind == "raw":
            note(f"{path}: a raw capture has no times: it is played by the times in its messages")
        player = Player(address, speed, everything)
        # play them, once or again and again
        try:
            while player.play(log, selection) and loop:
                pass
            if not player.played.sent:
                raise SkygcsError(
                    f"{path}: nothing to play: the selection has no frame from a vehicle (--all plays everything)"
                )
        except KeyboardInterrupt:
            player.close()
            note(f"ended by Ctrl-C: {player.played}")
            raise
        finally:
            player.close()
        # report
        log.print_faults()
    played = player.played
    if played.held_back and not everything:
        note(f"{played.held_back:,} frames not played: wrong CRCs, orders and other senders (--all plays these two)")
    return f"{path}: {played}"


def _resolved(host: str, port: int) -> tuple[int, int, int, str, Any]:
    return socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]


def _show(text: str) -> None:
    """Show one line that replaces the last one, on a terminal only."""
    if sys.stderr.isatty():
        sys.stderr.write(f"\r\033[K{text}")
        sys.stderr.flush()
