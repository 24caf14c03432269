"""Files with the seed of a station's key (NATS nkey, Ed25519): made with mode 0600, refused if others can read them."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

import nkeys

from skygcs.config.files import open_regular, require_private
from skygcs.errors import KeyFileError

MAX_SEED_FILE_BYTES = 4096
RAW_SEED_BYTES = 32


class StationKey(NamedTuple):
    """A station's key. The secret seed signs; the public key is in the hub's inventory."""

    seed: str
    public_key: str


def write_new_seed(path: Path) -> str:
    """Make a key and write its seed to a new file of mode 0600. Returns the public key. Raises KeyFileError, also if
    the file exists."""
    made = new_key()
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
        with os.fdopen(handle, "wb") as file:
            os.fchmod(handle, 0o600)  # whatever the umask took away
            file.write(f"{made.seed}\n".encode())
            file.flush()
            os.fsync(handle)
    except FileExistsError:
        raise KeyFileError(str(path), "exists; a key that is in use would be lost, so it is not overwritten") from None
    except OSError as error:
        raise KeyFileError(str(path), f"cannot be written: {error.strerror}") from None
    return made.public_key


def new_key() -> StationKey:
    """A new random key, not written to a file."""
    seed = nkeys.encode_seed(os.urandom(RAW_SEED_BYTES), nkeys.PREFIX_BYTE_USER)
    return StationKey(seed.decode(), _public_key(seed))


def read_seed(path: Path) -> StationKey:
    """The key in this file. Raises KeyFileError, whose text contains nothing of the file's content."""
    try:
        with open_regular(path) as file:
            require_private(path, os.fstat(file.fileno()))
            data = file.read(MAX_SEED_FILE_BYTES + 1).strip()
    except FileNotFoundError:
        text = f"does not exist; make it: skygcs federation keys {path.stem} --out {path.parent}"
        raise KeyFileError(str(path), text) from None
    except OSError as error:
        raise KeyFileError(str(path), f"cannot be read: {error.strerror or error}") from None
    if not _is_seed(data):
        raise KeyFileError(str(path), "holds no seed of a key, as `skygcs federation keys` writes it (SU…)")
    return StationKey(data.decode(), _public_key(data))


def _is_seed(data: bytes) -> bool:
    """True for the seed of a user key. The check sum is compared here, since nkeys does not check it."""
    try:
        prefix, raw = nkeys.decode_seed(data)
        return bool(prefix == nkeys.PREFIX_BYTE_USER and nkeys.encode_seed(bytes(raw), prefix) == data)
    except Exception:  # nkeys.NkeysError, and what base64 and slicing raise for other data
        return False


def _public_key(seed: bytes) -> str:
    return str(nkeys.from_seed(bytearray(seed)).public_key.decode())
