"""Keeps the parameters of vehicles on disk, one file per vehicle, so that a reconnect transfers none; and the tables of
parameter metadata that were read from vehicles, one per build of firmware.

A file that is missing, broken, of another format or of another firmware is ignored. If a file cannot be written, that
is reported once, and the next connection reads the list again.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from skygcs.config.files import open_regular, read_state, write_whole
from skygcs.core.mavlink.dialect import Dialect
from skygcs.core.mavlink.param_encoding import Encoding, Param, ParamType, encoding_of, is_name
from skygcs.core.protocols.parameter_list import MAX_COUNT
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.disk_writer import DiskWriter

FORMAT = 1
"""Version of the file format; files of other versions are ignored."""

MAX_FILES = 256
"""Number of files: one per vehicle of the largest fleet; those unused for longest are removed first."""

MAX_TABLES = 16
"""Tables of parameter metadata: one per firmware build in the fleet."""

MAX_TABLE_BYTES = 4_000_000
"""A table of metadata is not larger: ArduPilot's, of all vehicles, has a tenth of it."""

MAX_FILE_BYTES = 2_000_000
"""Largest file that is read: ten times the largest known."""


@dataclass(frozen=True, slots=True)
class CacheKey:
    """Key of a vehicle's parameters. ``board``: the autopilot's unique id; ``firmware``: its version and commit."""

    autopilot: str
    sysid: int
    compid: int
    board: str
    firmware: str


@dataclass(frozen=True, slots=True)
class CachedParams:
    """Stored parameters. ``hash``: PX4's hash over them; None for autopilots without one: then only their number is
    checked."""

    params: tuple[Param, ...]
    hash: int | None


def default_cache_dir() -> Path | None:
    """$XDG_CACHE_HOME/skygcs/params, by default below ~/.cache; None for a user without a home."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = Path(base) if base else Path.home() / ".cache"
    except RuntimeError:
        return None
    return folder / "skygcs" / "params"


class ParamCache:
    """``folder`` None: nothing is stored. The fleet sets ``disk``, which writes beside the loop."""

    def __init__(self, folder: Path | None) -> None:
        self.disk: DiskWriter | None = None
        self._folder = folder

    def load(self, key: CacheKey) -> CachedParams | None:
        """The parameters stored for this vehicle with this firmware."""
        path = self._path(key)
        if path is None:
            return None
        try:
            cached = read_state(path, MAX_FILE_BYTES, lambda table: _decode(table, key))
            self._write(partial(_touch, path))
        except (OSError, ValueError):
            return None
        return cached

    def store(self, key: CacheKey, cached: CachedParams) -> None:
        """Store it whole or not at all; a cache that cannot be written is read from the vehicle again."""
        path = self._path(key)
        if path is None or len(cached.params) > MAX_COUNT:
            return
        content = json.dumps(_encode(cached, key), separators=(",", ":")).encode()
        self._write(partial(_store, path, content, "*.json", MAX_FILES), len(content))

    def _write(self, job: Callable[[], object], size: int = 0) -> None:
        if self.disk is None:
            with contextlib.suppress(OSError):
                job()
        else:
            self.disk.keep("the parameter cache", job, size)

    def load_table(self, crc: int) -> bytes | None:
        """The table of parameter metadata that was made of a vehicle's file with this CRC."""
        path = self._table_path(crc)
        try:
            if path is None or path.stat().st_size > MAX_TABLE_BYTES:
                return None
            with open_regular(path) as file:
                return file.read(MAX_TABLE_BYTES)
        except OSError:
            return None

    async def store_table(self, crc: int, data: bytes) -> bool:
        """Store a table, if there is a folder for it; the tables unused for longest are removed."""
        path = self._table_path(crc)
        if path is None:
            return False
        job = partial(_store, path, data, "*.tsv", MAX_TABLES)
        try:
            if self.disk is None:
                job()
            else:
                await self.disk.run("parameter metadata", job, len(data))
        except OSError:
            return False
        return True

    def _table_path(self, crc: int) -> Path | None:
        return None if self._folder is None else self._folder / f"metadata-{crc:08x}.tsv"

    def _path(self, key: CacheKey) -> Path | None:
        if self._folder is None:
            return None
        board = re.sub(r"[^0-9A-Za-z]", "", key.board)[:40] or "board"
        return self._folder / f"{key.autopilot}-{key.sysid}-{key.compid}-{board}.json"


def _touch(path: Path) -> None:
    """Note that it is in use."""
    with contextlib.suppress(OSError):
        os.utime(path)


def _store(path: Path, content: bytes, pattern: str, most: int) -> None:
    """Write a file and remove the oldest of its kind beyond ``most``. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, content, 0o600, durable=False)
    files = sorted(path.parent.glob(pattern), key=lambda p: p.stat().st_mtime)
    for old in files[: max(0, len(files) - most)]:
        old.unlink(missing_ok=True)


def _encode(cached: CachedParams, key: CacheKey) -> dict[str, Any]:
    """Floats as hexadecimal text, which is exact; JSON has no NaN."""
    params = [[p.name, int(p.type), p.value if isinstance(p.value, int) else p.value.hex()] for p in cached.params]
    return {"format": FORMAT, "firmware": key.firmware, "hash": cached.hash, "params": params}


def _decode(table: dict[str, Any], key: CacheKey) -> CachedParams | None:
    """Decode a file, for `read_state`."""
    if table["format"] != FORMAT or table["firmware"] != key.firmware:
        return None
    params = tuple(
        Param(name, float.fromhex(value) if isinstance(value, str) else int(value), ParamType(kind))
        for name, kind, value in table["params"]
    )
    if not params or not all(is_name(p.name) for p in params):
        return None
    known = table["hash"]
    return CachedParams(params, None if known is None else int(known))


class ParamBook:
    """Known parameters. ``complete``: the whole list. ``hash``: PX4's hash when they were read; None without one.

    ``recalled``: they come from an earlier run, or from before the vehicle was lost: changes may have been missed.
    ``stale``: a value has changed since the hash was read, so the hash does not confirm the present values.
    """

    def __init__(self, vehicle: Vehicle, dialect: Dialect, cache: ParamCache) -> None:
        self.params: dict[str, Param] = {}
        self.complete = False
        self.hash: int | None = None
        self.stale = False
        self.recalled = False
        self._vehicle = vehicle
        self._dialect = dialect
        self._cache = cache
        self._unsaved = False

    @property
    def encoding(self) -> Encoding:
        """The encoding of whole numbers by the vehicle."""
        fields = self._version_fields()
        return encoding_of(self._vehicle.autopilot, None if fields is None else int(fields["capabilities"]))

    @property
    def capabilities(self) -> int:
        """MAV_PROTOCOL_CAPABILITY bits; 0 while they are unknown."""
        fields = self._version_fields()
        return 0 if fields is None else int(fields["capabilities"])

    def heard(self, param: Param) -> None:
        """The vehicle reported the value of a parameter, to us or to another program."""
        known = self.params.get(param.name)
        if known is not None and known != param:
            self.params[param.name] = param
            self._unsaved = self.stale = True

    def remember(self, params: tuple[Param, ...], hash_: int | None) -> None:
        """A complete list has been read; ``hash_`` None: there is none, or it changed meanwhile."""
        self.params = {p.name: p for p in params}
        self.complete = self._unsaved = True
        self.recalled = False
        self.vouched(hash_)
        self.save()

    def vouched(self, hash_: int | None) -> None:
        """Set the hash of the present values; None: not known."""
        self.hash = hash_
        self.stale = False

    def vouches(self, hash_: int | None) -> bool:
        """True if a hash that the vehicle has just sent confirms the known values."""
        return self.complete and hash_ is not None and hash_ == self.hash and not self.stale

    def recall(self) -> None:
        """Load the stored parameters if nothing is known yet."""
        key = None if self.complete else self._key()
        cached = None if key is None else self._cache.load(key)
        if cached is not None:
            self.params = {p.name: p for p in cached.params}
            self.complete = self.recalled = True
            self.vouched(cached.hash)

    def save(self) -> None:
        """Store the parameters for the next run, if the vehicle will be able to confirm them."""
        key = self._key()
        if self._unsaved and self.complete and key is not None:
            self._unsaved = False
            if self._vehicle.family != "px4" or (self.hash is not None and not self.stale):
                self._cache.store(key, CachedParams(tuple(self.params.values()), self.hash))

    def doubt(self) -> None:
        """The vehicle was lost or has rebooted: the known values need a new confirmation."""
        self.save()
        self.complete = False

    def _key(self) -> CacheKey | None:
        """The cache key; None while the vehicle's firmware is not known."""
        fields = self._version_fields()
        if fields is None:
            return None
        uid2 = bytes(fields.get("uid2") or ())
        board = uid2.hex() if any(uid2) else f"{int(fields.get('uid', 0)):016x}"
        commit = bytes(fields.get("flight_custom_version") or ()).hex()
        firmware = f"{fields.get('flight_sw_version', 0)}-{commit}"
        v = self._vehicle
        return CacheKey(v.family, v.sysid, v.compid, board, firmware)

    def _version_fields(self) -> dict[str, Any] | None:
        info = self._dialect.by_name.get("AUTOPILOT_VERSION")
        slot = None if info is None else self._vehicle.slots.get(info.msgid)
        return None if slot is None or slot.frame is None else slot.frame.fields()
