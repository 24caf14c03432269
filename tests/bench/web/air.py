"""What the pages cost in the air: how long an order takes to the link, and how late the daemon's control ticks are.

The order's time is from just before the page's message is written to its WebSocket until the vehicle's own socket has
the datagram: more than from receipt to the link's queue.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import os
import socket
import statistics
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import aiohttp

from bench.results import percentile
from bench.web.field import field
from bench.web.page import browser_page
from skygcs.core.mavlink.parser import FrameParser
from skygcs.rpc.client import Client, connect
from support.frames import dialect, frame, heartbeat
from support.process import wait_until
from support.web_station import WebStation

VEHICLES = 50
TARGET = 201
"""The system id of the vehicle that is ordered; it belongs to the benchmark."""

ORDERS = 150
EVERY_S = 0.1
MODE_COMMANDS = frozenset({17, 176, 192})
"""NAV_LOITER_UNLIM, DO_SET_MODE, DO_REPOSITION: how a PX4 or an ArduCopter is held."""

COMMAND_INT, COMMAND_LONG = 75, 76
LOITER, POSCTL = 3 << 24 | 4 << 16, 3 << 16
"""PX4's custom modes."""

FLOWN = ("v1", "v2", "v3", "v4", "v5")
ROUNDS = 2
WINDOW_S = 102.0
"""The daemon keeps the lateness of 500 ticks: 100 s of position control, which ticks at 5 Hz while no setpoint comes. A
shorter window would hold ticks of the one before, with pages or without."""

PAGES = 9


class OrderedVehicle(asyncio.DatagramProtocol):
    """A PX4 that takes every mode. ``arrived`` is set by each order for one."""

    def __init__(self) -> None:
        self.arrived: asyncio.Future[float] | None = None
        self._parser = FrameParser(dialect())
        self._transport: asyncio.DatagramTransport | None = None
        self._mode = POSCTL
        self._seq = 0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = transport  # type: ignore[assignment]

    def datagram_received(self, data: bytes, addr: Any) -> None:
        now = asyncio.get_running_loop().time()
        for received in self._parser.feed_datagram(data):
            if received.msgid not in (COMMAND_INT, COMMAND_LONG):
                continue
            fields = received.fields()
            if fields["target_system"] != TARGET:
                continue
            if fields["command"] in MODE_COMMANDS:
                if self.arrived is not None and not self.arrived.done():
                    self.arrived.set_result(now)
                self._mode = LOITER
            ack = {"command": fields["command"], "result": 0, "target_system": 255, "target_component": 25}
            self._send(frame("COMMAND_ACK", ack, sysid=TARGET, seq=self._next()))
            self.beat()

    def beat(self) -> None:
        self._send(heartbeat(TARGET, seq=self._next(), custom_mode=self._mode))

    def leave(self) -> None:
        """Another mode, so that the next order changes something."""
        self._mode = POSCTL
        self.beat()

    def _next(self) -> int:
        self._seq = (self._seq + 1) & 0xFF
        return self._seq

    def _send(self, data: bytes) -> None:
        if self._transport is not None:
            self._transport.sendto(data)


class PageClient:
    """A page without a browser: reads everything, unless it is ``stuck``."""

    def __init__(self, session: aiohttp.ClientSession, ws: aiohttp.ClientWebSocketResponse) -> None:
        self.session = session
        self.ws = ws
        self.now_s = 0.0
        self._heard_at = 0.0
        self.reading: asyncio.Task[None] | None = None
        self._number = 0

    async def send(self, method: str, *, order: bool = False, **params: Any) -> None:
        self._number += 1
        request: dict[str, Any] = {"jsonrpc": "2.0", "id": self._number, "method": method, "params": params}
        if order:
            request["deadline_s"] = self.now_s + asyncio.get_running_loop().time() - self._heard_at + 5
        await self.ws.send_str(json.dumps(request))

    async def read(self) -> None:
        async for message in self.ws:
            if message.type is not aiohttp.WSMsgType.TEXT:
                break
            head = message.data[:200]
            if '"now_s":' in head:
                self.now_s = float(head.partition('"now_s":')[2].partition(",")[0].rstrip("}"))
                self._heard_at = asyncio.get_running_loop().time()


@contextlib.asynccontextmanager
async def page_client(station: WebStation, *, reads: bool = True) -> AsyncIterator[PageClient]:
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as session:
        address = await asyncio.to_thread(station.address)
        async with session.get(address, allow_redirects=False) as answer:
            assert answer.status == 303
        ws = await session.ws_connect(f"{station.base}/ws", origin=station.base, max_msg_size=0)
        page = PageClient(session, ws)
        await page.send("web.ping")
        await page.send("web.subscribe", rate_hz=10)
        if reads:
            page.reading = asyncio.create_task(page.read())
        try:
            yield page
        finally:
            if page.reading is not None:
                page.reading.cancel()
            await ws.close()


@contextlib.asynccontextmanager
async def ordered_vehicle(station: WebStation) -> AsyncIterator[OrderedVehicle]:
    port = station.vehicles_port
    loop = asyncio.get_running_loop()
    transport, vehicle = await loop.create_datagram_endpoint(
        OrderedVehicle, remote_addr=("127.0.0.1", port), family=socket.AF_INET
    )

    async def beat() -> None:
        while True:
            vehicle.beat()
            await asyncio.sleep(0.5)

    beating = asyncio.create_task(beat())
    try:
        await asyncio.to_thread(
            wait_until, lambda: any(v["sysid"] == TARGET for v in station.call("vehicles.list")), "the vehicle is known"
        )
        yield vehicle
    finally:
        beating.cancel()
        transport.close()


async def time_orders(page: PageClient | Client, vehicle: OrderedVehicle, method: str) -> dict[str, Any]:
    """Give one order again and again."""
    loop = asyncio.get_running_loop()
    gc.collect()
    gc.freeze()  # a full collection of this process takes 20 ms, which no order waits for
    times_ms, lost = [], 0
    for _ in range(ORDERS):
        vehicle.leave()
        await asyncio.sleep(EVERY_S)
        vehicle.arrived = loop.create_future()
        began = loop.time()
        if isinstance(page, Client):
            answering = asyncio.create_task(page.call(method, targets=str(TARGET)))
        else:
            await page.send(method, order=True, targets=str(TARGET))
        try:
            times_ms.append((await asyncio.wait_for(vehicle.arrived, 5.0) - began) * 1000)
        except TimeoutError:
            lost += 1
        if isinstance(page, Client):
            await answering
    return {
        "count": len(times_ms),
        "lost": lost,
        **{f"p{share:g}_ms": round(percentile(times_ms, share / 100), 2) for share in (50, 99, 100)},
    }


def measure_orders() -> dict[str, Any]:
    """hold on a quiet fleet; stop while 50 vehicles stream, a plan flies and a parameter list is on its way."""
    with field(VEHICLES) as station:
        return asyncio.run(_measure_orders(station))


async def _measure_orders(station: WebStation) -> dict[str, Any]:
    async with page_client(station) as page, ordered_vehicle(station) as vehicle:
        await asyncio.sleep(2.0)
        async with connect(station.socket_path) as gcs:
            direct = await time_orders(gcs, vehicle, "vehicles.hold")
        quiet = await time_orders(page, vehicle, "vehicles.hold")
        plan = await asyncio.to_thread(begin_plan, station)
        listing = asyncio.create_task(_list_params(station.socket_path))
        try:
            busy = await time_orders(page, vehicle, "vehicles.stop")
        finally:
            listing.cancel()
        state = await asyncio.to_thread(station.call, "plan.status")
        return {
            "hold": quiet,
            "hold without the web process": direct,
            "stop with streams, plan and parameters": busy,
            "plan": plan,
            "plan_state": state.get("state"),
        }


def begin_plan(station: WebStation) -> dict[str, Any]:
    """Make, load and run a plan for a few vehicles: far enough to fly for the whole measurement."""
    states = {v["name"]: v for v in station.call("vehicles.list")}
    starts, goals = {}, {}
    for number, name in enumerate(FLOWN):
        east, north, _ = states[name]["position"]["enu_m"]
        starts[name] = [east, north, 5.0 + 2.0 * number]
        goals[name] = [east, north + 45.0, 5.0 + 2.0 * number]
    made = station.call("plan.make", goals=goals, starts=starts, others=False, limits={"speed_mps": 1.0})
    station.call("plan.load", plan=made["plan"])
    run = station.call("plan.run", force=True, set_return_heights=True)
    problems = [f"{f['vehicle']}: {f['text']}" for f in run["report"]["findings"] if f["severity"] == "refused"]
    return {"vehicles": len(goals), "started": run["started"], "refused": problems}


async def _list_params(socket_path: Path) -> None:
    """A parameter list is always on its way. It is read as it comes: to parse a megabyte here would stop the clock that
    times the orders."""
    reader, writer = await asyncio.open_unix_connection(str(socket_path), limit=64 << 20)
    request = {"jsonrpc": "2.0", "id": 1, "method": "params.list", "params": {"targets": "6-20", "refresh": True}}
    try:
        while True:
            writer.write(json.dumps(request).encode() + b"\n")
            while not (await reader.read(1 << 16)).endswith(b"\n"):
                pass
            await asyncio.sleep(0.05)
    finally:
        writer.close()


def measure_ticks() -> dict[str, Any]:
    """The lateness of control ticks without pages, and with one in Chromium and nine WebSocket clients of which one
    takes nothing and one floods; in turn, ROUNDS times."""
    with field(VEHICLES) as station:
        prefer_as_the_service_does(station)
        fly_up(station)
        for outcome in station.call("control.set", targets=",".join(FLOWN), mode="position")["outcomes"].values():
            assert outcome["ok"], outcome
        without, with_pages = [], []
        for _ in range(ROUNDS):
            asyncio.run(asyncio.sleep(WINDOW_S))
            without.append(lateness_ms(station))
            with browser_page() as page:
                page.goto(station.address())
                with_pages.append(_run_apart(_with_pages(station)))
        return {
            "without_ms": without,
            "with_pages_ms": with_pages,
            "ratio": round(statistics.median(with_pages) / statistics.median(without), 3),
        }


def prefer_as_the_service_does(station: WebStation) -> None:
    """The daemon before the browser, as the unit of `skygcs service install` has it (a nice value of -10 and ten times
    the CPU weight): a page that is drawn in software takes both processors of a small machine, and then the scheduler
    decides about ticks and not the daemon. Linux shares among sessions; the daemon is one of its own."""
    process = station.daemon_process
    assert process is not None
    for path in (f"/proc/{process.pid}/autogroup", "/proc/self/autogroup"):
        with contextlib.suppress(OSError):  # without the right, or without autogroups: as the user has it
            Path(path).write_text("-10" if path != "/proc/self/autogroup" else "0")
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, process.pid, -10)


def fly_up(station: WebStation) -> None:
    """As a user does: take off, and wait until they are there."""
    outcomes = station.call("vehicles.takeoff", targets=",".join(FLOWN), height_m=10, wait_s=60)["outcomes"]
    assert all(outcome["ok"] for outcome in outcomes.values()), outcomes
    wait_until(
        lambda: all(v["landed"] == "in_air" for v in station.call("vehicles.list") if v["name"] in FLOWN), "in the air"
    )


def _run_apart(work: Any) -> float:
    """In a thread: the browser's driver has a loop of its own in this one."""
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, work).result()


async def _with_pages(station: WebStation) -> float:
    async with contextlib.AsyncExitStack() as stack:
        for number in range(PAGES):
            page = await stack.enter_async_context(page_client(station, reads=number != 0))
            if number == 1:
                flooding = asyncio.create_task(_flood(page, station.base))
        await asyncio.sleep(WINDOW_S)
        found = await asyncio.to_thread(lateness_ms, station)
        flooding.cancel()
        return found


async def _flood(page: PageClient, base: str) -> None:
    """As many requests as the socket takes; the process refuses most and closes it, and it is opened anew."""
    while True:
        try:
            for _ in range(200):
                await page.send("vehicles.list")
            await asyncio.sleep(0.05)
        except (ConnectionError, aiohttp.ClientError):
            with contextlib.suppress(aiohttp.ClientError):
                page.ws = await page.session.ws_connect(f"{base}/ws", origin=base, max_msg_size=0)
                page.reading = asyncio.create_task(page.read())
            await asyncio.sleep(0.1)


def lateness_ms(station: WebStation) -> float:
    """p99 over the last 500 ticks, the mean of the vehicles."""
    states = station.call("control.status", targets=",".join(FLOWN))
    return round(statistics.fmean(state["lateness_p99_s"] for state in states) * 1000, 3)
