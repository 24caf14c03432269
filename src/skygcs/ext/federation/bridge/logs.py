"""Logs of other sites: `SiteLogs` offers those of a site, `LogCollector` collects them at another station.

The files go through the object store of the hub, a part at a time:

    the station asks log.<site>                        the site answers
    ------------------------------------------------   ---------------------------------------------------------------
    {"list": {"since_unix_s"}}                         {"files": [{name, bytes, modified_unix_s}], "more"}
    {"part": {"name", "offset"}}                       {"object", "bytes"}: up to PART_BYTES of the file, from the
                                                       offset, are in the store under this name, with their SHA-256
    {"sum": {"name", "bytes"}}                         {"sha256"} of the first ``bytes`` bytes of the file

    the file at this station     at the site           result
    --------------------------   -------------------   ---------------------------------------------------------------
    of the same length           there                 left as it is
    shorter, or NAME.part        there                 continued where it ends
    complete                     of another SHA-256    deleted and reported; the next collection begins anew
    longer than at the site      there                 left as it is, and reported

A site offers one part at a time, so that states and orders are not delayed; the store deletes it after an hour. A log
that is still being written is collected up to its length in the list; a later collection continues it.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import hashlib
import os
import re
import stat
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from nats.js.api import ObjectInfo
from nats.js.errors import BadObjectMetaError, NotFoundError
from nats.js.object_store import ObjectStore
from pydantic_core import from_json, to_json

from skygcs.config.files import open_regular
from skygcs.errors import BusError, SkygcsError
from skygcs.ext.federation.bridge.bus import Bus, Message, store_errors
from skygcs.ext.federation.bridge.hub_config import LOGS
from skygcs.ext.federation.protocol.received_json import cleaned, printable

PART_BYTES = 2 << 20
"""Size of a part: 16 messages of the store, two seconds at 10 Mbit/s. A lost connection loses at most one part."""

MAX_FILES = 1000
"""Files of one list; the oldest are left out."""

MAX_FILE_BYTES = 1 << 40
"""Largest length of a file that is accepted from a list."""

MAX_WAITING = 4
"""Requests that wait while another one is carried out; further ones are refused."""

LIST_WITHIN_S, PART_WITHIN_S, SUM_WITHIN_S = 10.0, 60.0, 300.0
"""Time limits of the answers to the three requests."""

RETRIES, RETRY_AFTER_S = 5, 2.0
"""Attempts for one part, and the pause between them, after a lost answer or a damaged part."""

MAX_CHUNKS = 256
"""Messages of the store with one part; nats-py makes 16."""

OBJECT_NAME = re.compile(r"[A-Za-z0-9._-]{1,128}", re.ASCII)
NUID = re.compile(r"[A-Za-z0-9_-]{1,64}", re.ASCII)
"""Names of an object and of its content in the store, as `SiteLogs` and nats-py make them."""

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,127}\.tlog", re.ASCII)

STREAM = f"OBJ_{LOGS}"


class SiteLogs:
    """A part of the bridge: offers the logs of ``folder``. Run `run` in a task."""

    def __init__(self, bus: Bus, site: str, run_id: str, folder: Path) -> None:
        self.counters: Counter[str] = Counter()
        self._bus = bus
        self._site = site
        self._run_id = run_id
        self._folder = folder
        self._busy = asyncio.Lock()
        self._waiting = 0

    async def run(self) -> None:
        """Until it is cancelled."""
        subscription = await self._bus.serve(f"log.{self._site}", self._answer)
        try:
            await asyncio.Event().wait()
        finally:
            await subscription.close()

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        return {"folder": str(self._folder), "waiting": self._waiting, **self.counters}

    async def _answer(self, message: Message) -> bytes:
        """The answer to one request as JSON; a request that fails is answered with {"error"}."""
        if self._waiting > MAX_WAITING:
            self.counters["refused"] += 1
            return to_json({"error": "busy: others collect logs; ask again"})
        self._waiting += 1
        try:
            async with self._busy:
                return to_json(await self._answered(message.data))
        except (OSError, ValueError, SkygcsError) as error:
            self.counters["errors"] += 1
            return to_json({"error": f"{self._site}: {getattr(error, 'strerror', None) or error}"})
        finally:
            self._waiting -= 1

    async def _answered(self, data: bytes) -> dict[str, Any]:
        asked = from_json(data, allow_inf_nan=False)
        match asked:
            case {"list": {"since_unix_s": int() | float() as since_unix_s}}:
                files = await asyncio.to_thread(list_files, self._folder, since_unix_s)
                self.counters["lists"] += 1
                return {"files": files[:MAX_FILES], "more": len(files) > MAX_FILES}
            case {"part": {"name": str() as name, "offset": int() as offset}}:
                return await self._offer(self._path(name), offset)
            case {"sum": {"name": str() as name, "bytes": int() as length}}:
                sha256 = await asyncio.to_thread(sha256_of, self._path(name), length)
                return {"sha256": sha256}
        raise ValueError("the request is not for a list, part or sum")

    async def _offer(self, path: Path, offset: int) -> dict[str, Any]:
        """Put a part of a file into the store, under a name that was never used before."""
        data = await asyncio.to_thread(read_part, path, offset)
        self.counters["parts"] += 1
        self.counters["bytes"] += len(data)
        name = f"{self._site}.{self._run_id}.{self.counters['parts']}"
        store = await self._bus.object_store(LOGS)
        with store_errors(LOGS):
            await store.put(name, data)
        return {"object": name, "bytes": len(data)}

    def _path(self, name: str) -> Path:
        """The path of a log. Raises ValueError for any other name, so that no other file can be requested."""
        if FILE_NAME.fullmatch(name) is None:
            raise ValueError(f"{name[:80]!r} is not a name of a log")
        return self._folder / name


def list_files(folder: Path, since_unix_s: float) -> list[dict[str, Any]]:
    """Name, length and time of the logs of a folder that were modified since then, the newest first."""
    found = []
    with contextlib.suppress(FileNotFoundError), os.scandir(folder) as entries:
        for entry in entries:
            if FILE_NAME.fullmatch(entry.name) is None:
                continue
            try:
                status = entry.stat(follow_symlinks=False)
            except FileNotFoundError:  # removed meanwhile: the others are listed all the same
                continue
            if stat.S_ISREG(status.st_mode) and status.st_mtime >= since_unix_s:
                found.append({"name": entry.name, "bytes": status.st_size, "modified_unix_s": status.st_mtime})
    return sorted(found, key=lambda file: -file["modified_unix_s"])


def read_part(path: Path, offset: int) -> bytes:
    """The part of a log from ``offset``. Raises OSError, and ValueError for an offset beyond its end."""
    with open_regular(path) as file:
        if not 0 <= offset <= os.fstat(file.fileno()).st_size:
            raise ValueError(f"{path.name} has no byte {offset}")
        file.seek(offset)
        return file.read(PART_BYTES)


def sha256_of(path: Path, length: int) -> str:
    """The SHA-256 of the first ``length`` bytes. Raises OSError, and ValueError for a file that is shorter."""
    digest = hashlib.sha256()
    with open_regular(path) as file:
        left = length
        while left > 0:
            data = file.read(min(left, PART_BYTES))
            if not data:
                raise ValueError(f"{path.name} is shorter than {length} bytes")
            digest.update(data)
            left -= len(data)
    return digest.hexdigest()


# --- the station that collects ----------------------------------------------------------------------------------------


@dataclass(slots=True)
class Collected:
    """The result of one collection."""

    files: list[Path] = field(default_factory=list)
    """Listed files that are complete at this station now."""
    fetched_bytes: int = 0
    problems: list[str] = field(default_factory=list)


class LogCollector:
    """Collects logs of other sites into FOLDER/SITE/. ``show``: called with a line of text for each file."""

    def __init__(self, bus: Bus, folder: Path, show: Callable[[str], None]) -> None:
        self._bus = bus
        self._folder = folder
        self._show = show
        self._done = Collected()

    async def collect(self, sites: Sequence[str], since_unix_s: float = 0.0) -> Collected:
        """Collect from one site after the other; a problem of one site does not stop the others."""
        for site in sites:
            try:
                await self._collect_site(site, since_unix_s)
            except SkygcsError as error:
                self._done.problems.append(f"{site}: {error}")
        return self._done

    async def _collect_site(self, site: str, since_unix_s: float) -> None:
        answer = await self._ask(site, {"list": {"since_unix_s": since_unix_s}}, LIST_WITHIN_S)
        files = list(_listed(answer))
        if answer.get("more"):
            self._done.problems.append(f"{site} has more than {MAX_FILES} logs: the oldest are left out (--since)")
        self._show(f"{site}: {len(files)} {'log' if len(files) == 1 else 'logs'}")
        for name, size, modified_unix_s in files:
            try:
                await self._collect_file(site, name, size, modified_unix_s)
            except (SkygcsError, OSError) as error:
                self._done.problems.append(f"{site}/{name}: {getattr(error, 'strerror', None) or error}")

    async def _collect_file(self, site: str, name: str, size: int, modified_unix_s: float) -> None:
        target = self._folder / site / name
        part = target.with_name(name + ".part")
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            have = target.stat().st_size
            if have > size:
                raise SkygcsError(f"{target} is longer than at the site; it is left as it is")
            if have == size:
                self._done.files.append(target)
                return
            target.replace(part)
        await self._fetch(site, name, size, part)
        wanted = await self._ask(site, {"sum": {"name": name, "bytes": size}}, SUM_WITHIN_S)
        if await asyncio.to_thread(sha256_of, part, size) != wanted.get("sha256"):
            part.unlink()
            raise SkygcsError("it differs from the one at the site, and was discarded; collect again")
        os.utime(part, (modified_unix_s, modified_unix_s))
        part.replace(target)
        self._done.files.append(target)
        self._show(f"{site}/{name}  {size / 1e6:.1f} MB")

    async def _fetch(self, site: str, name: str, size: int, part: Path) -> None:
        """Append the missing parts of a file."""
        offset = await asyncio.to_thread(length_to_continue, part, size)
        while offset < size:
            data = (await self._part(site, name, offset))[: size - offset]
            if not data:
                raise SkygcsError(f"it ends at {offset} bytes; it was listed with {size}")
            await asyncio.to_thread(append, part, data)
            offset += len(data)
            self._done.fetched_bytes += len(data)

    async def _part(self, site: str, name: str, offset: int) -> bytes:
        for attempt in range(RETRIES):
            try:
                answer = await self._ask(site, {"part": {"name": name, "offset": offset}}, PART_WITHIN_S)
                return await self._read_object(answer.get("object"))
            except BusError:
                if attempt == RETRIES - 1:
                    raise
            await asyncio.sleep(RETRY_AFTER_S)
        raise AssertionError("not reached")

    async def _read_object(self, name: object) -> bytes:
        """The content of an object of the store. ObjectStore.get is not used, because it needs a consumer, which the
        hub permits to no station. Raises BusError, also for content whose SHA-256 is wrong, and SkygcsError for what is
        no object of a site's, which another attempt would not change."""
        if not isinstance(name, str) or OBJECT_NAME.fullmatch(name) is None:
            raise SkygcsError("the site sent an invalid name of an object")
        store: ObjectStore = await self._bus.object_store(LOGS)
        jetstream = self._bus.jetstream()
        with store_errors(LOGS):
            try:
                info = await store.get_info(name)
                data, sequence = bytearray(), 1
                for _ in range(_chunks(info)):
                    subject = f"$O.{LOGS}.C.{info.nuid}"
                    message = await jetstream.get_msg(STREAM, seq=sequence, subject=subject, next=True)
                    data += message.data or b""
                    if len(data) > PART_BYTES:
                        raise BusError(LOGS, f"{name} is longer than a part")
                    sequence = (message.seq or 0) + 1
            except NotFoundError:
                raise BusError(LOGS, f"the hub has no {name} any more") from None
            except BadObjectMetaError:
                raise SkygcsError("the object in the store is not a part of a log") from None
        digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).decode()
        if info.digest != f"SHA-256={digest}":
            raise BusError(LOGS, f"{name} was changed in the store")
        return bytes(data)

    async def _ask(self, site: str, question: dict[str, Any], within_s: float) -> dict[str, Any]:
        answer = await self._bus.request(f"log.{site}", to_json(question), within_s)
        try:
            found = cleaned(from_json(answer, allow_inf_nan=False))
        except ValueError:
            found = None
        if not isinstance(found, dict):
            raise SkygcsError(f"{site} sent an answer that cannot be read")
        if "error" in found:
            raise SkygcsError(printable(str(found["error"]), 300))
        return found


def length_to_continue(part: Path, size: int) -> int:
    """The length of a partial file of a log of this size, which is made if it does not exist. A longer one belongs to
    another log and is emptied. Raises OSError."""
    with _open_part(part) as file:
        have = os.fstat(file.fileno()).st_size
        if have <= size:
            return have
        file.truncate(0)
    return 0


def append(part: Path, data: bytes) -> None:
    """Append data to a partial file. Raises OSError."""
    with _open_part(part) as file:
        file.write(data)


def _open_part(part: Path) -> BinaryIO:
    """The partial file, open for appending. Raises OSError, also for a symbolic link: where several people collect into
    one folder, one of them could lead what is written to any file of another."""
    flags = os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    return open(os.open(part, flags, 0o666), "ab")


def _listed(answer: dict[str, Any]) -> Iterator[tuple[str, int, float]]:
    """Name, length and time of each listed file; entries that are not valid are left out."""
    files = answer.get("files")
    for file in files[:MAX_FILES] if isinstance(files, list) else ():
        match file:
            case {"name": str() as name, "bytes": int() as size, "modified_unix_s": int() | float() as modified_unix_s}:
                if FILE_NAME.fullmatch(name) and 0 <= size <= MAX_FILE_BYTES and 0 <= modified_unix_s < 1e11:
                    yield name, size, float(modified_unix_s)


def _chunks(info: ObjectInfo) -> int:
    """Number of messages with the content of an object. The description is JSON of any station that may write to the
    store. Raises SkygcsError for one that describes no part."""
    chunks: object = info.chunks
    if isinstance(chunks, bool) or not isinstance(chunks, int) or not 0 <= chunks <= MAX_CHUNKS:
        raise SkygcsError("the object in the store is not a part of a log (chunks)")
    if not isinstance(info.nuid, str) or NUID.fullmatch(info.nuid) is None:
        raise SkygcsError("the object in the store is not a part of a log (nuid)")
    return chunks
