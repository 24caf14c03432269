"""Metadata of one vehicle's parameters: from its own file where it has one, else from the tables that skygcs ships.

A PX4 names its general metadata in COMPONENT_METADATA, and that names the file of its parameters; both come by MAVLink
FTP. They are some 70 kB, so over a slow link they are read only on request. What was read is kept in the cache folder
by the file's CRC, for all vehicles of that build. ArduPilot has no such file on board. Nothing is read when the daemon
starts, and nothing of a table is kept in memory.
"""

from __future__ import annotations

import asyncio
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic_core import from_json

import skygcs.core.params
from skygcs.core.mavlink.param_encoding import Param, Value
from skygcs.core.params.metadata import (
    MetadataTable,
    ParamMetadata,
    ftp_path,
    general_file,
    of_px4,
    table,
)
from skygcs.core.params.names import other_name
from skygcs.core.vehicle.orders import FORCE_HINT
from skygcs.runtime.param_cache import MAX_TABLE_BYTES
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import VehiclePart

MESSAGE = "COMPONENT_METADATA"

MAX_GENERAL_BYTES = 64 << 10
MAX_FILE_BYTES = 1 << 20
"""Compressed; PX4's has 70 kB."""

MAX_JSON_BYTES = 16 << 20
"""Unpacked; PX4's has 1.5 MB."""

MAX_DECODER_BYTES = 80 << 20
"""Memory that the decoder may ask for; PX4's files are packed with xz's preset 9, whose dictionary has 64 MiB. Only
what is unpacked is really used of it."""

SHIPPED = Path(skygcs.core.params.__file__).parent
UNREAD = "it was not read"
XZ_MAGIC = b"\xfd7zXZ\x00"


class NoMetadataError(Exception):
    """Why a vehicle's own file is not used, in a sentence without a subject."""


class VehicleMetadata(VehiclePart):
    """See the module."""

    def __init__(self, actor: VehicleActor) -> None:
        self._vehicle = actor.vehicle
        self._dialect = actor.services.dialect
        self._params = actor.params
        self._request = actor.request
        self._crc: int | None = None
        """CRC of the vehicle's own file, once that was read; None: the shipped table counts."""
        self._uncached = b""
        """Its own table, if that could not be kept on disk."""
        self._why_not = UNREAD
        self._reading = asyncio.Lock()

    def on_reboot(self) -> None:
        """It may have another firmware."""
        self._crc = None
        self._uncached = b""
        self._why_not = UNREAD

    def table(self) -> MetadataTable | None:
        """Its own table, else the shipped one of its firmware; None for a firmware without one. Read from disk."""
        if self._uncached:
            return MetadataTable(self._uncached)
        if self._crc is not None and (data := self._params.cache.load_table(self._crc)) is not None:
            return MetadataTable(data)
        try:
            return MetadataTable((SHIPPED / f"metadata_{self._vehicle.family}.tsv").read_bytes())
        except OSError:
            return None

    def of(self, names: Iterable[str]) -> dict[str, ParamMetadata]:
        """Metadata by name, of those parameters that have any; a parameter of two generations by either name."""
        found = self.table()
        if found is None:
            return {}
        others = {name: other_name(name) or "" for name in names}
        known = found.of([*others, *filter(None, others.values())])
        either = {name: known.get(name) or known.get(other) for name, other in others.items()}
        return {name: entry for name, entry in either.items() if entry is not None}

    def outside(self, params: Iterable[Param]) -> dict[str, str] | None:
        """The sentences about those values that are outside their range, by name; None without a table."""
        found = self.table()
        return None if found is None else found.outside({p.name: p.value for p in params})

    def refusals(self, values: Mapping[str, Value]) -> dict[str, str]:
        """Why values must not be set unless somebody insists, by name: they are outside their range."""
        known = self.of(values)
        outside = {name: entry.outside(values[name]) for name, entry in known.items()}
        return {
            name: f"refused: {why} ({known[name].description}); {FORCE_HINT}" for name, why in outside.items() if why
        }

    def notes(self, values: Mapping[str, Value]) -> dict[str, str]:
        """Return what is to be said of values that were set, by name: a range that was not kept, a reboot that is
        needed."""
        notes = {}
        for name, entry in self.of(values).items():
            said = [entry.outside(values[name]) or entry.without_meaning(values[name])]
            said.append("it takes effect after a reboot" if entry.reboot else "")
            if any(said):
                notes[name] = "; ".join(filter(None, said))
        return notes

    async def read(self, *, insist: bool) -> dict[str, Any]:
        """Read the vehicle's own file, unless that is known, was tried in vain since its start, or its link is slow
        (``insist``: even then). Returns the source of the table that counts now, and why the vehicle's own does not."""
        async with self._reading:
            wanted = insist or (self._why_not == UNREAD and self._params.rate is None)
            if self._crc is None and not self._uncached and wanted:
                try:
                    await self._read()
                except NoMetadataError as error:
                    self._why_not = str(error)
        found = self.table()
        own = self._crc is not None or bool(self._uncached)
        return {
            "own": own,
            "source": "" if found is None else found.source,
            "why_not_own": "" if own else self._why_not,
        }

    async def _read(self) -> None:
        """Find, read and keep the vehicle's own file. Raises NoMetadataError."""
        general = general_file(await self._document(await self._general_path(), MAX_GENERAL_BYTES))
        if general is None:
            raise NoMetadataError("its general metadata name no parameter file")
        if general.crc is not None and self._params.cache.load_table(general.crc) is not None:
            self._crc = general.crc
            return
        packed = await self._file(general.path, MAX_FILE_BYTES)
        data = await asyncio.to_thread(_table_of, packed, self._vehicle.firmware or "")
        # kept for other vehicles only if the content is what the CRC says
        crc = zlib.crc32(packed, 0xFFFFFFFF) ^ 0xFFFFFFFF
        if await self._params.cache.store_table(crc, data):
            self._crc = crc
        else:
            self._uncached = data

    async def _general_path(self) -> str:
        if self._vehicle.family != "px4":
            raise NoMetadataError("its firmware has none on board")
        if MESSAGE not in self._dialect.by_name:
            raise NoMetadataError(f"dialect {self._dialect.name} has no {MESSAGE}")
        outcome = await self._request(MESSAGE)
        slot = self._vehicle.slot(MESSAGE)
        if slot is None or slot.frame is None:
            raise NoMetadataError(f"{MESSAGE}: {outcome.message}")
        path = ftp_path(str(slot.frame.fields()["uri"]))
        if path is None:
            raise NoMetadataError("its general metadata is not on board")
        return path

    async def _document(self, path: str, max_bytes: int) -> Any:
        packed = await self._file(path, max_bytes)
        return await asyncio.to_thread(unpacked, packed)

    async def _file(self, path: str, max_bytes: int) -> bytes:
        outcome = await self._params.file(path, max_bytes=max_bytes)
        if not outcome.ok:
            raise NoMetadataError(f"{path}: {outcome.message}")
        return outcome.data


def unpacked(data: bytes) -> Any:
    """The JSON document of a file that may be compressed by xz. Raises NoMetadataError; bounded in memory."""
    if data.startswith(XZ_MAGIC):
        import lzma  # 0.4 MB of memory, for a file that few vehicles have

        decoder = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=MAX_DECODER_BYTES)
        try:
            data = decoder.decompress(data, MAX_JSON_BYTES)
        except (lzma.LZMAError, EOFError) as error:
            raise NoMetadataError(f"it cannot be unpacked: {error}") from None
        if not decoder.eof:
            raise NoMetadataError(f"it is not whole, or larger than {MAX_JSON_BYTES >> 20} MiB")
    try:
        return from_json(data)
    except ValueError as error:
        raise NoMetadataError(f"it is not JSON: {error}") from None


def _table_of(packed: bytes, firmware: str) -> bytes:
    """The table of a vehicle's file. Raises NoMetadataError."""
    data = table(of_px4(unpacked(packed)), f"the vehicle's own file{f' ({firmware})' if firmware else ''}")
    if data.count(b"\n") < 2 or len(data) > MAX_TABLE_BYTES:
        raise NoMetadataError("it has no parameters, or too many")
    return data
