"""The socket by which `skygcs web link` and `skygcs web sign-out` ask a running web process: 0600, one line each way.

It stands beside the daemon's socket and is named by the page's port, so that several web processes have one each.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from skygcs.errors import SkygcsError
from skygcs.web.sign_in import ROLES, Role

MAX_LINE_BYTES = 4096
ANSWER_S = 5.0


def control_path(rpc_socket: str, port: int) -> Path:
    """Where the process that serves ``port`` listens."""
    return Path(f"{rpc_socket}.web-{port}")


def find_control(rpc_socket: str, port: int | None) -> Path:
    """The one running web process, or that of a port. Raises SkygcsError."""
    base = Path(rpc_socket)
    found = sorted(p for p in base.parent.glob(f"{base.name}.web-*") if p.suffix != ".cookies" and _answers(p))
    if port is not None:
        found = [path for path in found if path == control_path(rpc_socket, port)]
    if not found:
        where = "" if port is None else f" on port {port}"
        raise SkygcsError(f"no web process{where} for {rpc_socket}; start one with: skygcs web")
    if len(found) > 1:
        ports = ", ".join(path.name.rpartition("-")[2] for path in found)
        raise SkygcsError(f"several web processes are running; say which with --port: {ports}")
    return found[0]


def ask_for_link(path: Path, role: Role, *, own_user: bool = False) -> str:
    """A further address. ``own_user``: to be opened in a browser of this user. Raises SkygcsError."""
    return str(_ask(path, {"link": role, "own_user": own_user}, "address"))


def ask_to_sign_out(path: Path) -> int:
    """Have all browsers forgotten; how many were signed in. Raises SkygcsError."""
    return int(_ask(path, {"sign_out": True}, "signed_out"))


def _ask(path: Path, request: dict[str, Any], wanted: str) -> Any:
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
            sock.settimeout(ANSWER_S)
            sock.connect(str(path))
            sock.sendall(json.dumps(request).encode() + b"\n")
            line = sock.makefile("rb").readline(MAX_LINE_BYTES)
        return json.loads(line)[wanted]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SkygcsError(f"{path}: the web process does not answer ({error})") from None


def _answers(path: Path) -> bool:
    with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock:
        sock.settimeout(ANSWER_S)
        sock.connect(str(path))
        return True
    return False


class ControlSocket:
    """The listening side. ``link`` makes an address for a role, for this user's browsers only or for any; ``sign_out``
    forgets all browsers and returns their number."""

    def __init__(self, path: Path, link: Callable[[Role, bool], str], sign_out: Callable[[], int]) -> None:
        self.path = path
        self._link = link
        self._sign_out = sign_out
        self._server: asyncio.Server | None = None

    async def start(self) -> None:
        """Listen; a socket that a dead process left is replaced. Raises SkygcsError."""
        if _answers(self.path):
            raise SkygcsError(f"another web process uses {self.path}")
        self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with contextlib.suppress(FileNotFoundError):
            self.path.unlink()
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            old = os.umask(0o177)
            try:
                sock.bind(str(self.path))
            finally:
                os.umask(old)
        except OSError as error:
            sock.close()
            raise SkygcsError(f"{self.path}: {error.strerror or error}") from None
        self._server = await asyncio.start_unix_server(self._serve, sock=sock, limit=MAX_LINE_BYTES)

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
            with contextlib.suppress(FileNotFoundError):
                self.path.unlink()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        answer: dict[str, Any] = {"error": "not understood"}
        try:
            async with asyncio.timeout(ANSWER_S):
                request = json.loads(await reader.readline())
                if isinstance(request, dict) and request.get("link") in ROLES:
                    answer = {"address": self._link(request["link"], request.get("own_user") is True)}
                elif isinstance(request, dict) and request.get("sign_out") is True:
                    answer = {"signed_out": self._sign_out()}
                writer.write(json.dumps(answer).encode() + b"\n")
                await writer.drain()
        except (TimeoutError, ValueError, RecursionError, ConnectionError):
            pass
        finally:
            writer.close()
