"""The file of orders from other stations, at the home site: JSON lines, appended, bounded.

    NAME          the present file; at MAX_FILE_BYTES it becomes NAME.1, which replaces the one before
    NAME.1        the one before

A line is written to the system before the order begins, so that a bridge that is killed and started again knows the
key. It is not forced to the disk: a computer that loses its power is away for longer than an order may be late.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path

from skygcs.config.files import open_regular
from skygcs.ext.federation.protocol.audit import AuditRecord, remembered
from skygcs.ext.federation.protocol.order_gate import Remembered

MAX_FILE_BYTES = 8 << 20
"""Some 20,000 orders; there are two such files at most."""

MODE = 0o600


class AuditFile:
    """The file of records. Call `remembered` once, then `append` for each record, from one thread (`DiskWriter`). The
    folder is made when needed."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counters: Counter[str] = Counter()
        """Number of lines written, failed, and unreadable."""
        self._handle: int | None = None
        self._bytes = 0

    def remembered(self) -> tuple[list[Remembered], bool]:
        """The orders in the files, oldest first, and True if there were no older ones, for `OrderGate.restore`. Raises
        OSError if a file exists and cannot be read."""
        lines: list[bytes] = []
        for path in (self._before(), self.path):
            try:
                with open_regular(path) as file:
                    lines += file.read(MAX_FILE_BYTES + (1 << 20)).splitlines()
            except FileNotFoundError:
                continue
        found = []
        for record in remembered(lines):
            if record is None:
                self.counters["unreadable"] += 1
            else:
                found.append(record)
        return found, not self._before().exists()

    def append(self, record: AuditRecord) -> str | None:
        """Write one record. Returns why it could not be written, None if it was. Never raises."""
        line = record.encoded() + b"\n"
        try:
            handle = self._open()
            if self._bytes + len(line) > MAX_FILE_BYTES:
                self.close()
                os.replace(self.path, self._before())
                handle = self._open()
            written = os.write(handle, line)
            self._bytes += written
            if written < len(line):
                raise OSError(f"{written} of {len(line)} bytes written")
        except OSError as error:
            self.counters["failed"] += 1
            self.close()
            return f"{self.path}: {error.strerror or error}"
        self.counters["written"] += 1
        return None

    def close(self) -> None:
        """Close the file. Idempotent; `append` opens it again."""
        handle, self._handle = self._handle, None
        if handle is not None:
            os.close(handle)

    def _before(self) -> Path:
        return self.path.with_name(self.path.name + ".1")

    def _open(self) -> int:
        """Open the file; an incomplete last line gets its newline, so that the next one is readable. Raises OSError."""
        if self._handle is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_CLOEXEC | os.O_NONBLOCK
            self._handle = os.open(self.path, flags, MODE)
            self._bytes = os.fstat(self._handle).st_size
            if self._bytes and os.pread(self._handle, 1, self._bytes - 1) != b"\n":
                self._bytes += os.write(self._handle, b"\n")
        return self._handle
