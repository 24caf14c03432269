"""Links that come, change and go while the daemon runs; what a person sees of them."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from skygcs.config.dialects import load_dialect, offline_dialect
from skygcs.config.models import DaemonConfig, FleetConfig, MemoryLink
from skygcs.core.tlog import iter_records
from skygcs.daemon import Daemon
from skygcs.errors import LinkError, RefusedError
from skygcs.links.memory import MemoryLink as Memory
from skygcs.rpc.client import connect
from support.routed import heartbeat, message


@contextlib.asynccontextmanager
async def running(tmp_path: Path, *, record: bool = False, **links: dict[str, Any]) -> AsyncIterator[Daemon]:
    config = FleetConfig(
        daemon=DaemonConfig(socket=tmp_path / "s", log_dir=tmp_path / "logs", record=record),
        links={name: MemoryLink(name=name, **keys) for name, keys in links.items()},
    )
    daemon = Daemon(config, load_dialect(config.dialect))
    task = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    await until(lambda: all(row["state"] == "up" for row in daemon.links_status()))
    try:
        yield daemon
    finally:
        daemon.stop()
        await task


async def until(condition: Any) -> None:
    for _ in range(1000):
        if condition():
            return
        await asyncio.sleep(0.01)
    raise AssertionError("never happened")


def peer_of(daemon: Daemon, name: str) -> Any:
    link = daemon.links.link(name)
    assert isinstance(link, Memory)
    return link.peer


async def test_a_link_added_changed_and_removed_at_run_time(tmp_path: Path) -> None:
    async with running(tmp_path, radio={"role": "radio"}) as daemon, connect(tmp_path / "s") as gcs:
        await gcs.call("links.add", name="gcs", link={"type": "memory", "role": "gcs"})
        await until(lambda: daemon.links_status()[-1]["state"] == "up")
        peer_of(daemon, "radio").send(heartbeat(7))
        await until(lambda: any(raw[5] == 7 for raw in peer_of(daemon, "gcs").received))
        await gcs.call("links.change", name="gcs", link={"block_msg_id_out": ["ATTITUDE"]})
        await until(lambda: daemon.links_status()[-1]["state"] == "up")
        peer = peer_of(daemon, "gcs")
        peer_of(daemon, "radio").send(message("ATTITUDE", 7, seq=1) + heartbeat(7, seq=2))
        await until(lambda: any(raw[5] == 7 for raw in peer.received))
        assert [raw[7] for raw in peer.received if raw[5] == 7] == [0]
        rows = await gcs.call("links.list")
        assert rows[-1]["channels"][0]["filtered_out"] == 1
        await gcs.call("links.remove", name="gcs")
        assert [row["name"] for row in await gcs.call("links.list")] == ["radio"]


async def test_a_wrong_description_changes_nothing_and_says_what_is_wrong(tmp_path: Path) -> None:
    async with running(tmp_path, radio={}) as daemon:
        with pytest.raises(LinkError, match="ATITUDE"):
            await daemon.change_link("radio", {"allow_msg_id_in": ["ATITUDE"]})
        with pytest.raises(LinkError, match="port"):
            await daemon.add_link("x", {"type": "udp_server", "port": "many"})
        with pytest.raises(LinkError, match="already"):
            await daemon.add_link("radio", {"type": "memory"})
        with pytest.raises(LinkError, match="no link 'y'; there are: radio"):
            await daemon.remove_link("y")
        assert [row["state"] for row in daemon.links_status()] == ["up"]


async def test_a_conflict_is_an_event_and_both_directions_are_on_the_tlog(tmp_path: Path) -> None:
    async with running(tmp_path, record=True, radio={}) as daemon:
        peer = peer_of(daemon, "radio")
        peer.send(heartbeat(255, 25, gcs=True))
        peer.send(heartbeat(7))
        await until(lambda: 7 << 8 | 1 in daemon.fleet.vehicles)
        answer = daemon.send_message("PARAM_REQUEST_READ", {"param_id": "SYSID_THISMAV"}, "7")
        assert answer == {"sent": 1, "message": "PARAM_REQUEST_READ"}
        with pytest.raises(RefusedError, match="was not sent"):
            daemon.send_message("PARAM_REQUEST_READ", {"target_system": 99})
        assert [e["kind"] for e in daemon.events].count("conflict") == 1
        await until(lambda: any(raw[5] == 255 and raw[7] == 0 for raw in peer.received))
    [tlog] = (tmp_path / "logs").glob("*.tlog")
    names = [(r.frame.sysid, r.frame.name) for r in iter_records(tlog.read_bytes(), offline_dialect()) if r.frame]
    assert (7, "HEARTBEAT") in names
    assert names.count((255, "PARAM_REQUEST_READ")) == 1
    assert (255, "HEARTBEAT") in names


async def test_over_a_terrible_network_every_vehicle_is_still_found(tmp_path: Path) -> None:
    bad = {"loss": 0.3, "duplicate": 0.2, "delay_s": 0.01, "jitter_s": 0.03, "split": False, "seed": 5}
    async with running(tmp_path, radio=bad, gcs={"role": "gcs"}) as daemon:
        peer = peer_of(daemon, "radio")
        for seq in range(30):
            for sysid in range(1, 11):
                peer.send(heartbeat(sysid, seq=seq))
            await asyncio.sleep(0.005)
        await until(lambda: len(daemon.fleet.vehicles) == 10)
        assert daemon.hub.faults == 0
