"""Orders over mutual TLS: who gets in, what strangers cannot do, and what a client makes of a wrong companion."""

from __future__ import annotations

import asyncio
import contextlib
import json
import ssl
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skygcs.errors import DaemonUnreachable, LinkError
from skygcs.events import Event
from skygcs.ext.companions import tls_listener
from skygcs.ext.companions.companions_table import CompanionsConfig
from skygcs.ext.companions.ground import Companions
from skygcs.ext.companions.pinned_client import connect_pinned
from skygcs.ext.companions.tls import Identity, PinnedTls
from skygcs.ext.companions.tls_listener import (
    BURST,
    MAX_ADDRESSES,
    MAX_HANDSHAKES,
    MAX_HANDSHAKES_PER_ADDRESS,
    HandshakeLimits,
    TlsListener,
)
from skygcs.rpc import sessions
from skygcs.rpc.client import Client
from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon
from support.pinned import LONG_AGO, Issuer, make_pair
from support.table import each

WAIT_S = 120.0
"""Against hanging for ever; nothing takes it."""


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine is no slow handshake."""
    monkeypatch.setattr(PinnedTls, "handshake_s", WAIT_S)
    monkeypatch.setattr(tls_listener, "HANDSHAKE_S", WAIT_S)


class Door:
    """A companion's server, with the ground's identity beside it."""

    def __init__(self, folder: Path, *, paired: bool = True) -> None:
        self.ground, self.companion = folder / "ground", folder / "companion"
        if paired:
            make_pair(self.ground, self.companion)
        self.daemon = FakeDaemon()
        self.events: list[Event] = []
        self.listener = TlsListener("127.0.0.1", 0, Identity.of_companion(self.companion), self.events.append)
        self.server = RpcServer(self.daemon, folder / "run" / "s.sock")
        self.daemon.extensions.serve = self.listener.run  # type: ignore[method-assign]

    @property
    def port(self) -> int:
        assert self.listener.address is not None
        return self.listener.address[1]

    async def connect(self, folder: Path | None = None) -> Client:
        return await connect_pinned("127.0.0.1", self.port, Identity.of_ground(folder or self.ground, "alpha"))

    async def until(self, condition: object) -> None:
        async with asyncio.timeout(WAIT_S):
            while not condition():  # type: ignore[operator]  # noqa: ASYNC110
                await asyncio.sleep(0.005)

    def counted(self, name: str) -> int:
        return self.listener.counters[name]

    async def refuses(self, folder: Path) -> str:
        """The reason that a client with these files gets."""
        with pytest.raises(DaemonUnreachable) as caught:
            stranger = await self.connect(folder)
            try:
                await stranger.call("daemon.info")  # TLS 1.3: a client learns of its refusal after its handshake
            finally:
                await stranger.close()
        return caught.value.reason


@contextlib.asynccontextmanager
async def opened(folder: Path) -> AsyncIterator[Door]:
    door = Door(folder)
    await door.server.start()
    try:
        await door.until(lambda: door.listener.address is not None)
        yield door
    finally:
        await door.server.close()


@pytest.fixture
async def door(tmp_path: Path) -> AsyncIterator[Door]:
    async with opened(tmp_path) as door:
        yield door


async def test_the_ground_may_do_what_a_local_client_may(door: Door) -> None:
    ground = await door.connect()
    assert (await ground.arm("alpha"))["alpha"]["ok"] is True
    assert door.daemon.vehicle("alpha").orders[0][0] == "arm"
    clock = await ground.call("clock.read")
    assert set(clock) == {"monotonic_s", "unix_s"}
    events = ground.events()
    await ground.call("daemon.info")  # after it the subscription is known
    door.daemon.emit("mode", "alpha", "alpha: LAND")
    assert (await anext(aiter(events)))["text"] == "alpha: LAND"
    await ground.close()
    assert door.counted("accepted") == 1
    assert door.listener._limits.known == "127.0.0.1"


async def test_an_open_connection_ends_with_its_pin(door: Door, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tls_listener, "PIN_LOOK_S", 0.02)
    await asyncio.sleep(1.1)  # the look that has begun
    pin = door.companion / "ground.crt"
    content = pin.read_bytes()
    ground = await door.connect()
    assert (await ground.call("daemon.info"))["version"]
    pin.unlink()
    await door.until(lambda: door.counted("unpinned") == 1)
    with pytest.raises(DaemonUnreachable):
        await ground.call("vehicles.arm", targets="all")
    await ground.close()
    pin.write_bytes(content)
    again = await door.connect()
    assert (await again.call("daemon.info"))["version"]
    await again.close()


SPOILT: list[tuple[str, int | None]] = [
    *((name, 100) for name in ("ground.crt", "companion.crt", "companion.key")),  # half written
    *((name, None) for name in ("companion.crt", "companion.key")),
    ("all three", None),  # the folder is on a disk that fails
]


@each("name, left_bytes", SPOILT)
async def test_files_that_cannot_be_read_any_more_cut_no_ground(
    door: Door, monkeypatch: pytest.MonkeyPatch, name: str, left_bytes: int | None
) -> None:
    """A worn card, a copy that breaks off: the last good ones count, with an alarm, until another one is pinned."""
    monkeypatch.setattr(tls_listener, "PIN_LOOK_S", 0.02)
    await asyncio.sleep(1.1)  # the look that has begun
    door.events.clear()

    def changes() -> list[str]:
        return [event.data["change"] for event in door.events]

    names = ("ground.crt", "companion.key", "companion.crt") if name == "all three" else (name,)
    before = {file: (file.read_bytes(), file.stat().st_mode) for file in (door.companion / one for one in names)}
    ground = await door.connect()
    if left_bytes is None:
        door.companion.rename(door.companion.with_suffix(".aside")) if len(names) == 3 else next(iter(before)).unlink()
    else:
        for file, (content, _) in before.items():
            file.write_bytes(content[:left_bytes])
    await door.until(lambda: "keys_kept" in changes())
    assert names[-1] in door.events[-1].text and names[-1] in str(door.listener.status()["problem"])
    later = await door.connect()
    for client in (ground, later):
        assert (await client.call("daemon.info"))["version"]
    door.companion.mkdir(exist_ok=True)
    for file, (content, mode) in before.items():
        file.write_bytes(content)
        file.chmod(mode)
    await door.until(lambda: changes()[-1] == "keys_read")
    assert door.counted("unpinned") == 0 and changes().count("keys_kept") == 1
    for client in (ground, later):
        assert (await client.call("daemon.info"))["version"]
        await client.close()


async def test_it_ends_with_its_pin_also_if_another_handshake_reads_the_new_one_first(
    door: Door, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Anybody's connection between the change and the next look left the old ground its session for good."""
    monkeypatch.setattr(tls_listener, "PIN_LOOK_S", 0.02)
    ground = await door.connect()
    assert (await ground.call("daemon.info"))["version"]
    make_pair(tmp_path / "other", tmp_path / "unused")
    (door.companion / "companion.crt").unlink(missing_ok=True)  # nor does what is missing beside it keep the old one
    (door.companion / "ground.crt").write_bytes((tmp_path / "other" / "ground.crt").read_bytes())
    with pytest.raises(LinkError):
        door.listener._refresh()  # as a handshake does
    await door.until(lambda: door.counted("unpinned") == 1)
    with pytest.raises(DaemonUnreachable):
        await ground.call("daemon.info")
    await ground.close()


async def test_the_grounds_connection_ends_with_its_pin_of_the_companion(door: Door) -> None:
    """The page has it removed when a vehicle's computer was stolen: that one stayed connected."""
    sleep, log = SimpleNamespace(check=lambda: False), SimpleNamespace(publish=door.events.append)
    table = {"key_dir": door.ground, "alpha": {"rpc": f"127.0.0.1:{door.port}"}}
    core = cast(Any, SimpleNamespace(event_log=log, fleet=SimpleNamespace(sleep=sleep)))
    ground = Companions(core, CompanionsConfig.model_validate(table))
    link = ground.links.get("alpha")
    assert link is not None
    running = asyncio.create_task(ground.run())
    try:
        await door.until(lambda: link.is_up)
        pin = door.ground / "companions" / "alpha.crt"
        pin.write_bytes(pin.read_bytes() + b"\n")  # the same certificate, as of a backup that is played back
        make_pair(other := door.ground.parent / "other", door.ground.parent / "unused")
        for name in ("ground.crt", "ground.key"):  # a new identity, which the companion has not pinned yet
            (other / name).replace(door.ground / name)
        ground._look_at_pins()
        await asyncio.sleep(0.1)
        assert link.is_up
        await door.until(lambda: heard_of_keys(door))
        (door.ground / "companions" / "alpha.crt").unlink()
        await asyncio.sleep(0.1)
        assert link.is_up
        ground._look_at_pins()
        await door.until(lambda: "alpha.crt is missing" in str(link.last_error))
        assert not link.is_up and link.connected == 1
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def heard_of_keys(door: Door) -> bool:
    """The companion says that it cannot read its keys; True once that is an event of the ground, and nothing else."""
    door.daemon.emit("companion", None, "no word of keys", change="rpc_open")
    door.daemon.emit("companion", None, "companion.crt is missing", change="keys_kept")
    heard = [(one.vehicle, one.text) for one in door.events if one.data.get("companion") and one.data["change"] != "up"]
    return set(heard) == {("alpha", "companion alpha: companion.crt is missing")}


async def test_a_client_without_a_certificate_is_refused(door: Door) -> None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    reader, writer = await asyncio.open_connection("127.0.0.1", door.port, ssl=context)
    writer.write(b'{"jsonrpc":"2.0","id":1,"method":"vehicles.arm","params":{"targets":"all"}}\n')
    with contextlib.suppress(ssl.SSLError, ConnectionError):
        assert await reader.read() == b""
    writer.transport.abort()
    await door.until(lambda: door.counted("handshakes_failed") == 1)
    assert door.daemon.vehicle("alpha").orders == []
    assert door.counted("accepted") == 0


async def test_another_certificate_is_refused_although_it_trusts_us(door: Door, tmp_path: Path) -> None:
    stranger = tmp_path / "stranger"
    make_pair(stranger, tmp_path / "unused")
    (stranger / "companions" / "alpha.crt").write_bytes((door.companion / "companion.crt").read_bytes())
    assert "has it pinned our ground.crt" in await door.refuses(stranger)
    assert door.counted("accepted") == 0
    ours = await door.connect()
    assert (await ours.call("daemon.info"))["version"]
    await ours.close()


async def test_a_certificate_that_the_pinned_one_has_issued_is_refused(door: Door, tmp_path: Path) -> None:
    issuer = Issuer()
    issuer.write(tmp_path / "issuer", "ground")
    (door.companion / "ground.crt").write_bytes((tmp_path / "issuer" / "ground.crt").read_bytes())
    issued = tmp_path / "issued"
    issuer.write_issued(issued, "ground")
    (issued / "companions").mkdir()
    (issued / "companions" / "alpha.crt").write_bytes((door.companion / "companion.crt").read_bytes())
    await door.refuses(issued)
    assert (door.counted("accepted"), door.counted("wrong_certificate")) == (0, 1)


async def test_an_expired_certificate_is_refused_on_both_sides(door: Door, tmp_path: Path) -> None:
    old = tmp_path / "old"
    Issuer(until=LONG_AGO).write(old, "ground")
    (old / "companions").mkdir()
    (old / "companions" / "alpha.crt").write_bytes((door.companion / "companion.crt").read_bytes())
    (door.companion / "ground.crt").write_bytes((old / "ground.crt").read_bytes())
    await door.refuses(old)
    assert (door.counted("accepted"), door.counted("handshakes_failed")) == (0, 1)

    Issuer(until=LONG_AGO).write(door.companion, "companion")
    (old / "companions" / "alpha.crt").write_bytes((door.companion / "companion.crt").read_bytes())
    assert "expired" in await door.refuses(old)


async def test_plain_text_and_old_tls_are_refused(door: Door) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", door.port)
    writer.write(b'{"jsonrpc":"2.0","id":1,"method":"vehicles.arm","params":{"targets":"all"}}\n')
    with contextlib.suppress(ConnectionError):
        assert b"jsonrpc" not in await reader.read()
    writer.transport.abort()
    context = PinnedTls(Identity.of_ground(door.ground, "alpha"), server=False).context
    context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_2
    with pytest.raises((ssl.SSLError, ConnectionError)):
        await asyncio.open_connection("127.0.0.1", door.port, ssl=context, server_hostname="x")
    await door.until(lambda: door.counted("handshakes_failed") == 2)
    assert door.daemon.vehicle("alpha").orders == []


async def test_a_line_of_100_mb_is_skipped_and_the_next_one_answered(door: Door) -> None:
    context = PinnedTls(Identity.of_ground(door.ground, "alpha"), server=False).context
    reader, writer = await asyncio.open_connection("127.0.0.1", door.port, ssl=context, server_hostname="x")
    for _ in range(100):
        writer.write(b"x" * 1_000_000)
        await writer.drain()
    writer.write(b'\n{"jsonrpc":"2.0","id":7,"method":"daemon.info"}\n')
    async with asyncio.timeout(WAIT_S):
        refused, answered = json.loads(await reader.readline()), json.loads(await reader.readline())
    assert f"{sessions.MAX_LINE_BYTES} bytes" in refused["error"]["message"]
    assert answered["id"] == 7
    assert door.server.stats()["lines_too_long"] == 1
    writer.transport.abort()


async def test_a_thousand_connections_take_no_handshakes_and_the_ground_is_served(door: Door) -> None:
    ground = await door.connect()
    for _ in range(4):
        flood = [await asyncio.open_connection("127.0.0.1", door.port) for _ in range(250)]
        assert (await ground.call("daemon.info"))["version"]
        for _, writer in flood:
            writer.transport.abort()
    await ground.close()
    await door.until(lambda: door.counted("refused_by_limit") + door.counted("handshakes_failed") >= 1000)
    assert door.counted("refused_by_limit") > 900
    assert door.counted("accepted") == 1


async def test_a_silent_connection_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tls_listener, "HANDSHAKE_S", 0.05)
    async with opened(tmp_path) as door:
        reader, writer = await asyncio.open_connection("127.0.0.1", door.port)
        async with asyncio.timeout(WAIT_S):
            with contextlib.suppress(ConnectionError):
                assert await reader.read() == b""
        writer.transport.abort()
        await door.until(lambda: door.counted("handshakes_failed") == 1)


async def test_without_its_files_the_door_stays_closed_until_they_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tls_listener, "RETRY_S", 0.01)
    door = Door(tmp_path, paired=False)
    await door.server.start()
    try:
        await door.until(lambda: door.listener.problem is not None)
        assert "companion.crt is missing" in str(door.listener.problem)
        assert "skygcs companion identity companion" in str(door.listener.problem)
        make_pair(door.ground, door.companion)
        await door.until(lambda: door.listener.address is not None)
        ground = await door.connect()
        await ground.close()
        assert [event.data["change"] for event in door.events][-1] == "rpc_open"
    finally:
        await door.server.close()


async def test_a_pin_that_is_removed_counts_at_once(door: Door) -> None:
    (door.companion / "ground.crt").unlink()
    await door.refuses(door.ground)
    assert "ground.crt is missing" in str(door.listener.problem)
    assert door.counted("accepted") == 0


async def test_a_companion_with_another_certificate_gets_no_orders(door: Door, tmp_path: Path) -> None:
    make_pair(tmp_path / "other", tmp_path / "impostor")
    (door.ground / "companions" / "alpha.crt").write_bytes((tmp_path / "impostor" / "companion.crt").read_bytes())
    assert "another certificate than the pinned one" in await door.refuses(door.ground)


def test_a_key_that_others_can_read_and_files_that_are_none_are_refused(tmp_path: Path) -> None:
    ground, companion = make_pair(tmp_path / "g", tmp_path / "c")
    companion.key.chmod(0o640)
    with pytest.raises(LinkError, match="others can read this key; chmod 600"):
        PinnedTls(companion, server=True)
    ground.pinned.write_text("no certificate")
    with pytest.raises(LinkError, match="one certificate in PEM format"):
        PinnedTls(ground, server=False)
    companion.key.chmod(0o600)
    companion.key.write_bytes(ground.key.read_bytes())
    with pytest.raises(LinkError, match="cannot be used"):
        PinnedTls(companion, server=True)


def test_handshakes_are_limited_for_each_address_and_in_all() -> None:
    limits = HandshakeLimits(0.0)
    begun = [limits.begin("10.0.0.9", 0.0) for _ in range(10)]
    assert begun == [True] * MAX_HANDSHAKES_PER_ADDRESS + [False] * (10 - MAX_HANDSHAKES_PER_ADDRESS)
    assert limits.begin("10.0.0.1", 0.0)  # another address is not kept out
    for _ in range(MAX_HANDSHAKES_PER_ADDRESS):
        limits.end("10.0.0.9")
    quick = 0
    while limits.begin("10.0.0.9", 0.0):
        limits.end("10.0.0.9")
        quick += 1
    assert quick == BURST - MAX_HANDSHAKES_PER_ADDRESS
    assert limits.begin("10.0.0.9", 10.0)


def test_many_addresses_have_one_limit_and_take_no_memory() -> None:
    limits = HandshakeLimits(0.0)
    for second in range(1, 50):
        for host in range(50):
            limits.begin(f"10.0.{second}.{host}", float(second))
    assert sum(limits.begin(f"10.1.0.{host}", 1000.0) for host in range(100)) == 0  # none of them ended
    assert limits._open.total() == MAX_HANDSHAKES
    assert len(limits._rates) <= MAX_ADDRESSES


def test_half_open_handshakes_of_many_addresses_do_not_keep_the_ground_from_coming_back() -> None:
    limits = HandshakeLimits(0.0)
    limits.known = "10.0.0.1"
    assert sum(limits.begin(f"10.1.0.{host}", second) for second in (0.0, 1.0) for host in range(50)) == MAX_HANDSHAKES
    assert not limits.begin("10.0.0.2", 1.0)
    begun = [limits.begin("10.0.0.1", 1.0) for _ in range(MAX_HANDSHAKES_PER_ADDRESS + 1)]
    assert begun == [True] * MAX_HANDSHAKES_PER_ADDRESS + [False]
