"""Files that the fleet file or a command names: read, but never a pipe or device, which would stop the daemon; written
whole or not at all; and the clock of what outlives a sleep or a process."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import stat
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, TypeVar

from skygcs.errors import KeyFileError, LinkError

T = TypeVar("T")


def open_regular(path: Path) -> BinaryIO:
    """The file, open for reading. Raises OSError, also for what is no regular file.

    Opening a named pipe waits until a program writes to it: the loop, and with it the daemon, would stop. A
    device such as /dev/zero has no end.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except ValueError as error:  # a NUL within the name
        raise OSError(errno.EINVAL, str(error)) from None
    try:
        mode = os.fstat(handle).st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "is not a regular file")
        return open(handle, "rb")
    except BaseException:
        os.close(handle)
        raise


def read_state(path: Path, max_bytes: int, decode: Callable[[Any], T]) -> T:
    """``decode`` of the JSON in a file that this program keeps for its next start. Raises OSError, and ValueError for
    content that is damaged: no JSON, or none that ``decode`` takes, whatever that raises."""
    with open_regular(path) as file:
        content = file.read(max_bytes)
    try:
        return decode(json.loads(content))
    except (LookupError, TypeError, AttributeError, ArithmeticError, RecursionError) as error:
        raise ValueError(str(error)) from error


MAX_NAMED_BYTES = 32 << 20
"""No file that a person names for a command is larger: the largest plans are 25 MB."""


def read_named(path: Path) -> bytes:
    """Return what a file holds that a person names for a command; a pipe, as of the shell's <(…), is read to its end.

    Raises OSError, also for more than `MAX_NAMED_BYTES`: a device such as /dev/zero has no end.
    """
    with path.open("rb") as file:
        content = file.read(MAX_NAMED_BYTES + 1)
    if len(content) > MAX_NAMED_BYTES:
        raise OSError(errno.EFBIG, f"is larger than {MAX_NAMED_BYTES >> 20} MiB")
    return content


def write_named(path: Path, content: str | bytes, *, force: bool = True) -> None:
    """Write a file that a person names for a command: whole, or what was there stays. A pipe or a device, as
    /dev/stdout, is written to; so is a file that another one in its place would not be (`_is_only_written_to`).

    Raises OSError with the path, FileExistsError for a file that is there unless ``force``.
    """
    data = content.encode() if isinstance(content, str) else content
    try:
        there = path.exists()
        if there and (not path.is_file() or (force and _is_only_written_to(path))):
            path.write_bytes(data)
            return
        if there and not force:
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST))
        os.umask(umask := os.umask(0o077))
        write_whole(path.resolve(), data, stat.S_IMODE(path.stat().st_mode) if there else 0o666 & ~umask)
    except RuntimeError as error:  # a loop of symbolic links (Python 3.11)
        raise OSError(errno.ELOOP, str(error), str(path)) from None
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None


def _is_only_written_to(path: Path) -> bool:
    """True for a file that is there and is a stream of this process, has another owner or another name as well, or may
    be written itself only: read-only, in a folder that is, or mounted in its place."""
    real = path.resolve()
    found = real.stat()
    stream = path.absolute().parts[1] in ("dev", "proc")
    shared = found.st_nlink > 1 or found.st_uid != os.geteuid() or real.is_mount()
    return stream or shared or not (os.access(real, os.W_OK) and os.access(real.parent, os.W_OK))


LOG_MODE = 0o640
"""Mode of a file that the daemon writes into a log folder: its owner's, and its group may read it. A umask takes more
away, never gives more."""

FOLDER_MODE = 0o750
"""And of a folder that it makes there."""


def open_new(path: Path) -> BinaryIO:
    """A new file, open for writing. Raises OSError, FileExistsError if it exists."""
    return open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, LOG_MODE), "wb")


def make_log_folder(folder: Path) -> None:
    """Make a folder for files of the daemon, with its parents, if it is not there. Raises OSError."""
    folder.mkdir(mode=FOLDER_MODE, parents=True, exist_ok=True)


def write_whole(path: Path, content: bytes, mode: int, *, durable: bool = True) -> None:
    """Write a file of this mode whole or not at all: beside it, then renamed. Raises OSError.

    ``durable``: it is on the disk when this returns. False for caches, which are made anew when a power cut takes them:
    waiting for the disk stops the loop for tens of milliseconds.
    """
    handle, draft = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            os.fchmod(file.fileno(), mode)
            file.write(content)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        os.replace(draft, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(draft)
        raise
    if durable:
        _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """The new name is in the folder, and that is written like a file."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def require_private(path: Path, status: os.stat_result) -> None:
    """Raise KeyFileError, with what to do, if others could have read or changed this file."""
    if not stat.S_ISREG(status.st_mode):
        raise KeyFileError(str(path), "is not a file")
    mode = stat.S_IMODE(status.st_mode)
    if mode & 0o077:
        raise KeyFileError(
            str(path),
            f"others can read or change it (mode {mode:04o}); run: chmod 600 {path}, "
            "and make a new key if others may have read this one",
        )
    if status.st_uid not in (os.geteuid(), 0):
        raise KeyFileError(str(path), f"belongs to another user (uid {status.st_uid}); it must be your own")


MAX_TOKEN_BYTES = 4096


def read_token(table: str, path: Path | None) -> str | None:
    """The token of a table of the fleet file: of the daemon's TCP socket, or of what Prometheus scrapes.

    Raises LinkError if the file is missing, empty or readable by others.
    """
    if path is None:
        return None
    try:
        with open_regular(path) as file:
            mode = os.fstat(file.fileno()).st_mode
            token = file.read(MAX_TOKEN_BYTES).decode().strip()
    except OSError as error:
        raise LinkError(f"{table}.token_file {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise LinkError(f"{table}.token_file {path}: is not text") from None
    if mode & 0o077:
        raise LinkError(f"{table}.token_file {path}: others can read it; chmod 600 {path}")
    if len(token) < 16:
        raise LinkError(f"{table}.token_file {path}: the token needs at least 16 characters")
    return token


BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


def boot_s() -> float:
    """CLOCK_BOOTTIME, in seconds: it goes on while this computer sleeps, nobody sets it, and all processes of this
    computer read the same. Whatever counts across processes, or across a sleep, is timed by it."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


def boot_id() -> str:
    """The kernel's id of this start of the computer, for a file that outlives a process: its times by `boot_s` count
    within the same start alone. "": not known, and equal to no other."""
    try:
        return BOOT_ID.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return ""
