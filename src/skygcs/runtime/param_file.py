"""All parameters of an ArduPilot as one file instead of one message each: when that is done, and what comes of it.

It costs less on every link, by the frames of MAVLink 2, for each parameter of the 1397 of an ArduCopter 4.6:

    one by one   37 B PARAM_VALUE down, 16 B PARAM_REQUEST_READ up                  53 B    74 kB together
    by file      some 12 B of the file, in packets of 239 B that are 266 B long,
                 each asked for with 27 B: 12 * (266 + 27) / 239                    15 B    21 kB

A long frame is lost more easily. Where of the short ones a part q is lost, of the long ones it is 1 - (1 - q) ** 7.2
(by their lengths), so that the file costs 15 / (1 - q) ** 7.2 and the other way 53 / (1 - q): the file is dearer beyond
18 %, which is no link to read a list over. So the file is taken wherever it is offered.

A burst goes at the pace that the autopilot takes for the link's (a third of a serial port, all of it where the port has
flow control, as radios have): it is not asked for where a thin link is in the way, but read in turns of bytes_per_s.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.ftp_payload import CAPABILITY_FTP, MESSAGE
from skygcs.core.mavlink.param_encoding import Param
from skygcs.core.params import pck
from skygcs.core.protocols.file_download import FileDownload, FileOutcome
from skygcs.core.protocols.parameter_list import BYTES_PER_S, ListProgress
from skygcs.core.vehicle.vehicle import Vehicle

GUESSED_BYTES = 12
"""Bytes of a parameter: ArduPilot estimates with it the size that it reports when the file is opened."""


def offered(vehicle: Vehicle, dialect: Dialect, capabilities: int) -> bool:
    """Whether the vehicle says that it serves files, and has this one."""
    return vehicle.family == "ardupilot" and bool(capabilities & CAPABILITY_FTP) and MESSAGE in dialect.by_name


def download(session: int, *, burst: bool, bytes_per_s: float | None, link_bytes_per_s: float) -> FileDownload:
    """``link_bytes_per_s``: what the narrowest link in the way leaves, infinite where none is known to be thin. There
    it comes at once, unless a rate below that of a narrow link is requested."""
    wide = math.isinf(link_bytes_per_s) and (bytes_per_s is None or bytes_per_s >= BYTES_PER_S)
    return FileDownload(
        pck.PATH,
        session=session,
        max_bytes=pck.MAX_BYTES,
        burst=burst or wide,
        bytes_per_s=None if wide else bytes_per_s,
    )


def progress_of(exchange: FileDownload, now: float) -> ListProgress:
    """In parameters, as far as the vehicle's guess of the file's size goes."""
    progress = exchange.progress(now)
    count = None if progress.size is None else progress.size // GUESSED_BYTES
    received = progress.received // GUESSED_BYTES
    return ListProgress(
        received if count is None else min(received, count), count, progress.sent, progress.elapsed_s, None
    )


def params_of(outcome: FileOutcome, heard: Mapping[str, Param]) -> tuple[Param, ...]:
    """All parameters; ``heard``: what the vehicle said while it was read, which is newer. Raises ValueError, for a
    person, if they are not all there."""
    if not outcome.ok:
        raise ValueError(outcome.message)
    held = pck.decode(outcome.data)
    if not held.params or len(held.params) != held.total:
        raise ValueError(f"it holds {len(held.params)} of {held.total} parameters")
    return tuple(heard.get(p.name, p) for p in held.params)
