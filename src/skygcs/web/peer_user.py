"""Whose program is at the other end of a connection on this machine.

An address that is opened in a browser is an argument of that browser, which every user of the machine can read. Its
token is good for the same user's browser only.
"""

from __future__ import annotations

import ipaddress
import os
import struct
from pathlib import Path
from typing import Any

TABLES = ("/proc/net/tcp", "/proc/net/tcp6")
LOCAL, REMOTE, UID = 1, 2, 7
"""Columns of the kernel's tables (proc(5)): the two addresses in hexadecimal, and the user of the socket."""


def is_own_user(transport: Any) -> bool:
    """True if the other end is a socket on this machine of the user who runs this process."""
    own, other = transport.get_extra_info("sockname"), transport.get_extra_info("peername")
    if own is None or other is None:
        return False
    wanted = [_hexadecimal(*other[:2]), _hexadecimal(*own[:2])]
    for table in TABLES:
        try:
            rows = [line.split() for line in Path(table).read_text().splitlines()[1:]]
        except OSError:
            continue  # a kernel without this protocol
        for row in rows:
            if row[LOCAL : REMOTE + 1] == wanted:
                return int(row[UID]) == os.geteuid()
    return False


def _hexadecimal(host: str, port: int) -> str:
    """Format as the tables have it: each four bytes of the address as a number of this machine's byte order."""
    packed = ipaddress.ip_address(host.partition("%")[0]).packed
    words = struct.unpack(f"={len(packed) // 4}I", packed)
    return f"{''.join(f'{word:08X}' for word in words)}:{port:04X}"
