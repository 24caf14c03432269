"""The live Foxglove server, read by another implementation of its WebSocket protocol (aiohttp and this file)."""

from __future__ import annotations

import asyncio
import contextlib
import json
from pathlib import Path
from typing import Any

import aiohttp
import pytest

from skygcs.config.dialects import load_dialect
from skygcs.config.models import DaemonConfig, FleetConfig, SimulatedLinkConfig
from skygcs.daemon import Daemon
from skygcs.ext.logs.foxglove import serve
from skygcs.ext.logs.foxglove_schemas import SCHEMAS
from skygcs.rpc.client import connect
from support.hanging import HANG_S

pytestmark = pytest.mark.system

WANTED = {"/v1/pose", "/v1/path", "/v1/location", "/v1/battery", "/v1/velocity", "/tf"}


async def read(port: int) -> tuple[dict[int, dict[str, Any]], dict[str, Any]]:
    """Advertised channels by id, and the first message of each topic that is wanted."""
    channels: dict[int, dict[str, Any]] = {}
    topics: dict[int, str] = {}
    got: dict[str, Any] = {}
    async with (
        aiohttp.ClientSession() as session,
        session.ws_connect(f"ws://127.0.0.1:{port}", protocols=("foxglove.sdk.v1", "foxglove.websocket.v1")) as ws,
    ):
        async for message in ws:
            if message.type is aiohttp.WSMsgType.TEXT:
                answer = json.loads(message.data)
                if answer["op"] == "advertise":
                    wanted = [c for c in answer["channels"] if c["topic"] in WANTED]
                    channels |= {c["id"]: c for c in wanted}
                    topics |= {c["id"]: c["topic"] for c in wanted}
                    subscriptions = [{"id": c["id"], "channelId": c["id"]} for c in wanted]
                    await ws.send_str(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
            elif message.type is aiohttp.WSMsgType.BINARY and message.data[0] == 1:
                number = int.from_bytes(message.data[1:5], "little")
                got.setdefault(topics[number], json.loads(message.data[13:]))
                if got.keys() >= WANTED:
                    break
    return channels, got


async def test_the_fleet_is_seen_live(tmp_path: Path) -> None:
    config = FleetConfig(
        daemon=DaemonConfig(socket=tmp_path / "s", log_dir=tmp_path / "logs"),
        links={"sim": SimulatedLinkConfig(name="sim", px4=1, dynamics="kinematic")},
    )
    daemon = Daemon(config, load_dialect(config.dialect))
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    ports: asyncio.Queue[int] = asyncio.Queue()
    try:
        async with connect(tmp_path / "s") as gcs:
            serving = asyncio.create_task(serve(gcs, "all", "127.0.0.1", 0, 10.0, ports.put_nowait))
            async with asyncio.timeout(HANG_S):
                channels, got = await read(await ports.get())
            serving.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await serving
    finally:
        daemon.stop()
        await running
    for channel in channels.values():
        assert json.loads(channel["schema"]) == SCHEMAS[channel["schemaName"]]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
    assert abs(got["/v1/location"]["latitude"] - 43.7806) < 0.01
    assert got["/v1/pose"]["frame_id"] == "map"
    assert got["/tf"]["transforms"][0]["child_frame_id"] == "v1"
    assert got["/v1/path"]["poses"]
