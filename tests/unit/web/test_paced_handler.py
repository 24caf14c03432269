"""Connections of browsers that are read in pieces."""

from __future__ import annotations

import asyncio
import base64
import time
from typing import Any

import pytest
from aiohttp import web
from aiohttp.web_protocol import RequestHandler

from skygcs.web.paced_handler import (
    LAST_COST_S,
    LONGEST_PAUSE_S,
    MOST_WAITING_BYTES,
    PIECE_BYTES,
    SHORTEST_PAUSE_S,
    Lane,
    PacedHandler,
    pause_after_s,
)

pytestmark = pytest.mark.looptime

TOOK_S = 0.01


class Transport(asyncio.Transport):
    def __init__(self) -> None:
        super().__init__()
        self.reading, self.aborted = True, False
        self.written = bytearray()

    def pause_reading(self) -> None:
        self.reading = False

    def resume_reading(self) -> None:
        self.reading = True

    def write(self, data: Any) -> None:
        self.written += data

    def is_closing(self) -> bool:
        return self.aborted

    def abort(self) -> None:
        self.aborted = True

    close = abort


class Rig:
    """A connection whose bytes go to a list; each piece takes ``took_s``."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, took_s: float = TOOK_S, lane: Lane | None = None) -> None:
        self.now = 0.0
        self.given: list[bytes] = []
        self.took_s = took_s
        self.fails = False
        monkeypatch.setattr(RequestHandler, "data_received", lambda _, data: self.give(data))
        self.handler = PacedHandler(web.Server(lambda request: web.Response()), lane or Lane(0.0), lambda: self.now)  # type: ignore[arg-type]
        self.transport = Transport()
        self.handler.transport = self.transport

    def give(self, data: bytes) -> None:
        if self.fails:
            raise AssertionError("of aiohttp")
        self.given.append(data)
        self.now += self.took_s


async def test_a_flood_is_taken_a_piece_a_turn_with_pauses_by_what_each_costs(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch)
    data = bytes(range(256)) * 64
    rig.handler.data_received(data)
    assert [len(piece) for piece in rig.given] == [PIECE_BYTES] and not rig.transport.reading
    await asyncio.sleep(4 * 9 * TOOK_S - 0.01)
    assert not rig.transport.reading, "each piece is followed by its pause"
    await asyncio.sleep(0.1)
    assert b"".join(rig.given) == data and rig.transport.reading and max(map(len, rig.given)) == PIECE_BYTES
    rig.handler.data_received(b"more")
    rig.handler.data_received(b" of it")  # before its pause is over: it waits, and no more is read
    assert rig.given[-1] == b"more" and not rig.transport.reading
    await asyncio.sleep(1.0)
    assert rig.given[-1] == b" of it" and rig.transport.reading


async def test_whatever_a_message_cost_the_stop_behind_it_waits_no_longer_than_the_longest_pause(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig(monkeypatch, took_s=10.0)
    rig.handler.data_received(b"plan")
    rig.handler.data_received(b"stop")
    await asyncio.sleep(LONGEST_PAUSE_S + SHORTEST_PAUSE_S)
    assert rig.given == [b"plan", b"stop"]
    assert [pause_after_s(cost_s) for cost_s in (0.0, 0.01, 10.0)] == [0.0, 0.09, LONGEST_PAUSE_S]


async def test_a_process_that_stands_still_costs_its_pages_nothing() -> None:
    handler = PacedHandler(web.Server(lambda request: web.Response()), Lane(0.0))  # type: ignore[arg-type]
    before_s = handler._clock()
    time.sleep(0.05)  # noqa: ASYNC251 - the whole process, as when it is stopped
    assert handler._clock() - before_s < 0.025


async def test_a_reader_that_is_behind_gets_nothing_and_the_rest_first_when_it_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig(monkeypatch, took_s=0.0)
    rig.handler._upgraded = True
    rig.handler.data_received(bytes(3 * PIECE_BYTES))
    rig.handler.pause_reading()
    await asyncio.sleep(1.0)
    assert len(rig.given) == 1 and not rig.transport.reading
    rig.handler.resume_reading()
    assert not rig.transport.reading, "what has come is first"
    await asyncio.sleep(1.0)
    assert sum(map(len, rig.given)) == 3 * PIECE_BYTES and rig.transport.reading


async def test_pauses_that_are_shorter_than_a_timer_can_be_are_made_together(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig(monkeypatch, took_s=SHORTEST_PAUSE_S / 9 / 4.5)
    rig.handler.data_received(bytes(8 * PIECE_BYTES))
    for _ in range(20):
        await asyncio.sleep(0)  # turns; no time passes
    assert len(rig.given) == 5 and not rig.transport.reading
    await asyncio.sleep(1.0)
    assert len(rig.given) == 8 and rig.transport.reading


UPGRADE = (
    b"GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    b"Sec-WebSocket-Key: " + base64.b64encode(bytes(16)) + b"\r\n\r\n"
)
FRAME = bytes([0x81, 0xFE, 0x04, 0, 0, 0, 0, 0]) + bytes(1024)


@pytest.mark.parametrize(
    ("first", "then"), [(b"", b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"), (UPGRADE, FRAME)], ids=["requests", "frames"]
)
async def test_what_comes_before_it_is_asked_for_is_held_as_aiohttp_holds_it_and_then_taken(
    first: bytes, then: bytes
) -> None:
    """With aiohttp's parser: requests behind one that is not answered, frames of a WebSocket that is not accepted."""
    may_go_on, taken = asyncio.Event(), 0

    async def answer(request: web.BaseRequest) -> web.StreamResponse:
        nonlocal taken
        await may_go_on.wait()
        if not first:
            taken += 1
            return web.Response()
        socket = web.WebSocketResponse()
        await socket.prepare(request)
        async for _ in socket:
            taken += 1
        return socket

    handler, transport = PacedHandler(web.Server(answer), Lane(0.0)), Transport()
    handler.connection_made(transport)
    handler.data_received(first + 900 * then)  # all of it: nothing comes later that would have it go on
    await asyncio.sleep(100.0)
    assert handler._waits and not transport.reading, "it is taken no further"
    assert len(handler._messages) < 200 and len(handler._message_tail) < 5 << 16
    may_go_on.set()
    await asyncio.sleep(1000.0)
    assert taken == 900 and transport.reading
    handler.connection_lost(None)


async def test_what_waits_is_bounded_and_given_within_a_bound_when_the_connection_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rig = Rig(monkeypatch)
    rig.handler.data_received(bytes(MOST_WAITING_BYTES))
    assert not rig.transport.aborted
    rig.handler.connection_lost(None)
    given = len(rig.given)
    assert 1 < given <= 2 + LAST_COST_S / TOOK_S
    await asyncio.sleep(1.0)
    assert len(rig.given) == given

    rig = Rig(monkeypatch)
    rig.handler.data_received(bytes(PIECE_BYTES))
    rig.handler.data_received(b"stop")  # then the tab is closed
    rig.handler.connection_lost(None)
    assert rig.given[-1] == b"stop"

    rig = Rig(monkeypatch)
    rig.handler.data_received(bytes(MOST_WAITING_BYTES))
    rig.handler.data_received(bytes(2 * PIECE_BYTES))
    assert rig.transport.aborted
    rig.handler.connection_lost(None)
    assert len(rig.given) == 1


async def test_a_failure_of_aiohttps_in_a_later_turn_ends_the_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, reported = Rig(monkeypatch), []
    asyncio.get_running_loop().set_exception_handler(lambda _, what: reported.append(what["exception"]))
    rig.handler.data_received(bytes(4 * PIECE_BYTES))
    rig.fails = True
    await asyncio.sleep(1.0)
    assert rig.transport.aborted and [str(error) for error in reported] == ["of aiohttp"]


async def test_connections_of_one_lane_take_no_more_of_the_loop_than_one_of_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop, lane = asyncio.get_running_loop(), Lane(0.0)
    rigs = [Rig(monkeypatch, lane=lane) for _ in range(20)]

    def give(handler: PacedHandler, data: bytes) -> None:
        next(rig for rig in rigs if rig.handler is handler).give(data)

    monkeypatch.setattr(RequestHandler, "data_received", give)
    for rig in rigs:
        rig.handler.data_received(bytes(20 * PIECE_BYTES))
    assert lane.busy == 20
    await asyncio.sleep(2.0)
    before, began = sum(len(rig.given) for rig in rigs), loop.time()
    await asyncio.sleep(4.0)
    assert sum(len(rig.given) for rig in rigs) - before <= 1 + (loop.time() - began) / (9 * TOOK_S)
    rigs[0].handler.join(other := Lane(0.0))
    assert (lane.busy, other.busy) == (19, 1)
    for rig in rigs:
        rig.handler.connection_lost(None)
    assert (lane.busy, other.busy) == (0, 0)


async def test_of_many_connections_that_end_with_a_flood_each_has_one_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    lane, given = Lane(0.0), []
    for _ in range(20):
        rig = Rig(monkeypatch, lane=lane)
        rig.handler.data_received(b"goto")
        rig.handler.data_received(b"stop" + bytes(20 * PIECE_BYTES))
        rig.handler.connection_lost(None)
        assert rig.given[1].startswith(b"stop")
        given.append(len(rig.given) - 1)
    assert given[-1] == 1 and sum(given) <= 20 + LAST_COST_S / TOOK_S + 1
