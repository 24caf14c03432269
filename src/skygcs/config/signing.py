"""The ``signing`` table of a link, and the file that its key is in."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from skygcs.config.files import open_regular, require_private
from skygcs.core.mavlink.signing import KEY_BYTES, MAX_AHEAD_S, key_from_passphrase
from skygcs.errors import KeyFileError

PASSPHRASE = "passphrase:"
"""Beginning of a key file that holds words instead of a key."""

MAX_KEY_FILE_BYTES = 4096

EVERY_MESSAGE = "*"


class SigningSettings(BaseModel):
    """[links.NAME.signing]"""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    key_file: Path
    """The secret key; only its owner may be able to read it."""
    link_id: Annotated[int, Field(ge=0, le=255)] = 0
    """Which of our links this is to others: two links of one key need two ids."""
    sign_outgoing: bool = True
    """Sign our own messages. What others sent is forwarded as it came, signed or not."""
    max_ahead_s: Annotated[float, Field(ge=60, le=3.2e9)] = MAX_AHEAD_S
    """Frames stamped further ahead of this computer's clock are dropped, and no clock follows them."""
    accept_unsigned: tuple[str | int, ...] = ("RADIO_STATUS", "RADIO")
    """Messages that may come unsigned (a telemetry radio has no key); [] for none, ["*"] for all."""


def read_key(path: Path) -> bytes:
    """The 32 bytes of a key file. Raises KeyFileError with what to do, and never with what is in the file.

    The file holds 32 bytes, or 64 hexadecimal digits, or "passphrase: WORDS", of which the key is made as Mission
    Planner, QGroundControl and MAVProxy make it. 32 bytes that are all text are taken for a forgotten "passphrase:".
    """
    try:
        with open_regular(path) as file:
            require_private(path, os.fstat(file.fileno()))
            data = file.read(MAX_KEY_FILE_BYTES + 1)
    except OSError as error:
        hint = "; make one with: skygcs-cli signing key FILE" if isinstance(error, FileNotFoundError) else ""
        raise KeyFileError(str(path), f"{(error.strerror or str(error)).lower()}{hint}") from None
    key = _key_in(path, data)
    if not any(key):
        raise KeyFileError(str(path), "is all zeros, which means no key at all")
    return key


def write_new_key(path: Path) -> bytes:
    """Make a random key and a file of mode 0600 for it, in hexadecimal. Raises KeyFileError, also if it exists."""
    key = os.urandom(KEY_BYTES)
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w") as file:
            os.fchmod(handle, 0o600)  # whatever the umask took away
            file.write(key.hex() + "\n")
            file.flush()
            os.fsync(handle)
    except FileExistsError:
        raise KeyFileError(str(path), "exists; a key that is in use would be lost, so it is not overwritten") from None
    except OSError as error:
        raise KeyFileError(str(path), f"cannot be written: {error.strerror}") from None
    return key


def _key_in(path: Path, data: bytes) -> bytes:
    if len(data) > MAX_KEY_FILE_BYTES:
        raise KeyFileError(str(path), f"is longer than {MAX_KEY_FILE_BYTES} bytes: not a key file")
    text = _text(data)
    if text is None:
        if len(data) == KEY_BYTES:
            return data
        raise KeyFileError(str(path), f"holds {len(data)} bytes that are not text; a key is exactly {KEY_BYTES}")
    if text.startswith(PASSPHRASE):
        words = text.removeprefix(PASSPHRASE).strip()
        if not words:
            raise KeyFileError(str(path), f"holds no words behind {PASSPHRASE!r}")
        return key_from_passphrase(words)
    if len(text) == 2 * KEY_BYTES:
        try:
            return bytes.fromhex(text)
        except ValueError:
            pass
    raise KeyFileError(
        str(path),
        f"holds neither {KEY_BYTES} bytes nor {2 * KEY_BYTES} hexadecimal digits; a passphrase is written as "
        f"{PASSPHRASE!r} and the words behind it",
    )


def _text(data: bytes) -> str | None:
    """The file as one line of text; None if it is not that."""
    try:
        text = data.decode().strip()
    except UnicodeDecodeError:
        return None
    return text if text.isprintable() else None
