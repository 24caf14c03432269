"""Log records as structured fields of systemd's journal: its native protocol, one datagram a record."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
from collections.abc import Mapping
from typing import Any

SOCKET = "/run/systemd/journal/socket"

PRIORITIES = {"debug": 7, "info": 6, "warning": 4, "error": 3, "critical": 2}

MAX_VALUE_BYTES = 8192
"""A longer text is cut: a datagram holds some 200 kB."""


def goes_to_journal() -> bool:
    """True if stderr is the journal's stream (systemd sets $JOURNAL_STREAM to its device and inode)."""
    try:
        device, inode = map(int, os.environ["JOURNAL_STREAM"].split(":"))
        status = os.fstat(sys.stderr.fileno())
    except (KeyError, ValueError, OSError):
        return False
    return (status.st_dev, status.st_ino) == (device, inode)


class JournalLogger:
    """Logger that structlog calls with the fields of a record. Never blocks; a record that does not fit is left out."""

    def __init__(self, path: str = SOCKET) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.setblocking(False)

    def msg(self, **record: Any) -> None:
        """Send one record."""
        with contextlib.suppress(OSError):  # the journal is full or gone: there is nowhere to say so
            self._socket.sendto(datagram(record), self._path)

    def close(self) -> None:
        """Close the journal, for tests; the process keeps it to its end."""
        self._socket.close()

    log = debug = info = warn = warning = error = critical = exception = msg


def datagram(record: Mapping[str, Any]) -> bytes:
    """``event`` becomes MESSAGE, ``level`` PRIORITY, every other field SKYGCS_NAME."""
    fields = {
        "MESSAGE": record.get("event", ""),
        "PRIORITY": PRIORITIES.get(str(record.get("level")), 6),
        "SYSLOG_IDENTIFIER": "skygcs",
    }
    fields |= {_name(key): value for key, value in record.items() if key not in ("event", "level", "timestamp")}
    return b"".join(_field(name, str(value)) for name, value in fields.items())


def _name(key: str) -> str:
    """Fields are made of capital letters, digits and underscores."""
    return "SKYGCS_" + "".join(c if c.isascii() and c.isalnum() else "_" for c in key).upper()


def _field(name: str, value: str) -> bytes:
    """A value with a line break is sent with its length, so that it cannot make fields of its own."""
    data = value.encode(errors="replace")[:MAX_VALUE_BYTES]
    if b"\n" in data:
        return name.encode() + b"\n" + len(data).to_bytes(8, "little") + data + b"\n"
    return name.encode() + b"=" + data + b"\n"
