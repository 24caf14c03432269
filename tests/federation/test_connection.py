"""Who is let in, and to whom a station talks: keys, TLS, a hub that is none, and what comes broken."""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import secrets
import shlex
import signal
import ssl
import subprocess
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import nats.errors
import pytest
from nats.aio.client import Client

from skygcs.errors import BusError
from skygcs.ext.federation.bridge.bus import Message
from skygcs.ext.federation.bridge.hub_config import MAX_PAYLOAD_BYTES
from skygcs.ext.federation.bridge.nkeys_files import new_key
from skygcs.ext.federation.bridge.process import tls_context
from skygcs.ext.federation.config import FederationConfig
from support.certificates import Authority
from support.hub import Hub, until
from support.process import ROOT, free_port

HOWTO = ROOT / "docs/howto/federation.md"

USERS: dict[str, dict[str, Any]] = {"north": {"role": "site"}, "visitor": {"role": "observer"}}


def federation(hub: Hub, **keys: Any) -> FederationConfig:
    return FederationConfig(site="north", servers=(hub.url,), nkey=hub.key_file("north"), **keys)


async def refusal(hub: Hub, **options: Any) -> str:
    """Why the hub is not used, or does not take us."""
    async with hub.bus("north", wait=False, **options) as bus:
        await until(lambda: bus.text != "not connected yet", "an answer")
        assert not bus.connected
        tried = [str(bus.text)]
        for _ in range(10):
            await asyncio.sleep(0.1)
            tried.append(str(bus.text))
        assert not bus.connected
        told = [event.text.removeprefix("federation: ") for event in bus.events]
        assert len(set(told)) == len(told) and set(tried) <= set(told), "each reason once, however often it is tried"
        return tried[-1]


async def test_a_key_that_the_inventory_does_not_have_is_refused_with_what_to_do(hub: Hub) -> None:
    stranger = new_key()
    text = await refusal(hub, seed=stranger.seed, public_key=stranger.public_key)
    assert "does not accept this station's key: its public key must be in the hub's inventory" in text


async def test_nobody_gets_in_without_a_key_or_by_the_public_key_of_another(hub: Hub) -> None:
    """Everybody with the inventory has the public keys; what counts is the signature of the hub's challenge."""
    other, ours = hub.keys["north"], new_key()

    class Claims(Client):
        def _setup_nkeys_seed_connect(self) -> None:
            super()._setup_nkeys_seed_connect()
            self._public_nkey = other.public_key

    async def silent(_: Exception) -> None: ...

    for client, words in (
        (Client(), {}),
        (Client(), {"user": "north", "password": ""}),
        (Client(), {"token": other.public_key}),
        (Claims(), {"nkeys_seed_str": ours.seed}),
    ):
        with pytest.raises(nats.errors.Error, match="Authorization Violation"):
            await client.connect(servers=[hub.url], allow_reconnect=False, error_cb=silent, **words)
        await client.close()


async def test_no_hub_at_the_address_is_said(hub: Hub) -> None:
    port = free_port()
    text = await refusal(hub, servers=(f"nats://127.0.0.1:{port}",))
    assert text == f"the hub at nats://127.0.0.1:{port}: connection refused"
    text = await refusal(hub, servers=("tls://hub.invalid:4222",), tls=ssl.create_default_context())
    assert text.startswith("the hub at tls://hub.invalid:4222: ") and "name" in text


@pytest.fixture
async def tls_hub(tmp_path: Path) -> AsyncIterator[tuple[Hub, Authority]]:
    """With a certificate of an authority, and in need of the stations'."""
    authority = Authority(tmp_path, "ca")
    cert, key = authority.issue("hub", "127.0.0.1")
    tls = {"cert": cert, "key": key, "ca": authority.file}
    made = Hub(tmp_path, USERS, tls=tls)
    await made.start()
    try:
        yield made, authority
    finally:
        made.process.stop()


async def test_over_tls_with_the_right_certificates(tls_hub: tuple[Hub, Authority]) -> None:
    hub, authority = tls_hub
    cert, key = authority.issue("north-station", "127.0.0.1")
    context = tls_context(federation(hub, ca=authority.file, cert=cert, key=key))
    async with hub.bus("north", tls=context) as bus:
        assert bus.connected and await bus.publish("event.north", b"{}")


async def test_a_wrong_certificate_on_either_side_is_refused(tls_hub: tuple[Hub, Authority], tmp_path: Path) -> None:
    hub, authority = tls_hub
    (tmp_path / "other").mkdir()
    other = Authority(tmp_path / "other", "other")
    cert, key = authority.issue("north-station", "127.0.0.1")
    foreign_cert, foreign_key = other.issue("north-station", "127.0.0.1")
    for keys, words in (
        ({"ca": other.file, "cert": cert, "key": key}, "is not trusted"),
        ({"cert": cert, "key": key}, "is not trusted"),
        ({"ca": authority.file}, "TLS failed"),
        ({"ca": authority.file, "cert": foreign_cert, "key": foreign_key}, "TLS failed"),
    ):
        text = await refusal(hub, tls=tls_context(federation(hub, **keys)))
        assert words in text and "federation.ca" in text, text


async def test_the_certificate_of_the_how_to(tmp_path: Path) -> None:
    command = re.search(r"^(openssl req .*\n.*)$", HOWTO.read_text(), re.MULTILINE)
    assert command is not None
    words = shlex.split(command[1].replace("\\\n", " ").replace("10.0.0.1", "127.0.0.1"))
    await asyncio.to_thread(subprocess.run, words, cwd=tmp_path, check=True, capture_output=True)
    hub = Hub(tmp_path, USERS, tls={"cert": tmp_path / "hub.crt", "key": tmp_path / "hub.key"})
    await hub.start()
    try:
        async with hub.bus("north", tls=tls_context(federation(hub, ca=tmp_path / "hub.crt"))) as bus:
            assert bus.connected
    finally:
        hub.process.stop()


async def test_a_station_that_is_taken_out_of_the_inventory_is_out_at_once_and_the_others_stay(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("visitor") as visitor:
        del hub.users["visitor"]
        hub.rewrite()
        assert hub.process.process is not None
        hub.process.process.send_signal(signal.SIGHUP)
        await until(lambda: "does not accept this station's key" in visitor.text, "it is refused")
        assert north.counters.connections == 1 and north.connected


async def test_a_certificate_for_another_address_is_refused(tmp_path: Path) -> None:
    authority = Authority(tmp_path, "ca")
    cert, key = authority.issue("hub", "10.9.8.7")
    hub = Hub(tmp_path, USERS, tls={"cert": cert, "key": key})
    await hub.start()
    try:
        text = await refusal(hub, tls=tls_context(federation(hub, ca=authority.file)))
        assert "is not trusted" in text and "127.0.0.1" in text
    finally:
        hub.process.stop()


@contextlib.asynccontextmanager
async def answering(info: bytes) -> AsyncIterator[tuple[int, bytearray]]:
    """A program that is no hub: it greets, and keeps what it is sent."""
    sent = bytearray()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            writer.write(info)
            while part := await reader.read(65536):
                sent.extend(part)
                if b"PING\r\n" in part:
                    writer.write(b"PONG\r\n")
        writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with server:
        yield server.sockets[0].getsockname()[1], sent


async def test_without_tls_nothing_is_signed_where_the_address_asks_for_tls(hub: Hub) -> None:
    """Who stands between passes on the real hub's challenge, and would have the answer: our place at the real hub."""
    info = {"server_id": "x", "version": "2.10.20", "max_payload": 1048576, "auth_required": True}
    greeting = f"INFO {json.dumps({**info, 'nonce': secrets.token_urlsafe(11)})}\r\n".encode()
    async with answering(greeting) as (port, sent):
        context = ssl.create_default_context()
        text = await refusal(hub, servers=(f"tls://127.0.0.1:{port}",), tls=context)
        assert "does not speak TLS, which its address asks for" in text
        assert b"sig" not in sent and b"CONNECT" not in sent


@pytest.mark.parametrize(
    "greeting",
    [
        b"",
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
        b"INFO {\r\n",
        b"INFO []\r\n",
        b"INFO " + b"x" * 200_000 + b"\r\n",
        b'INFO {"max_payload":"x","auth_required":true,"nonce":5}\r\n',
        b'INFO {"max_payload":-1,"connect_urls":[[],{}]}\r\n',
        b"\xff\xfe\x00" * 1000,
    ],
    ids=lambda greeting: repr(greeting[:20]),
)
async def test_what_is_no_hub_is_left_again_and_tried_again(hub: Hub, greeting: bytes) -> None:
    async with (
        answering(greeting) as (port, _),
        hub.bus("north", wait=False, servers=(f"nats://127.0.0.1:{port}", hub.url)) as bus,
    ):
        await until(lambda: bus.connected and bus.server == hub.url, "the next server of the list is used")
        assert await bus.publish("event.north", b"{}")


async def test_a_message_that_is_too_long_is_refused_here_and_nothing_breaks(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("visitor") as visitor:
        seen: list[int] = []
        await visitor.subscribe("event.*", lambda message: seen.append(len(message.data)))
        for length in (MAX_PAYLOAD_BYTES + 1, 16 << 20):
            with pytest.raises(BusError, match="are more than the 1048576 that the hub takes"):
                await north.publish("event.north", bytes(length))
            with pytest.raises(BusError):
                await visitor.request("here.north", bytes(length), 1)
        assert await north.publish("event.north", bytes(MAX_PAYLOAD_BYTES))
        await until(lambda: seen, "the longest message arrives")
        assert seen == [MAX_PAYLOAD_BYTES]
        assert north.counters.connections == visitor.counters.connections == 1


async def test_a_client_that_sends_too_much_is_cut_off_by_the_hub_and_the_others_go_on(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("visitor") as visitor, hub.raw(hub.keys["east"]) as east:
        seen: list[bytes] = []
        await visitor.subscribe("event.*", lambda message: seen.append(message.data))
        east._max_payload = 64 << 20  # a program that does not keep to it
        await east.publish("event.east", bytes(4 << 20))
        await until(lambda: east.is_closed, "the hub ends the connection")
        assert await north.publish("event.north", b"{}")
        await until(lambda: seen == [b"{}"], "others are served")


async def test_a_handler_that_fails_and_one_that_floods_do_not_end_the_connection(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("visitor") as visitor:

        def fails(message: Message) -> None:
            raise ValueError("broken")

        async def refuses(message: Message) -> bytes:
            raise KeyError("broken")

        await visitor.subscribe("event.*", fails)
        await north.serve("here.north", refuses)
        for _ in range(100):
            assert await north.publish("event.north", b"\xff{not json")
        with pytest.raises(BusError, match="no answer within"):
            await visitor.request("here.north", b"", 0.2)
        await until(lambda: visitor.counters.faults == 100, "each is counted")
        assert north.counters.faults == 1
        assert [event.kind for event in visitor.events].count("fault") == 1, "and one is reported"
        assert visitor.connected and north.connected


async def test_requests_beyond_what_is_answered_at_once_are_counted_and_not_kept(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("visitor") as visitor:
        running = 0

        async def slow(_: Message) -> bytes:
            nonlocal running
            running += 1
            await asyncio.sleep(3600)
            return b""

        await north.serve("here.north", slow)
        asked = [asyncio.create_task(visitor.request("here.north", b"", 30)) for _ in range(100)]
        await until(lambda: north.counters.busy == 36, "64 are being answered, 36 are not")
        assert running == 64
        for task in asked:
            task.cancel()
        await asyncio.gather(*asked, return_exceptions=True)
        assert visitor.status()["requests"] == 0


async def test_urgent_requests_have_places_that_no_other_takes(hub: Hub) -> None:
    async with hub.bus("north") as north, hub.bus("visitor") as visitor:
        running: list[bytes] = []

        async def slow(message: Message) -> bytes:
            running.append(message.data)
            await asyncio.sleep(3600)
            return b""

        # one sender gets half of what is reserved: the rest is for others
        await north.serve("here.north", slow, at_once=3, reserved=4, is_urgent=lambda data: data == b"stop")
        payloads = [*10 * [b"other"], *5 * [b"stop"], b"other"]
        asked = [asyncio.create_task(visitor.request("here.north", data, 30)) for data in payloads]
        await until(lambda: north.counters.busy == 11, "three and two are being answered")
        assert running == [*3 * [b"other"], *2 * [b"stop"]]
        for task in asked:
            task.cancel()
        await asyncio.gather(*asked, return_exceptions=True)
        assert visitor.status()["requests"] == 0
