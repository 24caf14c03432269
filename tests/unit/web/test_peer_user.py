"""Whose program is at the other end of a connection, by the kernel's own tables."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import Any

import pytest

from skygcs.web import peer_user
from skygcs.web.peer_user import is_own_user
from support.table import each


class Transport:
    """One end of a connection, as asyncio's transports show it."""

    def __init__(self, sock: socket.socket) -> None:
        self._names = {"sockname": sock.getsockname(), "peername": sock.getpeername()}

    def get_extra_info(self, name: str) -> Any:
        return self._names[name]


@each("host", ["127.0.0.1", "::1"])
def test_a_program_of_this_user_is_known_and_one_of_another_is_not(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        listener = socket.create_server((host, 0), family=family)
    except OSError:
        pytest.skip(f"this machine has no {host}")
    with listener, socket.create_connection(listener.getsockname()[:2]) as ours:
        accepted, _ = listener.accept()
        with accepted:
            assert is_own_user(Transport(accepted))
            own = os.geteuid()
            monkeypatch.setattr(os, "geteuid", lambda: own + 1)
            assert not is_own_user(Transport(accepted))
            assert ours.getsockname()[:2] == accepted.getpeername()[:2]


def test_a_connection_from_another_machine_is_nobodys(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener, socket.create_connection(listener.getsockname()) as ours:
        accepted, _ = listener.accept()
        with accepted:
            there = Transport(accepted)
            there._names["peername"] = ("192.0.2.7", ours.getsockname()[1])
            assert not is_own_user(there)
            monkeypatch.setattr(peer_user, "TABLES", (str(tmp_path / "none"),))
            assert not is_own_user(Transport(accepted))
