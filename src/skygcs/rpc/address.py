"""Where daemon and clients meet when nobody says otherwise. Imported by both sides; imports next to nothing."""

from __future__ import annotations

import os
from pathlib import Path

from skygcs.errors import SkygcsError

SOCKET_VARIABLE = "SKYGCS_SOCKET"
TOKEN_FILE_VARIABLE = "SKYGCS_TOKEN_FILE"


MAX_TOKEN_CHARS = 4096
"""A device such as /dev/zero has no end."""


def default_socket_path() -> Path:
    """$XDG_RUNTIME_DIR/skygcs.sock, else /tmp/skygcs-UID/skygcs.sock: private to the user either way."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    if runtime:
        return Path(runtime) / "skygcs.sock"
    return Path(f"/tmp/skygcs-{os.getuid()}") / "skygcs.sock"


def tcp_address(address: str) -> tuple[str, int] | None:
    """Host and port of ``tcp://HOST:PORT``, None for a path. Raises ValueError for what is neither."""
    scheme, there_is, rest = address.partition("://")
    if not there_is:
        return None
    host, _, port = rest.rpartition(":")
    if scheme != "tcp" or not host or not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise ValueError(f"{address} is neither a path nor of the form tcp://HOST:PORT")
    return host.removeprefix("[").removesuffix("]"), int(port)


def client_address(address: str | os.PathLike[str] | None = None) -> str:
    """Return what a client connects to: the argument, else $SKYGCS_SOCKET, else the default path.

    A path, or ``tcp://HOST:PORT`` (a daemon with ``tcp_port``, usually through an SSH tunnel).
    """
    return os.fspath(address) if address else os.environ.get(SOCKET_VARIABLE) or str(default_socket_path())


def client_token() -> str | None:
    """The token for a daemon on TCP, from the file that $SKYGCS_TOKEN_FILE names; None where it names none.

    Raises SkygcsError if the file cannot be read.
    """
    token_file = os.environ.get(TOKEN_FILE_VARIABLE)
    if not token_file:
        return None
    try:
        with open(token_file, encoding="utf-8") as file:
            return file.read(MAX_TOKEN_CHARS).strip()
    except (OSError, UnicodeError) as error:
        raise SkygcsError(f"cannot read the token file {token_file}: {error}") from None
