"""Orders to other sites go to the station socket, everything else to the daemon's."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from skygcs.cli.connection import client, names_other_sites
from skygcs.config.station_path import station_socket
from skygcs.errors import DaemonUnreachable, RpcError, SkygcsError
from skygcs.ext.federation import commands
from skygcs.rpc.address import SOCKET_VARIABLE
from skygcs.rpc.error_codes import METHOD_NOT_FOUND
from support.table import each


@each(
    ("targets", "with_station", "without"),
    [
        ("south/alpha", True, True),
        ("alpha, south/all", True, True),
        ("*/all", True, True),
        ("all sites", True, True),
        ("south/3", True, False),  # without a station: component 3 of a vehicle
        ("7/191", False, False),
        ("all", False, False),
        ("1-5,alpha", False, False),
    ],
)
def test_which_socket_an_order_needs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, targets: str, with_station: bool, without: bool
) -> None:
    monkeypatch.setenv(SOCKET_VARIABLE, str(tmp_path / "d.sock"))
    assert names_other_sites(targets) == without
    Path(station_socket(str(tmp_path / "d.sock"))).touch()
    assert names_other_sites(targets) == with_station


def test_without_a_station_socket_the_error_says_what_is_needed(tmp_path: Path) -> None:
    with pytest.raises(DaemonUnreachable, match=r"\[federation\]"):
        client(str(tmp_path / "d.sock"), station=True)


class StationWithoutLeases:
    async def call(self, method: str, **_: Any) -> Any:
        raise RpcError(METHOD_NOT_FOUND, f"no method {method}")


@each("order", ["take", "release"])
def test_a_station_without_leases_says_what_they_need(order: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def called(command: Any) -> None:
        await command(StationWithoutLeases())

    monkeypatch.setattr(commands, "run", lambda command, *, station: asyncio.run(called(command)))
    with pytest.raises(SkygcsError, match=r"no leases.*\[federation.vehicles\]"):
        getattr(commands, order)("alpha")
