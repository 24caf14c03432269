"""Files that hold a token: of the daemon's TCP socket, and of the addresses that Prometheus scrapes."""

from __future__ import annotations

import os
from pathlib import Path

from skygcs.config.files import open_regular
from skygcs.errors import LinkError

MAX_TOKEN_BYTES = 4096


def read_token(table: str, path: Path | None) -> str | None:
    """The token of a table of the fleet file; raises LinkError if the file is missing, empty or readable by others."""
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
