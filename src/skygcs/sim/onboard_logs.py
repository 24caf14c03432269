"""The onboard logs of a simulated vehicle, and how each firmware sends them.

Read in ArduCopter 4.6.3 (AP_Logger_MAVLinkLogTransfer.cpp) and PX4 1.16.1 (mavlink_log_handler.cpp):

    asked for                ArduCopter                                   PX4
    ----------------------   ------------------------------------------   --------------------------------------------
    anything, while armed    nothing, and once "Disarm for log download"  as while disarmed
    a list                   entries start to end, numbered from 1; none: all entries from start on, numbered from 0;
                             one entry with id 0 and num_logs 0           none: nothing
    data without a list      sent                                         nothing
    data while it sends      nothing                                      the new request takes the place of the old
    data behind the end      one packet with count 0                      nothing
    data of an unknown log   the transfer ends                            the transfer ends
    LOG_REQUEST_END          the transfer ends                            the transfer ends
"""

from __future__ import annotations

import random
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from skygcs.sim import protocol as m
from skygcs.sim.transmitter import Transmitter

BLOCK_BYTES = 90

PACKETS_PER_TICK = 20
"""1,000 a second, 90 kB/s: ArduCopter's SITL sends 40 each time its logging thread runs, PX4 what the link takes."""

MESSAGES = ("LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_REQUEST_END")

SIZES_BYTES = (45_000, 123_457, 8)
"""A multiple of a block, no multiple, and less than one."""

LOG_EVERY_S = 3600
"""The last log began an hour before the vehicle was switched on, the one before an hour earlier."""


@dataclass(frozen=True, slots=True)
class OnboardLog:
    """One log; the same for the same vehicle in each run."""

    data: bytes
    time_unix_s: int


class OnboardLogs:
    """One vehicle's; `hear` takes a request, `step` sends what is due."""

    def __init__(self, tx: Transmitter, sysid: int, *, px4: bool, unix_s: int) -> None:
        self._tx = tx
        self._px4 = px4
        self.logs = [
            OnboardLog(random.Random(1000 * sysid + n).randbytes(size), unix_s - LOG_EVERY_S * (len(SIZES_BYTES) - n))
            for n, size in enumerate(SIZES_BYTES)
        ]
        self._listed = False
        self._warned = False
        self._entries: list[int] = []
        """Indices that are still to be listed."""
        self._sending: int | None = None
        """Index of the log that is being sent, ..."""
        self._at = 0
        """... the next byte, ..."""
        self._until = 0
        """... and the end of what was requested."""

    def reboot(self) -> None:
        """Logs stay, transfers do not."""
        self._listed = self._warned = False
        self._stop()

    def hear(self, name: str, fields: Mapping[str, Any], *, armed: bool) -> None:
        """One of `MESSAGES`."""
        if armed and not self._px4:
            if not self._warned:
                self._warned = True
                self._tx.say(m.MAV_SEVERITY_ERROR, "Disarm for log download")
            return
        self._warned = False
        if name == "LOG_REQUEST_END":
            self._stop()
        elif self._busy and not self._px4:
            return
        elif name == "LOG_REQUEST_LIST":
            self._list(int(fields["start"]), int(fields["end"]))
        else:
            self._read(int(fields["id"]), int(fields["ofs"]), int(fields["count"]))

    def step(self, *, armed: bool) -> None:
        """Send what is due in a tick; an armed ArduCopter waits."""
        if armed and not self._px4:
            return
        for _ in range(PACKETS_PER_TICK):
            if self._entries:
                self._send_entry(self._entries.pop(0))
            elif self._sending is not None:
                self._send_data(self._sending)
            else:
                return

    # -- the inside

    @property
    def _busy(self) -> bool:
        return bool(self._entries) or self._sending is not None

    def _stop(self) -> None:
        self._entries, self._sending = [], None

    def _list(self, start: int, end: int) -> None:
        self._stop()
        self._listed = True
        if self._px4:
            self._entries = list(range(start, len(self.logs)))
        elif not self.logs:
            self._tx.send("LOG_ENTRY", {"id": 0, "num_logs": 0, "last_log_num": 0, "time_utc": 0, "size": 0})
        else:
            last = min(end, len(self.logs))
            self._entries = list(range(max(start, 1) - 1, last)) or [last - 1]

    def _read(self, number: int, offset: int, count: int) -> None:
        if self._px4 and not self._listed:
            return
        self._stop()
        index = number if self._px4 else number - 1
        if not 0 <= index < len(self.logs):
            return
        size = len(self.logs[index].data)
        if offset >= size and self._px4:
            return
        self._sending, self._at, self._until = index, offset, min(offset + count, max(size, offset))

    def _send_entry(self, index: int) -> None:
        log = self.logs[index]
        first = 0 if self._px4 else 1
        entry = {"id": index + first, "num_logs": len(self.logs), "last_log_num": len(self.logs) - 1 + first}
        self._tx.send("LOG_ENTRY", {**entry, "time_utc": log.time_unix_s, "size": len(log.data)})

    def _send_data(self, index: int) -> None:
        end = (
            len(self.logs[index].data) if self._px4 else self._until
        )  # PX4 sends whole packets up to the end of the log
        data = self.logs[index].data[self._at : min(self._at + BLOCK_BYTES, end)]
        number = index if self._px4 else index + 1
        fields = {"id": number, "ofs": self._at, "count": len(data), "data": list(data.ljust(BLOCK_BYTES, b"\0"))}
        self._tx.send("LOG_DATA", fields)
        self._at += len(data)
        if self._at >= self._until or (len(data) < BLOCK_BYTES and not self._px4):
            self._sending = None
