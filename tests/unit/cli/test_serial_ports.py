"""Links that the daemon lends for a command that needs their port."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from skygcs.cli import serial_ports
from skygcs.cli.serial_ports import lent
from skygcs.errors import DaemonUnreachable, LinkError, RefusedError, RpcError
from support.table import each


class Gcs:
    """Stands for the daemon: a radio's link, and vehicles."""

    def __init__(self, device: str, armed: tuple[str, ...] = (), broken: bool = False) -> None:
        self.rows = [
            {"name": "radio", "type": "serial", "channels": [{"peer": device}]},
            {"name": "net", "type": "udp_server", "channels": [{"peer": "127.0.0.1:1"}]},
            {"name": "off", "type": "serial", "channels": []},
        ]
        self.armed = armed
        self.broken = broken
        self.changes: list[tuple[str, Any]] = []

    async def call(self, method: str, **params: Any) -> Any:
        if method == "links.list":
            return self.rows
        if method == "vehicles.list":
            states = {"duplicate_sysid": False, "landed": "on_ground"}
            return [{"name": name, "armed": name in self.armed, **states} for name in ("alpha", "bravo")]
        assert method == "links.change"
        if self.broken and params["link"]["enabled"]:
            raise RpcError(-32001, "no such link")
        self.changes.append((params["name"], params["link"]))


def running(monkeypatch: pytest.MonkeyPatch, gcs: Gcs | None) -> None:
    @asynccontextmanager
    async def client() -> AsyncIterator[Gcs]:
        if gcs is None:
            raise DaemonUnreachable("here", "nobody listens")
        yield gcs

    monkeypatch.setattr(serial_ports, "client", client)


async def test_the_daemon_lends_the_port_under_whatever_name_and_takes_it_back_after_an_error(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "ttyUSB0").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB0")
    gcs = Gcs(str(tmp_path / "by-id"))
    running(monkeypatch, gcs)
    with pytest.raises(LinkError):
        async with lent([str(tmp_path / "ttyUSB0")], changes=True, force=False):
            assert gcs.changes == [("radio", {"enabled": False})]
            raise LinkError("silence")
    assert gcs.changes[1:] == [("radio", {"enabled": True})]


async def test_another_port_leaves_the_daemons_links_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    gcs = Gcs("/dev/one", armed=("alpha",))
    running(monkeypatch, gcs)
    async with lent(["/dev/two"], changes=False, force=False):
        pass
    assert gcs.changes == []


@each(("port", "changes"), [("/dev/one", False), ("/dev/one", True), ("/dev/two", True)])
async def test_nothing_happens_while_a_vehicle_is_armed_unless_forced(
    port: str, changes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    gcs = Gcs("/dev/one", armed=("alpha", "bravo"))
    running(monkeypatch, gcs)
    with pytest.raises(RefusedError, match="alpha, bravo are armed"):
        async with lent([port], changes=changes, force=False):
            raise AssertionError("the radio was touched")
    assert gcs.changes == []
    async with lent([port], changes=changes, force=True):
        pass
    assert len(gcs.changes) == (2 if port == "/dev/one" else 0)


async def test_without_a_daemon_no_link_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    running(monkeypatch, None)
    async with lent(["/dev/one"], changes=True, force=False):
        pass


async def test_a_link_that_stays_closed_is_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    running(monkeypatch, Gcs("/dev/one", broken=True))
    async with lent(["/dev/one"], changes=False, force=False):
        pass
    assert "skygcs-cli links change radio enabled=true" in " ".join(capsys.readouterr().err.split())
