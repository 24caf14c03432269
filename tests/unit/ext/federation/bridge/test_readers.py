"""What other sites send, of whatever kind."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
from pydantic_core import from_json

from skygcs.errors import BusError
from skygcs.ext.federation.bridge.bus import Message
from skygcs.ext.federation.bridge.readers import MAX_SENDERS, Readers
from skygcs.ext.federation.bridge.relayed_daemon import RelayedDaemon
from skygcs.ext.federation.bridge.site_clock import SiteClock
from skygcs.ext.federation.protocol.remote_sites import FORGET_AFTER_S, RemoteSites
from skygcs.ext.federation.protocol.state_batch import StateBatch, encode_batch
from skygcs.rpc.server import RpcServer
from support.fake_daemon import FakeDaemon

EVENT = {"time_unix_s": 1.5, "kind": "mode", "vehicle": "alpha", "sysid": 1, "text": "hold", "data": {}}


def sent(seq: Any, **changes: Any) -> Message:
    event = {"v": 1, "site": "south", "run": "r", "seq": seq, "event": {**EVENT, **changes}}
    return Message("event.south", json.dumps(event).encode())


def test_an_event_that_no_client_could_show_is_left_out() -> None:
    bus: Any = None
    readers = Readers(bus, RemoteSites("north", "mine"), SiteClock(), own_site="north")
    read = readers._on_event
    read(sent(1))
    for seq in (10**400, -1, "2"):  # a number of thousands of digits could not be counted, nor be read by a client
        read(sent(seq))
    for wrong in ({"time_unix_s": 10**400}, {"time_unix_s": "now"}, {"kind": []}, {"vehicle": {}}, {"text": None}):
        read(sent(2, **wrong))
    assert len(readers.recent) == 1
    assert readers.counters["events_bad"] == 8 and readers.counters["events_lost"] == 0
    read(sent(4))
    assert readers.counters["events_lost"] == 2


def test_an_event_of_an_earlier_version_is_as_serious_as_it_is_here() -> None:
    bus: Any = None
    readers = Readers(bus, RemoteSites("north", "mine"), SiteClock(), own_site="north")
    readers._on_event(sent(1))
    readers._on_event(sent(2, kind="vehicle_lost"))
    readers._on_event(sent(3, kind="vehicle_lost", severity="warning"))
    readers._on_event(sent(4, kind="alarm", data={"change": "raised", "severity": {}}))
    assert [event["severity"] for event in readers.recent] == ["info", "alarm", "warning", "warning"]


def test_texts_and_numbers_of_an_event_can_be_shown() -> None:
    bus: Any = None
    readers = Readers(bus, RemoteSites("north", "mine"), SiteClock(), own_site="north")
    bad = {"text": "\x1b]0;mine\x07" + 5000 * "x", "kind": "mode\n", "vehicle": "\u202ealpha"}
    message = sent(1, **bad, data={"\x9b2J": "a\nb", "n": 10**400, "far": "FAR"})
    readers._on_event(Message(message.subject, message.data.replace(b'"FAR"', b"1e999")))
    (event,) = readers.recent
    assert event["data"] == {"?2J": "a?b", "n": None, "far": None}
    assert len(event["text"]) == 1000 and all(event[key].isprintable() for key in bad)


class SetClock(SiteClock):
    at_s = 1000.0

    def now_s(self) -> float:
        return self.at_s


class NoHub:
    async def request(self, subject: str, data: bytes, within_s: float) -> bytes:
        raise BusError(subject, "no hub")


def readers_at(clock: SiteClock) -> Readers:
    bus: Any = NoHub()
    return Readers(bus, RemoteSites("north", "mine"), clock, own_site="north")


def event_of(site: str, seq: int = 1) -> Message:
    event = {"v": 1, "site": site, "run": "r", "seq": seq, "event": EVENT}
    return Message(f"event.{site}", json.dumps(event).encode())


def test_the_site_that_was_silent_for_longest_makes_room_for_events_of_a_new_one() -> None:
    clock = SetClock()
    readers = readers_at(clock)
    for number in range(MAX_SENDERS):
        clock.at_s += 1.0
        readers._on_event(event_of(f"s{number}"))
    readers._on_event(event_of("new"))
    assert len(readers.recent) == MAX_SENDERS and readers.counters["events_beyond_rate"] == 1
    clock.at_s += FORGET_AFTER_S - 1.0
    readers._on_event(event_of("s0", 2))  # the oldest entry, but it is heard
    clock.at_s += 1.0
    readers._on_event(event_of("new"))
    assert readers.recent[-1]["site"] == "new"
    assert readers.counters["senders_forgotten"] == 1 and readers.counters["events_lost"] == 0
    readers._on_event(event_of("s0", 4))
    assert readers.counters["events_lost"] == 1, "s0 is still known"
    readers._on_event(event_of("s1", 9))  # the one that left, and takes the place of s2
    assert readers.counters["senders_forgotten"] == 2 and readers.counters["events_lost"] == 1


async def test_the_site_that_was_silent_for_longest_makes_room_for_batches_of_a_new_one() -> None:
    clock, read = SetClock(), asyncio.Event()
    readers = readers_at(clock)
    readers.on_batch.append(lambda _: read.set())
    for number in range(MAX_SENDERS):
        readers._on_state(Message(f"state.s{number}.fast", b"{}"))
    await asyncio.sleep(0)
    batch = encode_batch(StateBatch("new", "r", 1, 0.0, 0.1, True, None, ()))
    bad = readers.counters["batches_bad"]
    readers._on_state(Message("state.new.fast", batch))
    assert readers.counters["batches_bad"] == bad + 1
    clock.at_s += FORGET_AFTER_S
    readers._on_state(Message("state.new.fast", batch))
    await read.wait()
    assert readers.counters["batches"] == 1 and readers.counters["senders_forgotten"] == 1


# -- Reports of an order that a station gives its daemon reach the station's client under the client's own id.


class Client:
    """What a client of the station gets."""

    def __init__(self) -> None:
        self.lines: list[Any] = []

    def on_daemon_lines(self, lines: bytes) -> None:
        self.lines += [from_json(line) for line in lines.splitlines() if line]

    def on_daemon_full(self, full: bool) -> None:
        return

    def on_daemon_lost(self) -> None:
        return

    def end(self) -> None:
        return


@pytest.fixture
async def relayed(tmp_path: Path) -> AsyncIterator[tuple[RelayedDaemon, Client]]:
    server = RpcServer(FakeDaemon(), tmp_path / "s.sock")
    await server.start()
    client = Client()
    daemon = RelayedDaemon(client, str(tmp_path / "s.sock"), None)
    async with asyncio.timeout(60.0):
        assert await daemon.reach()
        yield daemon, client
    daemon.close()
    await server.close()


async def test_reports_carry_the_clients_id_and_answers_stay_here(relayed: tuple[RelayedDaemon, Client]) -> None:
    daemon, client = relayed
    await daemon.ask("vehicles.land", {"targets": "1-2"}, report_as='odd "id"')
    assert [line["method"] for line in client.lines] == ["order.begun", "order.outcome", "order.outcome"]
    assert {line["params"]["request"] for line in client.lines} == {'odd "id"'}
    await daemon.ask("vehicles.hold", {"targets": "all"}, report_as=None)
    assert len(client.lines) == 3, "not asked for"
